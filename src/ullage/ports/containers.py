"""Named arrays of MATLAB's `.mat` and of HDF5's `.h5`, as `.npz` files give them.

MATLAB has no rows without columns: what has one row or one column becomes a row of numbers, and so do the times of
HDF5 files that MATLAB wrote (7.3), whose axes come back in order.

scipy reads `.mat` files too, but damaged ones end the process (an unchecked type code in its compiled part, scipy
1.17), so what a stranger's file holds is checked and read here [MAT5]. All but full numeric arrays is passed over.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError, need
from ullage.untrusted import reading

MATLAB, HDF5 = (".mat",), (".h5", ".hdf5")
NEWER = b"MATLAB 7.3"
PAIRS = (("real", "imag"), ("r", "i"))
MATRICES = ("samples", "scans", "positions", "quaternions")
"""Names of keys that hold matrices, or end in one and a unit; other arrays are rows of numbers."""
HEADER_BYTES, HEAD_BYTES, MOST_DIMENSIONS = 128, 4096, 8
MATRIX, COMPRESSED = 14, 15
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
COMPLEX = 0x0800


def load(path: Path, names: Iterable[str], *, most_bytes: int) -> dict[str, NDArray[Any]]:
    """Read those of the named arrays that the file holds.

    Raises:
        InputError: it is no such file, is damaged, or the arrays take more than `most_bytes`.
        MissingExtra: it is HDF5, and h5py is not installed.
    """
    with reading(path):
        if _is_hdf5(path):
            with open_hdf5(path) as file:
                found = {name: array_in(file, name, most_bytes=most_bytes) for name in names if name in file}
        else:
            found = _of_matlab(path, set(names), most_bytes)
    rows = {name: value.ravel() for name, value in found.items() if value.ndim == 2 and 1 in value.shape}
    return found | {name: row for name, row in rows.items() if not _matrix(name)}


def names_in(path: Path) -> frozenset[str]:
    """Names of the arrays in the file."""
    with reading(path):
        if not _is_hdf5(path):
            return frozenset(name for name, _ in MatFile(path).arrays())
        with open_hdf5(path) as file:
            return frozenset(file)


def open_hdf5(path: Path) -> Any:
    """Open an HDF5 file to read.

    Raises:
        MissingExtra: h5py is not installed.
    """
    return need("h5py", extra="hdf5").File(path, "r")


def array_in(group: Any, name: str, *, most_bytes: int) -> NDArray[Any]:
    """An array of an open HDF5 file; links to other files are not followed.

    Raises:
        InputError: it is no array of this file, or too large.
    """
    here = group
    for part in name.split("/"):
        link = here.get(part, getlink=True)
        if link is None or hasattr(link, "filename"):
            what = f"no {name}" if link is None else f"{name} links to another file"
            raise InputError(what, where=group.file.filename, allowed="arrays of the file itself")
        here = here[part]
    if not hasattr(here, "dtype") or here.is_virtual or here.external:
        raise InputError(f"{name} is no array of its own", where=group.file.filename)
    if here.nbytes > most_bytes:
        what = f"{name} takes {here.nbytes} bytes"
        raise InputError(what, where=group.file.filename, allowed=f"at most {most_bytes}")
    value = np.asarray(here[()])
    for real, imaginary in PAIRS:
        if value.dtype.names == (real, imaginary):
            value = value[real] + 1j * value[imaginary].astype(np.result_type(value[imaginary], np.float32))
    return value.T if "MATLAB_class" in here.attrs else value


def _is_hdf5(path: Path) -> bool:
    if path.suffix.lower() in HDF5:
        return True
    with path.open("rb") as file:
        return file.read(len(NEWER)) == NEWER


def _of_matlab(path: Path, names: set[str], most_bytes: int) -> dict[str, NDArray[Any]]:
    found = {name: array for name, array in MatFile(path).arrays() if name in names}
    size = sum(array.nbytes for array in found.values())
    if size > most_bytes:
        raise InputError(f"unpacks to {size} bytes", where=path, allowed=f"at most {most_bytes}")
    return {name: array.read() for name, array in found.items()}


def _matrix(name: str) -> bool:
    return name.rpartition("_")[0].removeprefix("track_") in MATRICES or name in MATRICES


class MatFile:
    """An open `.mat` file of version 5 (-v6 and -v7).

    Args:
        path: the file.

    Raises:
        InputError: it is no such file.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._raw = path, path.read_bytes()
        mark = self._raw[126:128]
        if mark not in (b"IM", b"MI"):
            raise InputError("no MATLAB file of version 5 or 7.3", where=path, allowed="save it with -v7")
        self._order = "<" if mark == b"IM" else ">"

    def arrays(self) -> Iterator[tuple[str, _Matrix]]:
        """Give name and contents of each numeric array, unread."""
        at = HEADER_BYTES
        while at + 8 <= len(self._raw):
            kind, size, start = self._tag(self._raw, at)
            data = memoryview(self._raw)[start : start + size]
            if kind in (MATRIX, COMPRESSED) and (found := self._matrix(data, packed=kind == COMPRESSED)) is not None:
                yield found.name, found
            at = start + size

    def _tag(self, data: Any, at: int) -> tuple[int, int, int]:
        """Type, size and start of the element at a place."""
        if at + 8 > len(data):
            raise InputError(f"cut within an element at byte {at}", where=self.path)
        first, size = (int(word) for word in np.frombuffer(data, f"{self._order}u4", 2, at))
        return (first & 0xFFFF, first >> 16, at + 4) if first >> 16 else (first, size, at + 8)

    def element(self, data: Any, at: int) -> tuple[NDArray[Any], int]:
        """Numbers of the element at a place, and the place of the next one.

        Raises:
            InputError: its type is unknown, or it is cut.
        """
        kind, size, start = self._tag(data, at)
        if kind not in TYPES or start + size > len(data):
            raise InputError(f"an element of type {kind} and {size} bytes", where=self.path, allowed="whole numbers")
        dtype = np.dtype(self._order + TYPES[kind])
        return np.frombuffer(data, dtype, size // dtype.itemsize, start), start + size + -(start + size) % 8

    def _matrix(self, data: Any, *, packed: bool) -> _Matrix | None:
        if packed:
            inner = zlib.decompressobj().decompress(data, HEAD_BYTES)
            if self._tag(inner, 0)[0] != MATRIX:
                return None
            head = inner[8:]
        else:
            head = bytes(data[:HEAD_BYTES])
        flags, at = self.element(head, 0)
        if len(flags) < 1 or (int(flags[0]) & 0xFF) not in CLASSES:
            return None
        shape, at = self.element(head, at)
        name, at = self.element(head, at)
        if not 1 <= len(shape) <= MOST_DIMENSIONS or (shape < 0).any():
            raise InputError(f"an array of shape {shape.tolist()[:9]}", where=self.path)
        return _Matrix(self, data, name.tobytes().decode("latin1"), tuple(map(int, shape)), int(flags[0]), packed, at)


class _Matrix:
    """One numeric array, not yet read."""

    def __init__(
        self, file: MatFile, data: Any, name: str, shape: tuple[int, ...], flags: int, packed: bool, at: int
    ) -> None:
        self.name, self._file, self._data, self._shape, self._packed, self._at = name, file, data, shape, packed, at
        self._dtype, self._complex = np.dtype(CLASSES[flags & 0xFF]), bool(flags & COMPLEX)

    @property
    def nbytes(self) -> int:
        """Size in memory, as the file says it."""
        size = self._dtype.itemsize * (2 if self._complex else 1)
        for one in self._shape:
            size *= one
        return size

    def read(self) -> NDArray[Any]:
        """The array, real or complex.

        Raises:
            InputError: it holds less than its shape says.
        """
        data: Any = self._data
        if self._packed:
            data = zlib.decompressobj().decompress(data, HEAD_BYTES + 8 * self.nbytes)[8:]
        parts, at = [], self._at
        for _ in range(1 + self._complex):
            values, at = self._file.element(data, at)
            parts.append(values.astype(self._dtype))
        if any(len(part) != np.prod(self._shape, dtype=object) for part in parts):
            raise InputError(f"{self.name} holds {len(parts[0])} numbers for {self._shape}", where=self._file.path)
        value = parts[0] + 1j * parts[1] if self._complex else parts[0]
        return np.asarray(value).reshape(self._shape, order="F")
