"""Give files to their readers, one after the other, and print one JSON line for each; run in a process of its own.

Arguments: a folder to write in. Lines of input: reader, tab, file.
"""

from __future__ import annotations

import json
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import ullage as ul
from ullage import ports
from ullage.config import make_scenario
from ullage.errors import DamageWarning
from ullage.experiments.catalog import find_scenario


def read_map_server(path: Path) -> object:
    """A map and its image in one file, as they were when they broke a reader: length of the text, text, image."""
    blob = path.read_bytes()
    size = int.from_bytes(blob[:4], "little")
    home = Path(sys.argv[1])
    name = next((w for w in ("trinary.pgm", "raw.pgm", "scale.png") if w.encode() in blob[: 4 + size]), "m.pgm")
    (home / name).write_bytes(blob[4 + size :])
    (home / path.name).write_bytes(blob[4 : 4 + size])
    return ports.read_map(home / path.name)


def read_recording(path: Path) -> None:
    source = ports.open(path)
    errors = []
    for part in (source.frames, source.trajectory, source.map):
        try:
            part()
        except (ul.InputError, DamageWarning) as error:
            errors.append(error)
    if errors:
        raise errors[0]


def read_motive(path: Path) -> object:
    from ullage.ports.tracks import read_tracks

    return read_tracks(path)


def read_option(path: Path) -> object:
    from ullage.ports.imc.options import SourceOptions, endpoint
    from ullage.ports.live import Address, options_of

    text = path.read_text()
    if path.suffix == ".o":
        return make_scenario({"name": "x"}, options=[text])
    address = Address.of(text)
    assert address is not None
    return endpoint(address.place), options_of(SourceOptions, address.options, "imc")


READERS: dict[str, Callable[[Path], object]] = {
    "map": read_map_server, "octo": ports.read_map, "mcapmsg": read_recording, "bag": read_recording,
    "motive": read_motive, "cli": read_option, "sdf": ul.load_scene, "urdf": ul.load_scene, "xacro": ul.load_scene,
    "scenario": lambda path: find_scenario(str(path)), "recording": read_recording, "read_map": ports.read_map,
}  # fmt: skip


def peak_mb() -> float:
    """Peak memory of this process alone; getrusage would count that of the process that started it too."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def main() -> None:
    warnings.simplefilter("ignore")
    warnings.simplefilter("error", DamageWarning)  # damaged messages are left out, and one line says so
    for line in sys.stdin.read().splitlines():
        kind, name = line.split("\t")
        begun = time.process_time()
        said, trouble = "", ""
        try:
            READERS[kind](Path(name))
        except (ul.InputError, DamageWarning) as error:
            said = str(error)
        except Exception:
            trouble = traceback.format_exc()
        megabytes = peak_mb()
        out = {
            "kind": kind,
            "file": name,
            "said": said,
            "trouble": trouble,
            "mb": megabytes,
            "s": time.process_time() - begun,
        }
        print(json.dumps(out), flush=True)


if __name__ == "__main__":
    main()
