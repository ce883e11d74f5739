"""Named arrays of MATLAB's `.mat` and of HDF5's `.h5`, as `.npz` files give them.

MATLAB has no rows without columns: what has one row or one column becomes a row of numbers, and so do the times of
HDF5 files that MATLAB wrote (7.3), whose axes come back in order.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError, need
from ullage.ports.matlab import MatFile
from ullage.untrusted import reading

MATLAB, HDF5 = (".mat",), (".h5", ".hdf5")
NEWER = b"MATLAB 7.3"
PAIRS = (("real", "imag"), ("r", "i"))
MATRICES = ("samples", "scans", "positions", "quaternions")
"""Names of keys that hold matrices, or end in one and a unit; other arrays are rows of numbers."""


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
