"""A wall is a mirror: what is some 30 dB fainter than one is an edge, whatever its ranges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import fresnel

from ullage.processing.mapper_echoes import Echo
from ullage.processing.mapper_legs import Legs
from ullage.processing.mapper_loudness import facing_db, fallen, level_db, too_faint

AHEAD, LEAST = np.array([0.0, 1.0, 0.0]), float(np.cos(np.radians(50)))
BORESIGHT_DBI, WAVE_M = 6.0, 0.041
PERMITTIVITY = {"ceiling board": 1.48, "wood": 1.99, "plasterboard": 2.73, "concrete": 5.24}  # [ITU-R-P2040]


def echoes_of(db: float, *, range_m: float = 3.0, count: int = 9) -> list[Echo]:
    """Echoes that lie so far under those of a perfect mirror on boresight."""
    x = np.array([1.0, 0, 0])
    return [
        Echo(j, 0.05 * j * x, x, range_m, 0.0, 1e-3, 0.02, 0.9, AHEAD, level_db=db + 2 * BORESIGHT_DBI)
        for j in range(count)
    ]


def turned(off_deg: float) -> np.ndarray:
    return np.array([0.0, np.cos(np.radians(off_deg)), np.sin(np.radians(off_deg))])


@pytest.mark.parametrize("material", PERMITTIVITY)
def test_no_building_material_is_too_faint_for_a_wall(material):
    index = np.sqrt(PERMITTIVITY[material])
    fresnel_db = 20 * np.log10((index - 1) / (index + 1))
    assert not too_faint(echoes_of(fresnel_db), AHEAD)


@pytest.mark.parametrize("range_m", [1.0, 3.0, 9.0])
def test_a_straight_edge_is_too_faint_for_a_wall(range_m):
    wavenumber = 2 * np.pi / 0.0411
    edge_db = 20 * np.log10(np.sqrt(2 / range_m) / np.sqrt(2 * np.pi * wavenumber))  # twice a half-plane's least
    assert too_faint(echoes_of(edge_db, range_m=range_m), AHEAD)


def test_a_wall_off_boresight_is_as_much_fainter_as_the_antenna_says():
    wood = echoes_of(-15 - 2 * 3.0)  # out and back
    assert not too_faint(wood, turned(32.5))
    assert too_faint(echoes_of(-18 - 7.0), AHEAD)
    assert not too_faint(echoes_of(-24 - 5.5), turned(32.5))
    assert too_faint(echoes_of(-24 - 6.5), turned(32.5))
    assert not too_faint(echoes_of(-18 - 7.0), turned(47.0))
    assert not too_faint(echoes_of(-60.0), turned(60.0))


def test_past_its_focus_a_hollow_wall_is_louder_than_a_flat_one():
    radius = 4.0
    echoes = echoes_of(-22.0, range_m=5.2)
    assert not too_faint(echoes, AHEAD)
    assert too_faint(echoes, AHEAD, radius)
    assert too_faint(echoes_of(-13.0, range_m=4.001), AHEAD, radius) is False


def test_nothing_is_too_faint_where_no_level_is_known():
    assert level_db(1e-9, np.inf) == np.inf
    assert level_db(1e-3, 1e-3) == pytest.approx(0.0)
    plain = [Echo(j, np.zeros(3), AHEAD, 3.0, 0.0, 1e-9, 0.02, 0.9, AHEAD) for j in range(5)]
    assert not too_faint(plain, AHEAD)


@pytest.mark.parametrize(("db", "told"), [(-10.0, True), (-30.0, False)])
def test_legs_tell_no_wall_of_what_is_too_faint(db, told):
    rng, legs, out = np.random.default_rng(3), Legs(), []
    for z in (-0.7, 0.0, 0.7):
        at = np.column_stack([np.arange(0.0, 4.0, 0.05), np.zeros(80), np.full(80, z)])
        reach = 3.0 + rng.normal(0, 0.004, len(at))
        for k in range(0, 65, 13):
            echoes = [
                Echo(j, at[j], np.array([1.0, 0, 0]), reach[j], 0.0, 1e-3, 0.02, 0.9, AHEAD, level_db=db + 12.0)
                for j in range(k, k + 13)
            ]
            legs.add(echoes, echoes, AHEAD, LEAST, 2.0)
    out += legs.tell_all()
    assert bool(out) is told


def half_plane(beyond_m: np.ndarray, range_m: float) -> list[Echo]:
    """Echoes off a mirror that ends where it is flown past, so far from the feet [m]: Cornu's spiral [BornWolf1999]."""
    v = -2 * beyond_m / np.sqrt(WAVE_M * range_m)
    sine, cosine = fresnel(v)
    level = 20 * np.log10(np.abs((0.5 + cosine) + 1j * (0.5 + sine)) / np.sqrt(2)) + 2 * BORESIGHT_DBI
    x = np.array([1.0, 0, 0])
    return [
        Echo(j, at * x, x, range_m, 0.0, 1e-3, 0.02, 0.9, AHEAD, level_db=float(level[j]))
        for j, at in enumerate(beyond_m)
    ]


@pytest.mark.parametrize("range_m", [1.5, 3.0, 6.0])
def test_past_the_edge_of_a_wall_its_echo_has_fallen_by_six_decibels(range_m):
    beyond = np.arange(-1.0, 0.6, 0.05) + 0.01
    echoes = half_plane(beyond, range_m)
    gone = fallen(echoes, echoes, AHEAD, np.sqrt(WAVE_M / 2))
    wall = np.array([facing_db(e, AHEAD) for e in echoes]) > -24.0  # what is fainter is none anyway
    assert gone[(beyond > 0.02) & wall].all()
    assert not gone[beyond < -0.02].any()


def test_a_wall_of_less_reflectivity_beside_another_is_one_farther_on():
    echoes = echoes_of(0.0, count=40)
    for e in echoes[20:]:
        e.level_db -= 8.0
    gone = fallen(echoes, echoes, AHEAD, np.sqrt(WAVE_M / 2))
    assert gone[20:25].all()
    assert not gone[32:].any()
    assert not fallen(echoes, echoes, turned(60.0), np.sqrt(WAVE_M / 2)).any(), "no level is known there"
