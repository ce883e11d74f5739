"""Choose the reader or writer of a recording, a map file or a live port by its name."""

from __future__ import annotations

import inspect
import logging
import os
import stat
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

from ullage import checks, plugins
from ullage.data import Frames
from ullage.errors import InputError, need, shown
from ullage.flow import Sink
from ullage.grids import OccupancyMap
from ullage.ports.arrays import refuse_pickle
from ullage.ports.live import LISTED, LISTED_SINKS, LIVE, Address, named
from ullage.ports.protocol import Item, Source, WholeSource
from ullage.ports.tracked import open_tracked
from ullage.untrusted import load_yaml, read_yaml, reading, regular_size

Made = TypeVar("Made")
SOURCES = (
    ".mcap, .bag, .db3, .zarr, DUNE's .lsf or .lsf.gz, an X4 .dat, a PulsON .out or .json, arrays in .npz, .mat "
    "or .h5, or a folder with frames.mcap, metadata.yaml, or radar.out (.npz, .mat, .h5, .dat, .json) and a track "
    "(mocap.csv, track.csv, .txt, .ulg, .bin, .nmea, .ubx, .mcap, .bag)"
)
SINKS = f".mcap, a folder, .zarr, .lsf, .lsf.gz, a map: .yaml, .bt, .ot, .ply; or live: {LISTED_SINKS}"
NEEDED = {"ros2": ("rclpy",), "gazebo": ("zmq", "google.protobuf"), "mavlink": ("pymavlink",)}
"""Libraries of live ports beyond those of every installation, in the extra of the port's name."""
FILES = {
    ".mcap": ("ros2.bags.open_mcap", "bag.McapSink"),
    ".zarr": ("store.ZarrSource", "store.ZarrSink"),
    ".lsf": ("imc.lsf.LsfSource", "imc.lsf.LsfSink"),
    ".lsf.gz": ("imc.lsf.LsfSource", "imc.lsf.LsfSink"),
    ".dat": ("radar_logs.X4Source", ""),
    ".npz": ("tracked.open_arrays", ""),
    ".mat": ("tracked.open_arrays", ""),
    ".h5": ("tracked.open_arrays", ""),
    ".hdf5": ("tracked.open_arrays", ""),
    ".out": ("tracked.open_log", ""),
    ".json": ("tracked.open_log", ""),
    ".bag": ("ros2.bags.RosbagSource", ""),
    ".db3": ("ros2.bags.RosbagSource", ""),
}
"""Reader and writer of each kind of file, as `module.name` beneath `ullage.ports`."""
RADARS = (".out", ".npz", ".mat", ".h5", ".dat", ".json")
"""Kinds of `radar.*` in a folder with a track."""
BESIDE = ("track", "topic", "datum", "mount")
"""Options of a track beside a recording."""
MAPS = {
    ".yaml": ("maps.read_map_server", "maps.write_map_server"),
    ".pgm": ("maps.read_map_server", "maps.write_map_server"),
    ".bt": ("octomap.read_octomap", "octomap.write_octomap"),
    ".ot": ("octomap.read_octomap", "octomap.write_octomap"),
    ".ply": ("maps.read_ply", "maps.write_ply"),
}
"""The same of map files."""


def open(target: str | Path, **options: Any) -> Source:
    """Open a recording of any kind, or a live port.

    Args:
        target: a `.mcap` file, a run's or rosbag2 folder, DUNE's `.lsf` or `.lsf.gz`, an X4 `.dat`, a PulsON `.out`,
            arrays in `.npz`, `.mat` or `.h5`, a folder with one of these as radar.* and a track, or a live port as
            `scheme:place?key=value`; options of a file may follow it in the same way.
        **options: of that kind: X4 takes fps and range_start_m; arrays take preset and mount (a MountSpec). Every file
            of a radar takes track, the file of its track, with topic (in a bag), datum (of fixes) and mount.

    Raises:
        InputError: it is missing, of unknown kind, or damaged; the methods of the source raise it too.
    """
    path = _path_of(target, SOURCES)
    if not os.path.exists(path) and os.path.exists(name := str(target).partition("?")[0]):
        path, options = Path(name), _written_options(str(target)) | options
    if not os.path.exists(path):
        if address := Address.of(target, **options):
            live: Source = address.open("source")
            return live
        raise InputError("no such file or folder", where=target, allowed=f"{SOURCES}; or live: {LISTED}")
    with reading(path):
        source = _opened(path, options)
    logging.getLogger("ullage").debug("%s is read by %s", path, type(source).__name__)
    guarded: Any = source if isinstance(source, WholeSource) else GuardedSource(source, path)
    return cast("Source", guarded)


def reads(path: Path) -> bool:
    """Whether a reader of recordings takes such a name: a folder, or a file by its suffix."""
    known = (*FILES, *(name for name in plugins.names("ullage.sources") if name.startswith(".")))
    return os.path.isdir(path) or path.name.lower().endswith(known)


def _written_options(target: str) -> dict[str, Any]:
    """The options after a file's name, `file?key=value&key=value`, as numbers, text or groups."""
    given = Address.of(f"file:{target}")
    return {} if given is None else {k: load_yaml(text, where=target) for k, text in given.options.items()}


def _path_of(target: str | Path, allowed: str) -> Path:
    """The path of a target that names something.

    Raises:
        InputError: it is no name.
    """
    if not isinstance(target, str | os.PathLike) or not os.fspath(target):
        raise InputError(f"{shown(target)} names nothing", allowed=allowed)
    return Path(target)


def _opened(path: Path, options: dict[str, Any]) -> Source:
    """Open a file or folder with the reader of its suffix."""
    if path.is_dir():
        store = path.suffix.lower() == ".zarr"
        only_files(path, below=store or (path / "metadata.yaml").exists())
        if not store:
            return _open_folder(path, options)
    else:
        regular_size(path, allowed=SOURCES)
        refuse_pickle(path)
    if suffix_of(path) in FILES:
        return _on_track(path, options) if options.get("track") else _open_file(path, options)
    reader: Callable[..., Source] | None = plugins.load("ullage.sources", path.suffix.lower())
    if reader is not None:
        return with_options(reader, path, options)
    raise InputError("not a recording", where=path, allowed=_with_added(SOURCES, "ullage.sources"))


def suffix_of(path: Path) -> str:
    """Return the suffix of a file in small letters; that of a packed log has two parts."""
    kind = path.suffix.lower()
    return f".lsf{kind}" if path.name.lower().endswith(".lsf.gz") else kind


def _with_added(allowed: str, group: plugins.Group) -> str:
    """List the allowed kinds, with the suffixes that other packages add."""
    return ", ".join((*(name for name in plugins.names(group) if name.startswith(".")), allowed))


def sink(target: str | Path, **options: Any) -> Sink:
    """Open a sink by the kind of its name.

    Args:
        target: a `.mcap` recording, a folder for one, a `.zarr` store, or a map file: `.yaml` or `.pgm` (map_server),
            `.bt` or `.ot` (OctoMap), `.ply`; or a live port as `scheme:place?key=value`.
        **options: of that kind: recordings and stores take overwrite, map_server takes mode.

    Raises:
        InputError: it is of unknown kind, or cannot be written.
    """
    path = _path_of(target, SINKS)
    if address := Address.of(target, **options):
        if not address.known or address.part("sink") is None:
            raise InputError("not something to write to", where=target, allowed=SINKS)
        live: Sink = address.open("sink")
        return live
    check_beside(path)
    kind = _kind_of_sink(path)
    if kind in MAPS:
        return MapSink(path, **options)
    name = FILES[kind or ".mcap"][1] if kind in ("", *FILES) else ""
    made: Sink = with_options(named(name) if name else plugins.load("ullage.sinks", kind), path, options)
    return made


def _kind_of_sink(path: Path) -> str:
    """Return the suffix of a file or map that is written; empty for a folder.

    Raises:
        InputError: nothing writes files of this kind.
    """
    kind = suffix_of(path)
    if kind not in (*MAPS, ".zarr") and (path.is_dir() or (not kind and not path.is_file())):
        return ""
    if kind in MAPS or FILES.get(kind, ("", ""))[1] or kind in plugins.names("ullage.sinks"):
        return kind
    raise InputError("not something to write to", where=path, allowed=_with_added(SINKS, "ullage.sinks"))


def check_sink(target: str | Path) -> None:
    """Check what can be checked of a sink without opening it: its kind, its library, and that its file can be written.

    Raises:
        InputError: it is of unknown kind, its file exists already, or its folder cannot be written.
        MissingExtra: its library is not installed.
    """
    path = _path_of(target, SINKS)
    if address := Address.of(target):
        if not address.known or (address.scheme in LIVE and not LIVE[address.scheme].sink):
            raise InputError("not something to write to", where=target, allowed=SINKS)
        for library in NEEDED.get(address.scheme, ()):
            need(library, extra=address.scheme)
        return
    kind = _kind_of_sink(path)
    if kind == ".zarr":
        need("zarr", extra="zarr")
    if kind in MAPS:
        check_beside(path)  # a map replaces the one before
    else:
        check_new(path / "frames.mcap" if path.is_dir() and not kind else path)


def check_new(path: Path) -> None:
    """Check that a file can be made.

    Raises:
        InputError: it exists already, or its folder is missing or cannot be written.
    """
    if path.exists():
        raise InputError("exists already", where=path, allowed="a new name")
    check_beside(path)


def check_beside(path: Path) -> None:
    """Check that the folder of a file exists and can be written; a mistyped one is not made.

    Raises:
        InputError: it is missing, or cannot be written.
    """
    if not path.absolute().parent.exists():
        raise InputError(f"no folder {path.parent}", where=path, allowed="a folder that exists")
    check_folder(path)


def check_folder(path: Path) -> None:
    """Check that the folder of a file, or the nearest one above it that exists, can be written.

    Raises:
        InputError: it cannot.
    """
    parent = next(folder for folder in path.absolute().parents if folder.exists())
    if not (parent.is_dir() and os.access(parent, os.W_OK | os.X_OK)):
        what = "read-only" if parent.is_dir() else "no folder"
        raise InputError(f"cannot write: {parent} is {what}", where=path, allowed="a folder that can be written")


def write_map(omap: OccupancyMap, path: str | Path, **options: Any) -> None:
    """Write a map as map_server's `.yaml` and image, OctoMap's `.bt` or `.ot`, or `.ply`, by the suffix.

    Raises:
        InputError: the suffix is another, or the map does not fit that kind.
    """
    kind = Path(path).suffix.lower()
    if kind not in MAPS:
        raise InputError("not a map file", where=path, allowed=", ".join(MAPS))
    with_options(partial(named(MAPS[kind][1]), omap), Path(path), options)


def read_map(path: str | Path, **options: Any) -> OccupancyMap:
    """Read a map of `write_map` or of another program, by the suffix.

    Raises:
        InputError: it is missing, of another kind, or damaged.
    """
    kind = Path(path).suffix.lower()
    if kind not in MAPS or kind == ".pgm":
        raise InputError("not a map file", where=path, allowed=", ".join(k for k in MAPS if k != ".pgm"))
    reader: Callable[..., OccupancyMap] = named(MAPS[kind][0])
    if not os.path.exists(path):
        raise InputError("cannot read: no such file", where=path)
    regular_size(path, allowed="a map file")
    with reading(path):
        return with_options(reader, Path(path), options)


class MapSink(Sink):
    """Sink that keeps the last map in a file and ignores other items.

    Args:
        path: of the map file; its suffix gives the kind.
        **options: of that kind.
    """

    def __init__(self, path: Path, **options: Any) -> None:
        self.path, self._options = path, options

    def write(self, item: Item) -> None:
        """Replace the file if the item is a map."""
        if isinstance(item, OccupancyMap):
            write_map(item, self.path, **self._options)


def with_options(make: Callable[..., Made], path: Path, options: dict[str, Any]) -> Made:
    """Make a source or sink; an unknown option gives one line."""
    parameters = list(inspect.signature(make).parameters.values())[1:]
    known = [one.name for one in parameters]
    for name in options if not any(one.kind is one.VAR_KEYWORD for one in parameters) else ():
        if name not in known:
            raise InputError(f"no option {name!r}", where=path, allowed=", ".join(known) or "none")
    return make(path, **options)


def _open_folder(folder: Path, options: dict[str, Any]) -> Source:
    from ullage.ports.ros2.bags import open_mcap

    radars = [folder / f"radar{kind}" for kind in RADARS if (folder / f"radar{kind}").exists()]
    if len(radars) > 1:
        names = " and ".join(one.name for one in radars)
        raise InputError(f"two radar recordings, {names}", where=folder, allowed="one of them")
    if radars:
        regular_size(radars[0])
        return _on_track(radars[0], options)
    if (folder / "frames.mcap").exists():
        return with_options(open_mcap, folder / "frames.mcap", options)
    if any(folder.glob("*.db3")):
        return _open_file(next(iter(folder.glob("*.db3"))), options)
    for name in sorted([*folder.glob("*.pkl"), *folder.glob("*.pickle")]):
        refuse_pickle(name)
    bags = sorted(folder.glob("*.mcap"))
    if len(bags) == 1:
        return with_options(open_mcap, bags[0], options)
    raise InputError("no recording in this folder", where=folder, allowed=SOURCES)


def _on_track(path: Path, options: dict[str, Any]) -> Source:
    """Open the recording of a radar and put it on its track."""
    beside = {name: options[name] for name in BESIDE if name in options}
    own = {name: value for name, value in options.items() if name not in BESIDE}
    if FILES[suffix_of(path)][0] == "tracked.open_arrays" and "mount" in options:
        own["mount"] = options["mount"]  # for poses in the file itself
    return open_tracked(path, _open_file(path, own), **beside)


def _open_file(path: Path, options: dict[str, Any]) -> Source:
    if path.suffix.lower() == ".db3" and os.path.exists(metadata := path.parent / "metadata.yaml"):
        read_yaml(metadata)  # the library that reads it knows no limits
    reader: Callable[..., Source] = named(FILES[suffix_of(path)][0])
    return with_options(reader, path, options)


class GuardedSource:
    """A recording whose reader may raise anything.

    A reader that knows where it stands says so in an attribute `place`, such as "message 17 of /radar/front".

    Args:
        source: the reader.
        path: the file that it reads.
    """

    def __init__(self, source: Source, path: Path) -> None:
        self._source, self._file = source, path

    def __getattr__(self, name: str) -> Any:
        if not hasattr(type(self._source), name):
            return getattr(self._source, name)  # nothing is read for it, or there is no such thing
        found = self._call(lambda: getattr(self._source, name))
        if not callable(found):
            return found
        return lambda *args, **options: self._call(lambda: found(*args, **options))

    def _call(self, work: Callable[[], Any]) -> Any:
        with reading(self._file, place=lambda: str(getattr(self._source, "place", ""))):
            return work()

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Give the frames in order of time, at most `chunk` of each sensor at once."""
        checks.whole("chunk", chunk, "stream", low=1)
        pieces = self._call(lambda: iter(self._source.stream(chunk)))
        while (piece := self._call(lambda: next(pieces, None))) is not None:
            yield piece


def only_files(folder: Path, *, below: bool) -> None:
    """Refuse a folder that holds anything but folders and regular files: a reader would wait for a pipe without end.

    Args:
        folder: what is to be read.
        below: look into its folders too, from which stores and bags read.

    Raises:
        InputError: something in it is a pipe, a socket or a device.
    """
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            try:
                mode = path.stat().st_mode
            except OSError:
                continue  # a broken link: the reader reports it
            if not stat.S_ISREG(mode):
                raise InputError("is a pipe, a socket or a device", where=path, allowed="regular files")
        if not below:
            return
