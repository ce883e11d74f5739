"""Occupancy maps from frames: one call, or piece by piece."""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from ullage import checks, plugins
from ullage.data import Recording, sensors_of
from ullage.errors import InputError, UllageWarning
from ullage.grids import Changes, Grid, OccupancyMap
from ullage.processing.empty_map import why_empty
from ullage.processing.health import judged
from ullage.processing.own_echo import without_own_echo
from ullage.processing.scatterers import PFA, find_scatterers, with_scatterers

BEST = "likelihood"
"""Method that "ullage" stands for."""
METHODS: Mapping[str, tuple[str, str]] = {
    "likelihood": ("ullage.processing.likelihood.methods", "likelihood_mapper"),
    "elfes": ("ullage.processing.elfes", "ElfesMapper"),
}
"""Module and class of each map method that is shipped; other packages add theirs to the group `ullage.map_methods`."""


COHERENT = ("ullage", BEST)
"""Methods whose maps take the scatterers that stay coherent along calibrated frames."""


class StreamingMapper(Protocol):
    """Interface of every mapper."""

    def update(self, frames: Recording) -> None:
        """Add frames."""

    def map(self) -> OccupancyMap:
        """Return the map so far."""

    def changed(self) -> Changes:
        """Return the blocks that changed since the last call."""

    def finish(self) -> None:
        """Use the frames that waited for a successor."""


def Mapper(grid: Grid, *, method: str = "ullage", **options: Any) -> StreamingMapper:  # noqa: N802
    """A mapper fed with pieces of a recording: `.update(frames)`, `.map()`, `.changed()`, `.finish()`.

    Args:
        grid: the cells of the map.
        method: "ullage", the best one; one of `METHODS`, or one that another package adds.
        **options: those of the method.

    Raises:
        InputError: the method or an option of it is unknown, or `grid` is no grid.
    """
    checks.instance("grid", grid, Grid, "map_occupancy")
    make: Callable[..., StreamingMapper] | None
    method = BEST if method == "ullage" else method
    if method in METHODS:
        module, name = METHODS[method]
        make = getattr(importlib.import_module(module), name)
    else:
        make = plugins.load("ullage.map_methods", method)
    if make is None:
        allowed = ", ".join(("ullage", *METHODS, *plugins.names("ullage.map_methods")))
        raise InputError(f"no mapping method {method!r}", where="method", allowed=allowed)
    known = inspect.signature(make).parameters
    any_option = any(one.kind is one.VAR_KEYWORD for one in known.values())
    if not any_option and (unknown := [name for name in options if name not in known]):
        allowed = ", ".join(name for name, one in known.items() if one.kind is one.KEYWORD_ONLY)
        raise InputError(f"no option {unknown[0]!r} of method {method!r}", where="map_occupancy", allowed=allowed)
    return make(grid, **options)


def map_occupancy(
    frames: Recording,
    grid: Grid,
    *,
    method: str = "ullage",
    drift_m: float = 0.0,
    remove_own_echo: bool = True,
    target_z_m: float | None = None,
    scatterer_pfa: float = PFA,
    **options: Any,
) -> OccupancyMap:
    """Map the occupancy from a recording; a map without an occupied cell says why in a warning.

    Args:
        frames: one sensor's, or several by name; sensors may differ in settings and rate. Those that a radar did not
            receive, as when it is deaf or repeats itself, are left out with a warning (`processing.health`).
        grid: a plane or a volume that holds the flight.
        method: "ullage", the best one, which is "likelihood": surfaces by one likelihood ratio; "elfes", the thesis'
            baseline; or the name of one that another package adds. The map's `method` says which one made it.
        drift_m: sigma of a slow error of the poses [m]; above zero, it is taken out first as far as surfaces show it,
            and a warning says where they do not (`processing.drift_surfaces.correct_drift_by_surfaces`).
        remove_own_echo: subtract the radar's own echo first (`processing.own_echo`).
        target_z_m: height of coherent scatterers on a straight track; None: that of the track. Frames that
            `ul.calibrate` put on a track have such scatterers found and added (`processing.scatterers`).
        scatterer_pfa: probability that clutter alone adds one coherent scatterer or more.
        options: those of the method's mapper: `threshold` of "elfes"; of "likelihood" `floor_z_m`, the height of a
            level floor [m], whose echoes a plane leaves out, `vehicle_radius_m`, the radius of the ball about the
            antenna that the vehicle fills (0.25 m), and `spec`, a `processing.likelihood.spec.LikelihoodSpec`.

    Raises:
        InputError: the method is unknown, or the frames cannot be mapped.
    """
    sound, faults = judged(frames)
    frames = sound or frames  # without a sound frame, the place of the vehicle is still free
    if faults:
        text = f"{'; '.join(faults)}: frames that were not received are left out"
        warnings.warn(text, UllageWarning, stacklevel=2)
    received = frames
    if remove_own_echo:
        frames = without_own_echo(frames)
    calibrated = [part for part in sensors_of(frames) if part.calibration is not None and method in COHERENT]
    if drift_m:
        from ullage.processing.drift_surfaces import correct_drift_by_surfaces

        frames = correct_drift_by_surfaces(frames, drift_m=drift_m).frames
    mapper = Mapper(grid, method=method, **options)
    mapper.update(frames)
    mapper.finish()
    omap = mapper.map()
    for part in calibrated:
        omap = with_scatterers(omap, find_scatterers(part, z_m=target_z_m, pfa=scatterer_pfa))
    if not omap.occupied.any():
        text = f"no cell of the map is occupied: {why_empty(received, frames, omap.grid)}"
        warnings.warn(text, UllageWarning, stacklevel=2)
    return omap
