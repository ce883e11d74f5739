"""Other people's worlds: what libsdformat accepts loads here, and the rest is refused in one line.

ULLAGE_SDF_CORPORA names folders, with a colon between: each holds .sdf and .world files, folders of models, or both, as
examples/worlds of gz-sim and gazebo_models do. `pytest -s` shows the counts.
"""

import collections
import os
import subprocess
import time
import warnings
from pathlib import Path

import pytest

import ullage as ul
from ullage.errors import InputError, UllageWarning
from ullage.world.sdf_parse import Place
from ullage.world.sdf_resolve import model_file

MOST_NOTES = 8  # lines of warnings for one file
CORPORA = [Path(one) for one in os.environ.get("ULLAGE_SDF_CORPORA", "").split(os.pathsep) if one]


def files(folder):
    """World files of a folder, and the file of each model folder in it."""
    yield from sorted(path for path in folder.iterdir() if path.suffix in (".sdf", ".world"))
    for model in sorted(path.parent for path in folder.glob("*/model.config")):
        yield model_file(model, at=Place(model, 1))


def loaded(path, **options):
    """Why ullage refuses a file (empty: it does not), its warnings, and the processor time it took."""
    began = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UllageWarning)
        try:
            ul.load_scene(path, **options)
            said = ""
        except InputError as error:
            said = str(error)
    return said, [str(one.message) for one in caught], time.process_time() - began


def kind(said):
    """What a refusal says, less its place and its names."""
    for words in ("is on the network", "is not found", "not XML"):
        if words in said:
            return words
    return said


@pytest.mark.slow
@pytest.mark.skipif(not CORPORA, reason="ULLAGE_SDF_CORPORA names no folders of SDF files")
@pytest.mark.parametrize("folder", CORPORA, ids=lambda folder: folder.name)
def test_what_libsdformat_accepts_loads(folder, oracle):
    counts, wrong, slowest = collections.Counter(), [], []
    for path in files(folder):
        said, notes, seconds = loaded(path, search_path=[folder])
        accepted = not subprocess.run([oracle, path, folder], capture_output=True, check=False).returncode
        counts[f"{'accepted' if accepted else 'refused'} by libsdformat, {kind(said) or 'loads'}"] += 1
        slowest.append((seconds, path.name))
        if "\n" in said or len(notes) > MOST_NOTES:
            wrong.append((path, said, notes))
        # libsdformat opens no mesh, so that one may be missing
        if said and accepted and loaded(path, search_path=[folder], missing="skip")[0]:
            wrong.append((path, said, notes))
    print(f"\n{folder}:", *(f"{count:5d} {what}" for what, count in counts.most_common()), sep="\n  ")
    print("  most processor time:", ", ".join(f"{name} {seconds:.1f} s" for seconds, name in sorted(slowest)[-5:]))
    assert counts
    assert not wrong
