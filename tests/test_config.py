"""Scenario files: round trip, overlay, bad input with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import ullage as ul
from ullage.config import Scenario, make_scenario, read_scenario, scenario_schema, scenario_text
from ullage.experiments.catalog import find_scenario, scenario_names


@pytest.mark.parametrize("name", scenario_names())
def test_a_shipped_scenario_comes_back_from_its_own_text(name: str) -> None:
    scenario = find_scenario(name)
    assert Scenario(**yaml.safe_load(scenario_text(scenario))) == scenario
    assert scenario.title


def test_options_are_laid_over_the_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("map: {step_m: 0.5}\n")
    scenario = read_scenario(file, options=["map.step_m=0.2", "sensing.changes={iterations: 32}"])
    assert scenario.name == "mine"
    assert scenario.map.step_m == 0.2
    assert scenario.sensing.radars().sensors["front"].iterations == 32


def test_the_digest_follows_the_settings() -> None:
    one, same, other = (make_scenario({"name": "a", "seed": seed}) for seed in (1, 1, 2))
    assert one.digest == same.digest != other.digest


def test_the_schema_names_every_group() -> None:
    assert {"world", "flight", "sensing", "map", "expect"} <= set(scenario_schema()["properties"])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"seed: 3\nmap: {step_m: -1}", r":2: map.step_m is -1 .allowed: greater than 0"),
        (b"map:\n  method: elfes\n  stap_m: 1", r":3: map.stap_m: no such setting .allowed: method, step_m"),
        (b"sensing:\n  changes:\n    fps: 4\n    bins: 2", r":4: sensing.changes.bins is 2"),
        (b"sensing: {preset: x5}", r":1: sensing: no radar preset 'x5' .allowed: x4m05"),
        (b"map: [1, 2]", ":1: map"),
        (b"seed: 3\nmap: {step_m: 1}\nseed: 4", r":3: not YAML: the name 'seed' stands twice"),
        (b"map: {step_m: 1, dims: 2, step_m: 2}", "the name 'step_m' stands twice"),
        (b"a: b: c", "not YAML.*|mapping values"),
        (b"\xff\xfea\x00", "not UTF-8"),
        (b"", "not a scenario"),
        (b"3", "not a scenario"),
        (b"colour: red", "colour"),
        (b"flight: {waypoints: [[0, 0, .nan]]}", "waypoints"),
        (b"flight: {waypoints: [[0, 0]]}", ":1: flight.waypoints: waypoint 0 has 2 numbers .allowed: x, y, z"),
        (b"flight: {waypoints: [[0, 0, 1], [1, 0, 1, 90]]}", "waypoint 1 has 4 numbers"),
        (b"flight: {waypoints: [[0, 0, 1, 90, 0]]}", "waypoint 0 has 5 numbers"),
    ],
)
def test_a_bad_scenario_is_refused_with_its_file(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_bytes(content)
    with pytest.raises(ul.InputError, match=words) as caught:
        read_scenario(file)
    assert "bad.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_merged_group_may_be_changed(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text("expect: {f1: &one {min: 0.1, max: 0.9}, recall: {<<: *one, min: 0.2}}")
    assert read_scenario(file).expect["recall"].model_dump() == {"min": 0.2, "max": 0.9}


def test_a_file_name_of_any_letters_names_the_run(tmp_path: Path) -> None:
    file = tmp_path / "ü my yard.yaml"
    file.write_text("seed: 3")
    assert read_scenario(file).name == "my-yard"


@pytest.mark.parametrize("option", ["map.step_m", "=3", "seed.x=3", "map.step_m=[", "nothing=3"])
def test_a_bad_option_is_refused(option: str) -> None:
    with pytest.raises(ul.InputError):
        make_scenario({"name": "a"}, options=[option])


def test_a_bad_option_is_told_apart_from_the_file(tmp_path: Path) -> None:
    file = tmp_path / "good.yaml"
    file.write_text("map: {step_m: 1}")
    with pytest.raises(ul.InputError, match=r"^-o: map.step_m is -1"):
        read_scenario(file, options=["map.step_m=-1"])


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ul.InputError, match=r"nowhere.yaml: No such file"):
        read_scenario("nowhere.yaml")


def test_an_option_brings_the_one_value_that_fits_it_unless_that_is_given_too() -> None:
    tree = {"name": "x", "flight": {"vehicle": "ideal"}, "image": {"method": "backprojection"}}
    assert make_scenario(tree, options=["sensing.fidelity=thesis"]).image.method == "summation"
    assert make_scenario(tree, options=["flight.guard.on=true"]).flight.vehicle == "hector"
    assert make_scenario(tree, options=["seed=1"]).flight.vehicle == "ideal"
    with pytest.raises(ul.InputError, match="has to be summation"):
        make_scenario(tree, options=["sensing.fidelity=thesis", "image.method=backprojection"])
