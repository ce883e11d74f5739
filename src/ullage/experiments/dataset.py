"""Make a training set: many samples in one sharded Zarr store, with an index of Parquet files and a data card.

The rows of a shard are written to the index after its arrays. So a store that was killed at any moment can be read,
and the same command completes it.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import ullage
from ullage.errors import InputError, UllageError, need, one_line
from ullage.experiments.cluster import Log, Where, each_done
from ullage.experiments.samples import CONTENT, FORMAT, SENSORS, SampleSpec, coordinates, layout, sample
from ullage.files import write_whole, writing

Progress = Callable[[int, int, str], None]
Row = dict[str, Any]

CARD = Path(__file__).with_name("dataset_card.md.jinja")
SHARD, SMALL_SHARD, SMALL_N = 64, 8, 1024
"""Samples in a file of a large data set and of one with fewer samples than `SMALL_N`."""


def dataset(
    kinds: str | Sequence[str],
    to: str | Path,
    *,
    n: int,
    seed: int = 0,
    frames: int = 64,
    bounces: Sequence[int] = (1,),
    where: Where = None,
    progress: Progress | None = None,
) -> Path:
    """Make a training set of n samples, or complete or lengthen the one that is there.

    Args:
        kinds: kinds of random worlds, "tuning", "testing" or "all", and world files.
        to: the `.zarr` folder; a data card is written next to it.
        n: samples in all.
        seed: of the worlds, flights and noise.
        frames: of each radar in a sample.
        bounces: reflections that are computed; one of these is drawn for each sample.
        where: number of worker processes here (1: this process; None: one for each core), or the address of a Dask
            scheduler whose workers see the folder under the same path.
        progress: called with finished samples, all samples and the current work.

    Returns:
        The folder.

    Raises:
        InputError: an argument cannot be used, the folder holds another data set, or another process writes to it.
        UllageError: the disk is full or the cluster is lost; the folder can be read, and the same call continues.
    """
    if n < 1:
        raise InputError(f"n is {n}", where="dataset", allowed="1 sample or more")
    words = (kinds,) if isinstance(kinds, str) else tuple(kinds)
    spec = SampleSpec.of(words, seed=seed, frames=frames, bounces=bounces)
    path = Path(to).resolve()
    with _only_writer(path.with_name(f".{path.name}.lock")):
        with writing(path):
            store = _create(path, spec, n)
            _write_card(store)
        _fill(store, where, progress or (lambda *_: None))
    return path


def read_index(path: str | Path) -> list[Row]:
    """Rows of a data set's index, in the order of the samples that are there.

    Raises:
        InputError: it is no data set.
    """
    store = Store.at(path)
    return [row for shard in store.shards for row in store.rows(shard)]


@dataclass(frozen=True, slots=True)
class Store:
    """A data set on disk."""

    path: Path
    spec: SampleSpec
    shard: int  # samples in one file
    n: int

    @classmethod
    def at(cls, path: str | Path) -> Store:
        """Open a data set that is there.

        Raises:
            InputError: it is no data set, or one of another format.
        """
        zarr: Any = need("zarr", extra="scale")
        where = Path(path)
        try:
            root = zarr.open_group(str(where), mode="r")
            about = json.loads(root.attrs["ullage_dataset"])
            made = about["format"], about["version"]
            if made[0] == FORMAT:
                about |= {key: tuple(about[key]) for key in ("kinds", "bounces", "digests")}
                shard = int(about.pop("shard"))
                return cls(where, SampleSpec(**about), shard, int(root["t_ns"].shape[0]))
        except Exception:  # a folder that is not a data set can raise any error in the reader
            raise InputError("no ullage data set", where=where, allowed="a new name, or a data set") from None
        raise InputError(f"a data set of format {made[0]}, made by ullage {made[1]}", where=where,
                         allowed=f"format {FORMAT}, as ullage {ullage.__version__} makes it")  # fmt: skip

    @property
    def shards(self) -> list[tuple[int, int]]:
        """First sample and the one after the last of every file."""
        return [(lo, min(lo + self.shard, self.n)) for lo in range(0, self.n, self.shard)]

    def index_file(self, lo: int) -> Path:
        """Where the rows of the shard that holds sample `lo` lie."""
        return self.path / "index" / f"{lo // self.shard * self.shard:09d}.parquet"

    def rows(self, shard: tuple[int, int]) -> list[Row]:
        """Rows of the index that a shard has so far.

        Raises:
            InputError: the file of the index is damaged.
        """
        return list(self._read(shard, lambda parquet, file: parquet.read_table(file).to_pylist()))

    def count(self, shard: tuple[int, int]) -> int:
        """How many rows of the index a shard has so far; reads only the foot of the file.

        Raises:
            InputError: the file of the index is damaged.
        """
        return int(self._read(shard, lambda parquet, file: parquet.read_metadata(file).num_rows) or 0)

    def missing(self) -> list[tuple[int, int]]:
        """Samples that are not there yet: the first and the one after the last, for each shard."""
        return [(lo + have, hi) for lo, hi in self.shards if (have := self.count((lo, hi))) < hi - lo]

    def _read(self, shard: tuple[int, int], read: Callable[[Any, Path], Any]) -> Any:
        """What `read` makes of a shard's file of the index; an empty list where there is none yet."""
        file = self.index_file(shard[0])
        if not file.exists():
            return []
        parquet: Any = need("pyarrow.parquet", extra="scale")
        try:
            return read(parquet, file)
        except (OSError, ValueError) as error:  # pyarrow's errors are among these
            raise InputError(f"cannot read: {error}", where=file, allowed="delete it to make it again") from None


@dataclass(frozen=True, slots=True)
class Part:
    """Samples of one shard that one worker makes."""

    store: Store
    lo: int
    hi: int


def make_part(part: Part, log: Log) -> int:
    """Make the samples of a part, write them, then their rows of the index; the number made.

    Raises:
        UllageError: this is another version of ullage than the client's, or the store cannot be written.
    """
    store, lo, hi = part.store, part.lo, part.hi
    if store.spec.version != ullage.__version__:
        raise UllageError(f"a worker has ullage {ullage.__version__}, the data set {store.spec.version}")
    whole = {name: np.full((hi - lo, *axes.shape), axes.fill, axes.dtype) for name, axes in layout(store.spec).items()}
    rows = []
    for k in range(lo, hi):
        log(f"sample {k}")
        arrays, row = _sample_or_reason(store.spec, k)
        for name, values in arrays.items():
            whole[name][k - lo] = values
        rows.append(row)
    with writing(store.path):
        _write_part(part, whole, rows)
    return hi - lo


def _sample_or_reason(spec: SampleSpec, k: int) -> tuple[dict[str, Any], Row]:
    """Make a sample, or a row with the reason why it cannot be made; lack of memory or disk is raised instead."""
    try:
        return sample(spec, k)
    except (OSError, MemoryError):
        raise
    except Exception as error:
        reason = str(error) if isinstance(error, UllageError) else one_line(f"{type(error).__name__}: {error}")
        return {}, {"k": k, "kind": Path(spec.kind_of(k)).name, "version": spec.version, "failed": reason}


def _write_part(part: Part, whole: dict[str, Any], rows: list[Row]) -> None:
    """Write arrays and rows of one part; a worker of a client that was lost may be writing the same part."""
    pyarrow: Any = need("pyarrow", extra="scale")
    parquet: Any = need("pyarrow.parquet", extra="scale")
    zarr: Any = need("zarr", extra="scale")
    store, file = part.store, part.store.index_file(part.lo)
    first = part.lo // store.shard * store.shard
    with _locked(file.with_name(f".{file.stem}.lock"), fcntl.LOCK_EX):  # a point: readers of tables skip it
        before = store.rows((first, part.hi))
        if len(before) >= part.hi - first:
            return
        root = zarr.open_group(str(store.path), mode="r+", use_consolidated=False)
        for name, values in whole.items():
            root[name][part.lo : part.hi] = values
        table = pyarrow.Table.from_pylist([*before[: part.lo - first], *rows], schema=_schema())
        write_whole(file, lambda out: parquet.write_table(table, out))


def _fill(store: Store, where: Where, progress: Progress) -> None:
    """Make the samples that are missing."""
    parts = [Part(store, lo, hi) for lo, hi in store.missing()]
    done = store.n - sum(part.hi - part.lo for part in parts)
    progress(done, store.n, "starting")
    with closing(each_done(make_part, parts, where=where, log=lambda text: progress(done, store.n, text))) as results:
        for part, made, error in results:
            if error is not None:
                raise error
            done += made
            progress(done, store.n, f"samples {part.lo} to {part.hi - 1} done")


def _create(path: Path, spec: SampleSpec, n: int) -> Store:
    """Make an empty data set, or open the one that is there and lengthen it to n samples.

    Raises:
        InputError: the folder is not a data set, or one with other settings.
    """
    zarr: Any = need("zarr", extra="scale")
    if path.exists():
        store = Store.at(path)
        mine, theirs = asdict(spec), asdict(store.spec)
        for key in ("version", "kinds", "digests", "seed", "frames", "bounces"):
            if mine[key] != theirs[key]:
                raise InputError(f"the data set has {key} {theirs[key]}, not {mine[key]}", where=path,
                                 allowed="the same settings, or a new name")  # fmt: skip
        if n > store.n:
            root = zarr.open_group(str(path), mode="r+", use_consolidated=False)
            for name in layout(spec):
                root[name].resize((n, *root[name].shape[1:]))
            _consolidate(path)
        return Store(path, store.spec, store.shard, max(n, store.n))
    store = Store(path, spec, SHARD if n >= SMALL_N else SMALL_SHARD, n)
    draft = path.with_name(f".{path.name}.draft")
    shutil.rmtree(draft, ignore_errors=True)
    _write_empty(draft, store)
    draft.rename(path)
    return store


def _write_empty(folder: Path, store: Store) -> None:
    """Write a data set without samples."""
    zarr: Any = need("zarr", extra="scale")
    about = json.dumps({**asdict(store.spec), "shard": store.shard})
    root = zarr.create_group(str(folder), attributes={"ullage_dataset": about})
    for name, axes in layout(store.spec).items():
        root.create_array(
            name, shape=(store.n, *axes.shape), chunks=(1, *axes.shape), shards=(store.shard, *axes.shape),
            dtype=axes.dtype, fill_value=axes.fill, dimension_names=("sample", *axes.names),
        )  # fmt: skip
    for name, (values, names) in coordinates().items():
        array = root.create_array(name, shape=values.shape, dtype=values.dtype, dimension_names=names)
        array[...] = values
    _consolidate(folder)
    (folder / "index").mkdir()


def _consolidate(path: Path) -> None:
    """Gather the metadata of all arrays in one file, so that opening takes one read."""
    zarr: Any = need("zarr", extra="scale")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Consolidated metadata", UserWarning)  # not in the specification yet
        warnings.filterwarnings("ignore", "Object at index", UserWarning)  # the index is no array
        zarr.consolidate_metadata(str(path))


def _schema() -> Any:
    """Types of the columns of the index."""
    pyarrow: Any = need("pyarrow", extra="scale")
    number, whole, text = pyarrow.float64(), pyarrow.int64(), pyarrow.string()
    return pyarrow.schema(list({
        "k": whole, "kind": text, "world_seed": whole, "noise_seed": whole, "first_frame": whole, "bounces": whole,
        "noise_m": number, "drift_m": number, "thermal": number, "height_m": number, "antenna": text,
        "azimuth_deg": number, "elevation_deg": number, "objects": pyarrow.list_(text),
        "materials": pyarrow.list_(text), "version": text, "failed": text,
    }.items()))  # fmt: skip


@contextmanager
def _only_writer(lock: Path) -> Iterator[None]:
    """Hold the data set's lock; the system releases it when this process ends."""
    with writing(lock.parent):
        lock.parent.mkdir(parents=True, exist_ok=True)
    try:
        with _locked(lock, fcntl.LOCK_EX | fcntl.LOCK_NB):
            yield
    except BlockingIOError:
        where = lock.with_name(lock.name[1:-5])
        raise InputError("another process writes to it", where=where, allowed="one writer at a time") from None


@contextmanager
def _locked(lock: Path, how: int) -> Iterator[None]:
    """Hold a file's lock."""
    held = os.open(lock, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(held, how)
        yield
    finally:
        os.close(held)


def _write_card(store: Store) -> None:
    """Write the data card beside the store: what it holds, how it was made, limits, licence."""
    from jinja2 import Environment, StrictUndefined

    plain = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    spec, arrays = store.spec, layout(store.spec)
    text = plain.from_string(CARD.read_text(encoding="utf-8")).render(
        store=store, spec=spec, sensors=len(SENSORS), worlds=[Path(kind).name for kind in spec.kinds], arrays=arrays,
        types={name: np.dtype(one.dtype).name for name, one in arrays.items()}, content=CONTENT,
    )  # fmt: skip
    write_whole(store.path.with_suffix(".md"), lambda file: file.write(text.encode()))
