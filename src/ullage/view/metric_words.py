"""Definitions of the metrics of a run, in groups in the order of a report."""

from __future__ import annotations

from collections.abc import Iterable

GROUPS: dict[str, dict[str, str]] = {
    "The map against the truth": {
        "f1": "Harmonic mean of precision and recall.",
        "precision": "Share of the occupied cells within 0.15 m of a true surface.",
        "recall": "Share of the observable surface within 0.15 m of an occupied cell. Surface is observable if at "
        "least three keyframes had it in beam, in range, in sight and near enough to its normal.",
        "recall_in_view": "Share of all surface in range and in sight of the flight, in any direction, that is mapped.",
        "accuracy": "Distance from an occupied cell to the nearest true surface.",
        "completeness": "Distance from observable surface to the nearest occupied cell.",
        "false_occupied": "Occupied cells farther than 0.15 m from every true surface.",
        "false_occupied_per_100m2": "The same for each 100 square metres in sight.",
        "worst_false_occupied": "The most such cells in any map of the flight.",
        "worst_false_occupied_at": "Time of that map since the first frame.",
        "f1_half_cell": "F1 where only surface inside an occupied cell, or on its border, counts as mapped.",
        "precision_half_cell": "Precision by the same rule.",
        "recall_half_cell": "Recall by the same rule.",
    },
    "Safe to fly": {
        "surface_declared_free": "Share of the surface in beam, in range and in sight that the map marks as free.",
        "surface_missed_and_free": "Share of that surface that is marked as free and has no occupied cell near.",
        "worst_surface_declared_free": "The largest share of it that any map of the flight marked as free.",
        "worst_surface_declared_free_at": "Time of that map since the first frame.",
        "flyable_found": "Share of truly flyable cells in sight that the map marks as flyable. A cell is flyable if a "
        "ball of 0.3 m radius about it is free.",
        "flyable_false": "Share of the cells marked as flyable that are not flyable.",
        "corridor_falsely_blocked": "Share of open cells that the map closes to a corridor 0.5 m wide.",
        "corridor_falsely_clear": "Share of closed cells that the map opens to a corridor 0.5 m wide.",
        "occupied_to_path": "Distance from the flown path to the nearest occupied cell.",
    },
    "An exploring flight": {
        "explored": "Share of the surface that radars could observe from anywhere the vehicle fits, that is mapped.",
        "explored_at_25": "The same after a quarter of the flight.",
        "explored_at_50": "The same after half of it.",
        "explored_at_75": "The same after three quarters of it.",
        "flight_length": "Length of the flown path.",
        "closest_approach": "Least distance between the hull and any surface.",
        "contacts": "Times that the vehicle touched something.",
        "guard_stops": "Share of the time for which the guard stopped it or backed off.",
    },
    "What the map knows": {
        "free_found": "Share of the open cells in sight that the map marks as free.",
        "known_behind": "Share of the known cells that lie out of sight, more than 0.3 m behind a surface.",
        "ambiguous": "Share of the cells in sight that one echo alone left open.",
        "log_likelihood": "Mean log probability that the map gave to the truth, for each cell.",
        "brier": "Mean square error of the map's probabilities.",
        "ece": "Expected calibration error of the map's probabilities.",
        "surface_observable": "Share of the true surface that the radars could observe.",
        "surface_specular_invisible": "Share in beam and in sight, but never near enough to the normal to reflect.",
        "surface_hidden": "Share that was never in beam, in range and in sight.",
    },
    "Image": {
        "image_z": "Height of the imaged plane.",
        "peak": "Place of the brightest cell of the image.",
        "apex": "Apex of the brightest hyperbola of the image.",
    },
    "Radar and run": {
        "frames": "Frames of all radars.",
        "duration": "Time that the frames cover.",
        "detections": "Echoes judged to be objects; first_peak judges at most one a frame.",
        "left_out": "Frames of a live run that came too late for map and image.",
        "most_behind": "Greatest delay of map and image behind the frames of a live run.",
        "obstacle_p99": "Time from the arrival of a frame until its obstacles were sent, which 99 % kept.",
        "real_time_factor": "Seconds of flight processed in a second.",
        "own_echo_share": "Share of the received energy in the radar's own echo, which was removed.",
        "own_echo_extent": "Range up to which the own echo reaches.",
        "scatterers": "Places that reflect coherently along the track.",
        "reflector_to_map": "Distance from a surveyed reflector to the nearest occupied cell.",
    },
}
"""Definition of each metric by its group; a name without its last part, as `accuracy` of `accuracy_p90`, counts too."""
OTHER = "Other"
FOUND = "Small objects"
_PARTS = {"median": "Median. ", "mean": "Mean. ", "p90": "90th percentile. ", "x": "Along x. ", "y": "Along y. "}


def meaning(name: str) -> tuple[str, str]:
    """Give the group of a metric and its definition, which is empty for an unknown one."""
    if name.startswith("found:"):
        return FOUND, "1 if an occupied cell lies within 0.15 m of this object, which is smaller than 0.6 m."
    stem, _, part = name.rpartition("_")
    for group, words in GROUPS.items():
        if name in words:
            return group, words[name]
        if part in _PARTS and stem in words:
            return group, _PARTS[part] + words[stem]
    return OTHER, ""


def grouped(names: Iterable[str]) -> dict[str, list[str]]:
    """Sort metrics into groups, both in the order in which they are defined."""
    order = [*GROUPS, FOUND, OTHER]
    ranks = {name: k for k, name in enumerate(name for words in GROUPS.values() for name in words)}

    def rank(name: str) -> tuple[int, int, str]:
        known = name if name in ranks else name.rpartition("_")[0]
        return order.index(meaning(name)[0]), ranks.get(known, len(ranks)), name

    out: dict[str, list[str]] = {}
    for name in sorted(names, key=rank):
        out.setdefault(meaning(name)[0], []).append(name)
    return out
