"""Every statement about the thesis' own method can fail: broken methods, and the statements that fall with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import ullage.experiments.reproduce.detection_laws
import ullage.experiments.reproduce.hall
import ullage.processing.elfes
import ullage.processing.summation
import ullage.radar.rays
import ullage.radar.receiver
import ullage.radar.simulate
from ullage.experiments.laws import strafe
from ullage.experiments.reproduce import baseline, detection_laws, hall, room
from ullage.experiments.reproduce.bench import Bench
from ullage.fan import ray_fan, reaching_max_range
from ullage.world.library import WORLDS

Patch = pytest.MonkeyPatch


def statements(folder: Path) -> dict[str, bool]:
    bench = Bench(folder, True, lambda _: None, folder)
    baseline.run(bench)
    return {s.text: s.holds for s in bench.findings.statements}


def deposit_as(*, cosine: float = 1.0, spread: float = 2.0, coefficient: bool = True) -> Callable[..., None]:
    """Eq. 4.2 with other exponents of its terms."""

    def deposit(face, distance, cos, reflection, near_m, far_m, start_m, bin_m, out):
        ok = (face >= 0) & (distance >= near_m) & (distance <= far_m)
        bins = np.floor((np.where(ok, distance, 0) - start_m) / bin_m + 0.5).astype(int)
        ok &= (bins >= 0) & (bins < out.shape[1])
        rows = np.nonzero(ok)[0]
        i_m = reflection[face[ok]] if coefficient else 1.0
        np.add.at(out, (rows, bins[ok]), i_m * cos[ok] ** cosine * (distance[ok] / far_m) ** spread)

    return deposit


def term(**changes) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(ullage.radar.rays, "deposit", deposit_as(**changes))


def ranges_too_long(patch: Patch) -> None:
    kept = ullage.radar.simulate.echoes_thesis

    def later(scene, path, spec, **options):
        return np.roll(kept(scene, path, spec, **options), round(0.25 / spec.bin_m), axis=1)

    patch.setattr(ullage.radar.simulate, "echoes_thesis", later)


def narrow_rays(patch: Patch) -> None:
    patch.setattr(ullage.radar.rays, "ray_fan", lambda spec: ray_fan(spec.but(fov_deg=20.0)))


def narrow_lobe(patch: Patch) -> None:
    kept = ullage.processing.elfes.ElfesMapper.__init__
    patch.setattr(
        ullage.processing.elfes.ElfesMapper, "__init__", lambda self, *a, **k: kept(self, *a, **k | {"lobe_deg": 20.0})
    )


def no_average(patch: Patch) -> None:
    for module in (ullage.radar.rays, ullage.radar.receiver):
        patch.setattr(module, "smoothed", lambda rows, spec: rows.copy())


def no_noise(patch: Patch) -> None:
    patch.setattr(ullage.radar.simulate, "receive_thesis", lambda clean, spec, **_: clean)


def short_axis(patch: Patch) -> None:
    patch.setattr(ullage.radar.simulate, "reaching_max_range", lambda spec: spec)


def no_max_range(patch: Patch) -> None:
    kept = ullage.radar.rays.deposit
    patch.setattr(ullage.radar.rays, "deposit", lambda *a: kept(*a[:5], 11.0, *a[6:]))
    patch.setattr(
        ullage.radar.simulate,
        "reaching_max_range",
        lambda spec: reaching_max_range(spec.but(thesis=spec.thesis.but(max_range_m=11.0))),
    )


def dense_rays(patch: Patch) -> None:
    patch.setattr(ullage.radar.rays, "ray_fan", lambda spec: ray_fan(spec.but(rays_per_side=100)))


def elfes_as(
    *, cancel: bool = True, normalise: bool = True, flat: bool = False, arc: bool = True
) -> Callable[[Patch], None]:
    """Elfes' update with a density or a step changed."""

    def insert(empty, occupied, x0, y0, step, x, y, yaw, near, reach, spread, echo, half, box):
        box[:] = 0, empty.shape[0], 0, empty.shape[1]
        dx = x0 + (np.arange(empty.shape[1]) + 0.5)[None] * step - x
        dy = y0 + (np.arange(empty.shape[0]) + 0.5)[:, None] * step - y
        d, angle = np.hypot(dx, dy), np.angle(np.exp(1j * (np.arctan2(dy, dx) - yaw))) / half
        across = np.where(abs(angle) <= 1, 1.0 if flat else 1 - angle**2, 0)
        clear = reach - spread if echo else reach
        part = np.where((d >= near) & (d < clear), 1 - ((d - near) / (clear - near)) ** 2, 0) * across
        empty += part - empty * part
        if echo and arc:
            f_o = np.where(abs(d - reach) <= spread, 1 - ((d - reach) / spread) ** 2, 0) * across
            f_o = f_o * (1 - empty) if cancel else f_o
            f_o = f_o / max(f_o.sum(), 1e-12) if normalise else f_o
            occupied += f_o - occupied * f_o

    return lambda patch: patch.setattr(ullage.processing.elfes, "insert_reading", insert)


def parabola(patch: Patch) -> None:
    def fitted(across, along):
        a, b, c = np.polyfit(across, along, 2)
        return ((-b / (2 * a), c - b * b / (4 * a)), 1.0)

    patch.setattr(ullage.processing.summation, "_hyperbola", fitted)


def nearest_edge(patch: Patch) -> None:
    kept = ullage.processing.summation._place
    patch.setattr(ullage.processing.summation, "_place", lambda i, t, at: kept(i, t, (at[0], at[1] + 5)))


MUTANTS: dict[str, tuple[Callable[[Patch], None], tuple[str, ...]]] = {
    "eq. 4.2 without its cosine": (term(cosine=0.0), ("turned by 45 deg",)),
    "eq. 4.2 without its range": (term(spread=0.0), ("the ray's area grows",)),
    "eq. 4.2 with the range once": (term(spread=1.0), ("the ray's area grows",)),
    "eq. 4.2 without the coefficient": (term(coefficient=False), ("a wooden plate",)),
    "ranges 0.25 m too long": (ranges_too_long, ("lie at their ranges",)),
    "rays over 20 deg": (narrow_rays, ("rays: headings between",)),
    "Elfes' lobe of 20 deg": (narrow_lobe, ("of the circle known", "cell by cell")),
    "no moving average": (no_average, ("local maxima", "white noise")),
    "no noise": (no_noise, ("white noise",)),
    "an axis that ends at 9.61 m": (short_axis, ("at 9.7 m, within R_max",)),
    "no maximum range": (no_max_range, ("at 10.3 m, beyond R_max",)),
    "more than three times as many rays a side": (dense_rays, ("no ray meets the post",)),
    "no cancelling by emptiness": (elfes_as(cancel=False), ("cell by cell",)),
    "no normalising": (elfes_as(normalise=False), ("cell by cell",)),
    "densities flat across the lobe": (elfes_as(flat=True), ("cell by cell",)),
    "nothing is ever occupied": (elfes_as(arc=False), ("more likely occupied",)),
    "a parabola for the hyperbola": (parabola, ("the apex of the fitted hyperbola",)),
    "an apex 0.25 m too far": (nearest_edge, ("the apex of the fitted hyperbola",)),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> dict[str, bool]:
    return statements(tmp_path_factory.mktemp("sound"))


def test_the_method_as_it_is_holds_all(sound):
    assert all(sound.values()), [text for text, holds in sound.items() if not holds]


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_method_breaks_the_statement_about_it(name, sound, tmp_path, monkeypatch):
    patch, expected = MUTANTS[name]
    patch(monkeypatch)
    fallen = [text for text, holds in statements(tmp_path).items() if not holds]
    for words in expected:
        assert any(words in text for text in fallen), (name, words, fallen)


def test_every_statement_falls_to_a_mutant(sound):
    expected = [words for _, all_words in MUTANTS.values() for words in all_words]
    left = [text for text in sound if not any(words in text for words in expected)]
    assert not left


def readings_too_far(patch: Patch) -> None:
    kept = ullage.processing.elfes.first_echo

    def farther(frames, **options):
        reach, found = kept(frames, **options)
        return reach + 0.25, found

    patch.setattr(ullage.processing.elfes, "first_echo", farther)


def unlimited(patch: Patch) -> None:
    patch.setattr(ullage.experiments.reproduce.hall, "LIMITED", 1.0)


def floor_stays(patch: Patch) -> None:
    patch.setattr(ullage.experiments.reproduce.detection_laws, "suppress_floor", lambda frames: frames)


def brightness(bench: Bench) -> None:
    detection_laws.brightness(bench)


def clutter(bench: Bench) -> None:
    scene = WORLDS["ntnu-wire"].scene()
    detection_laws.clutter(bench, scene, strafe("ntnu-wire"), np.array([0.0, 0.0, 1.1]))


FLIGHTS: dict[str, tuple[Callable[[Bench], None], Callable[[Patch], None], tuple[str, ...]]] = {
    "turned plate, eq. 4.2 without its cosine": (brightness, term(cosine=0.0), ("the same, summed over range",)),
    "floor, not suppressed": (clutter, floor_stays, ("the floor goes at the wire's range", "so much is left")),
    "cluttered room, readings 0.25 m too far": (hall.run, readings_too_far, ("is on the map",)),
    "cluttered room, certainty without a limit": (hall.run, unlimited, ("hovering beside the person",)),
    "NTNU room, readings 0.25 m too far": (room.run, readings_too_far, ("from the true surface, median",)),
    "NTNU room, a lobe of 20 deg": (room.run, narrow_lobe, ("space behind walls",)),
}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", FLIGHTS)
def test_a_broken_method_breaks_a_statement_about_the_flights(name, tmp_path, monkeypatch):
    run, patch, expected = FLIGHTS[name]
    patch(monkeypatch)
    bench = Bench(tmp_path, True, lambda _: None, tmp_path)
    run(bench)
    fallen = [s.text for s in bench.findings.statements if not s.holds]
    for words in expected:
        assert any(words in text for text in fallen), (name, words, fallen)
