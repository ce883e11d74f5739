"""Which error fells which bound (`expect`) of the shipped scenarios."""

from __future__ import annotations

from collections.abc import Callable

from studies.mutants.spoilt import Change, Fleet, Mutant, Section, again, emptied, longer, louder
from studies.thesis import hold
from studies.thesis.workspace import Flown, Workspace
from ullage.experiments.catalog import find_scenario, scenario_names

SAME_BUT_NOISE = "cluttered-room-physical-again"
"""A second run of a long flight, with the bounds of the first."""
NEAR_WALL = ("ntnu-plate-physical-by-hand", "ntnu-plate45-by-hand")
"""Flights that hold space behind walls known only when ranges are longer still."""
PART = {"cargo-hold-physical": (hold.LEG,)}
"""Options that make a long flight shorter; its F1 is that of the whole flight."""
Flights = dict[str, Flown]


def flights_of(*names: str) -> Callable[[Fleet], Flights]:
    return lambda fleet: {name: fleet(name, *PART.get(name, ())) for name in names}


def state(work: Workspace, flights: Flights) -> None:
    for name, flown in flights.items():
        for metric, bound in find_scenario(name).expect.items():
            if metric == "f1" and name in PART:
                continue
            work.results.add_statement(
                f"{name}: {metric}", "expect", flown.number(metric), low=bound.min, high=bound.max
            )


def all_again(change: Change) -> Callable[[Flights], Flights]:
    return lambda flights: {name: again(flown, change) for name, flown in flights.items()}


TOO_LONG = (": f1", ": precision", ": recall", ": brier", ": accuracy_median", ": completeness_p90")
DEAF = (
    "cargo-hold",
    "cluttered-room",
    "cluttered-room-again",
    "ntnu-mapping",
    "ntnu-mapping-5cm",
    "ntnu-mapping-20cm",
    "ntnu-wire-by-hand",
)
"""Scenarios that Elfes maps: where nothing is received, he takes all for free. The likelihood frees nothing then."""
PLANT = ("ballast-tank", "lying-tank", "pipe-rack", "sewer", "silo")


def nothing(*names: str) -> Mutant:
    free = tuple(f"{name}: surface_declared_free" for name in names)
    return Mutant("nothing is received", (": detections", *free), change=all_again(emptied))


def silence_frees(*names: str) -> Mutant:
    """Elfes in place of the likelihood, where nothing is received."""

    def change(flights: Flights) -> Flights:
        return flights | {name: again(flights[name], emptied, method="elfes") for name in names}

    return Mutant("silence is free space", tuple(f"{name}: surface_declared_free" for name in names), change=change)


BOUNDS = (
    Section("bounds of scenarios", "expect", state, (
        Mutant("ranges 1 m too long", (*TOO_LONG, ": known_behind", "mapping-physical: surface_declared_free",
                                       "room-physical: surface_declared_free"), change=all_again(longer(1.0))),
        Mutant("ranges 0.4 m too long", ("cargo-hold-physical: surface_declared_free",), change=lambda flights:
               flights | {"cargo-hold-physical": again(flights["cargo-hold-physical"], longer(0.4))}),
        nothing(*DEAF),
        silence_frees(*PLANT),
        Mutant("an eighth of the threshold", ("ntnu-mapping-50cm: free_found",), change=lambda flights: flights | {
            "ntnu-mapping-50cm": again(flights["ntnu-mapping-50cm"], louder(8))}),
    ), flights_of(*(name for name in scenario_names() if name not in (*NEAR_WALL, SAME_BUT_NOISE)))),
    Section("bounds of two flights by hand", "expect", state, (
        Mutant("ranges 2.5 m too long", (": precision", ": recall", ": known_behind"), change=all_again(longer(2.5))),
        nothing("ntnu-plate45-by-hand"),
    ), flights_of(*NEAR_WALL)),
)  # fmt: skip
