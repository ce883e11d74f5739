"""Scenario files: what to fly, where, with which radars, and what to make of the echoes. YAML in, checked, YAML out."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError, PydanticUndefined

from ullage import plugins
from ullage.errors import InputError, shown
from ullage.specs import MOST_BOUNCES, BodySpec, ImuSpec, RadarSpec, Rig, Spec
from ullage.untrusted import compose_yaml, load_yaml, read_yaml, reason

DetectMethod = Literal["first_peak", "peaks", "cfar", "os-cfar", "clean", "track"]
ImageMethod = Literal["backprojection", "summation"]
RIG_FILES = {".sdf", ".world", ".urdf", ".xacro"}
FIDELITIES, MAP_METHODS = ("physical", "thesis"), ("ullage", "likelihood", "elfes")
SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def _one_of(group: plugins.Group, shipped: tuple[str, ...]) -> AfterValidator:
    """Accept the names that are shipped, and those that other packages add to a group."""

    def check(name: str) -> str:
        if name not in shipped and name not in plugins.names(group):
            every = " or ".join(map(repr, (*shipped, *plugins.names(group))))
            raise PydanticCustomError("literal_error", "Input should be {every}", {"every": every})
        return name

    return AfterValidator(check)


Fidelity = Annotated[str, _one_of("ullage.echo_models", FIDELITIES)]
MapMethod = Annotated[str, _one_of("ullage.map_methods", MAP_METHODS)]


def split_source(source: str | Path) -> tuple[str, str]:
    """Split the source of a world, `robot.xacro?name:=value`, into its file and `?name:=value`, xacro's arguments."""
    file, mark, arguments = str(source).partition("?")
    return (file, mark + arguments) if file.lower().endswith(".xacro") else (str(source), "")


class WorldSpec(Spec):
    """Which world: a library name or a file."""

    name: str = Field("", description="a library world, as `ullage list` names them")
    file: str = Field(
        "", description="or a world file: .sdf .world .urdf .xacro(?name:=value) .glb .obj .stl .ply .dae"
    )
    geometry: Literal["collision", "visual"] = "collision"
    search_path: tuple[str, ...] = Field((), description="folders for model:// and relative URIs")
    missing: Literal["refuse", "skip"] = Field("refuse", description="refuse or skip a model or mesh that is not there")
    origin_m: tuple[float, float, float] | None = Field(
        None, description="point of the file that becomes the origin [m]; none: its own, or near a far scene's centre"
    )
    scale: float | None = Field(None, gt=0, description="metres in a unit of a bare mesh file; none: guessed, and said")
    smooth: Literal["auto", "yes", "no"] | None = Field(
        None, description="facets stand for curved surfaces; none: as the file says of each object, or auto"
    )


class GuardSpec(Spec):
    """Keep the drone off obstacles by its own radars; no certified safety function."""

    on: bool = Field(False, description="fly in closed loop with the guard")
    margin_m: float = Field(0.3, gt=0, le=10, description="gap kept between hull and obstacle")
    braking_m_s2: float = Field(0.8, gt=0, le=10, description="deceleration that the vehicle surely reaches")
    latency_s: float = Field(
        0.3, ge=0, le=5, description="from an echo until the command of the next frame acts: a frame period and delays"
    )
    lag_s: float = Field(0.25, ge=0, le=5, description="time constant with which the vehicle follows a velocity")
    sigmas: float = Field(2.0, ge=0, le=6, description="standard deviations by which distances are shortened")
    release_m: float = Field(0.15, ge=0, le=5, description="more room than at the stop before it flies on")
    recovery_m_s2: float = Field(0.6, gt=0, le=10, description="growth of the limit once the path is free")
    back_off_m_s: float = Field(0.15, ge=0, le=1, description="retreat from obstacles inside the margin; 0: hover")
    back_off_share: float = Field(0.5, ge=0, le=1, description="share of the margin that is lost before it retreats")
    unseen_m_s: float = Field(
        0.0, ge=0, le=5, description="level speed in directions that no working radar covers; 0: stop"
    )
    stale_s: float = Field(0.5, gt=0, le=5, description="a radar that is silent for so long has an unknown distance")
    give_up_s: float = Field(4.0, gt=0, le=600, description="a flight that is stopped for so long ends")


class FlightSpec(Spec):
    """How the drone moves."""

    waypoints: tuple[tuple[float, ...], ...] = Field(
        (), description="x, y, z [m] and, if given, yaw [deg]; none: the world's own, or a tour of its free space"
    )
    speed_m_s: float = Field(0.5, gt=0, le=20)
    vehicle: str = Field("hector", description="hector: rigid-body flight; ideal: straight lines at constant speed")
    wind_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust_m_s: float = Field(0.0, ge=0, le=20)
    wander_m: float = Field(0.0, ge=0, le=5, description="stray as under a human hand, rms along x and y; half in z")
    wander_deg: float = Field(0.0, ge=0, le=90, description="the same of the heading, rms")
    hover_s: float = Field(0.0, ge=0, le=600, description="hover at the last waypoint")
    poses: Literal["navigation", "radar"] = Field(
        "navigation",
        description="navigation: the true flight with navigation's errors, or a recording's track; radar: odometry by "
        "the radars, an inertial unit, and a simulated altimeter",
    )
    imu_file: str = Field(
        "", description="recorded inertial unit: .ulg, .bin or a bag; none: the recording's own, else a simulated one; "
        "simulated: in any case"
    )  # fmt: skip
    imu_topic: str = Field("", description="of sensor_msgs/Imu in a bag; none: the only one there")
    imu: ImuSpec = Field(ImuSpec(), description="data sheet of the inertial unit, by default a BMI088's")
    free_probability: float | None = Field(
        None, ge=0.5, le=1, description="exploring flights plan paths only where all within the clearance is free "
        "with at least this probability; none: also through unknown space"
    )  # fmt: skip
    free_start_m: float = Field(
        0.0, ge=0, le=10, description="unknown space within this distance of an exploring flight's start counts as free"
    )
    guard: GuardSpec = GuardSpec()

    @field_validator("waypoints")
    @classmethod
    def _points(cls, rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        for number, row in enumerate(rows):
            if len(row) not in (3, 4) or len(row) != len(rows[0]):
                raise ValueError(
                    f"waypoint {number} has {len(row)} numbers (allowed: x, y, z, or x, y, z, yaw in each)"
                )
        return rows

    @model_validator(mode="after")
    def _guarded(self) -> Self:
        if self.guard.on and self.vehicle == "ideal":
            raise ValueError("guard.on wants a vehicle that can brake (allowed: vehicle hector)")
        if self.guard.on and (self.wander_m or self.wander_deg):
            raise ValueError("guard.on flies no wander (allowed: wander_m 0 and wander_deg 0)")
        return self


class NavigationSpec(Spec):
    """What the drone believes of its flight, against what is true."""

    noise_m: float = Field(0.0, ge=0, le=10, description="white position noise, sigma")
    drift_m: float = Field(0.0, ge=0, le=100, description="smooth position drift, rms")
    yaw_deg: float = Field(0.0, ge=0, le=180, description="yaw error, rms")


class SensingSpec(Spec):
    """Which radars, and which law their echoes follow."""

    rig: str = Field(
        "thesis-4",
        description="thesis-4, thesis-4-down, thesis-ring, single, declared (on a model of the world), or an SDF or "
        "URDF file",
    )
    preset: str = Field("x4m05", description="a radar as `ullage list` names them, or a YAML file of one")
    changes: dict[str, Any] = Field({}, description="fields of the radar to change, e.g. {iterations: 32}")
    body: BodySpec | None = Field(
        None,
        description="what they see of the drone itself, by the physical law; none: nothing, else {rotors: "
        "[{position_m: [x, y, z], radius_m: 0.127, chord_m: 0.02, pitch_deg: 15, blades: 2, rate_hz: 80, yaw_deg: 0, "
        "material: metal}], boxes: [{position_m: [x, y, z], size_m: [x, y, z], yaw_deg: 0}]}",
    )
    fidelity: Fidelity = "physical"
    max_bounces: int = Field(1, ge=1, le=MOST_BOUNCES)
    rate_hz: float | None = Field(None, gt=0, le=1000, description="frames per second; none: the radar's own fps")

    @property
    def is_declared(self) -> bool:
        """Whether the radars are those that a world or file declares."""
        return self.rig == "declared" or Path(split_source(self.rig)[0]).suffix.lower() in RIG_FILES

    def changed(self, rig: Rig) -> Rig:
        """A declared rig with the changes of these settings on every radar.

        Raises:
            InputError: a field is unknown, or a value out of bounds.
        """
        if not self.changes and self.body is None:
            return rig
        sensors = {name: spec.but(**self.changes) for name, spec in rig.sensors.items()}
        return rig.but(sensors=sensors, body=self.body or rig.body)

    def radars(self) -> Rig:
        """The rig these settings describe, if it is a preset.

        Raises:
            InputError: a preset or a field is unknown, or a value out of bounds.
        """
        return Rig.preset(self.rig, radar=RadarSpec.preset(self.preset, **self.changes)).but(body=self.body)


class DetectSpec(Spec):
    """Echoes judged to be objects."""

    method: DetectMethod | None = Field(None, description="none: first_peak for the thesis' echoes, else peaks")
    threshold: float | None = Field(None, gt=0, description="none: 0.038 for thesis amplitudes, else from the noise")


class MapSpec(Spec):
    """The occupancy map."""

    method: MapMethod = "ullage"
    step_m: float = Field(0.1, gt=0, le=10)
    dims: Literal[2, 3] = 2
    margin_m: float = Field(1.0, ge=0, le=100, description="room around the world")
    every_s: float | None = Field(
        None, ge=0.01, le=3600, description="between two maps, by the frames' clock; none: 0.2 live, else 1"
    )
    floor_z_m: float | None = Field(
        None,
        ge=-1e4,
        le=1e4,
        description="height of a level floor, whose echoes a plane leaves out (0 for a Motive capture); none: only "
        "floors that show themselves",
    )
    vehicle_radius_m: float = Field(
        0.25, gt=0, le=10, description="radius of the ball about the antenna that the vehicle fills, and so shows free"
    )
    scatterer_pfa: float = Field(
        0.01, gt=0, lt=1, description="probability that a recording's clutter alone adds one coherent scatterer"
    )
    reach_m: float = Field(
        6.0, gt=0, le=1000, description="room around the flight, or a live port's first pose, where no world is known"
    )


class ImageSpec(Spec):
    """The SAR image."""

    method: ImageMethod = "backprojection"
    step_m: float = Field(0.05, gt=0, le=10)
    sensor: str = Field("", description="one sensor; none: all")
    z_m: float | None = Field(
        None, ge=-1000, le=1000, description="height of the plane; none: surveyed reflectors', else the flight's"
    )
    every_s: float | None = Field(
        None,
        ge=0.01,
        le=3600,
        description="between two images, by the frames' clock; none: 0.2 live, 1 where a viewer or port takes them, "
        "else the end only",
    )
    volume: tuple[float, float] | None = Field(None, description="lowest and highest z [m] of a volume, not a plane")

    @model_validator(mode="after")
    def _plane_or_volume(self) -> Self:
        if self.volume is not None and not -1000 <= self.volume[0] < self.volume[1] <= 1000:
            raise ValueError(f"volume is {list(self.volume)} (allowed: two rising heights within 1000 m)")
        if self.volume is not None and self.z_m is not None:
            raise ValueError("z_m and volume are both set (allowed: one of them)")
        return self


class Bound(Spec):
    """Where a metric has to lie."""

    min: float | None = None
    max: float | None = None

    def holds(self, value: float | None) -> bool:
        """Return whether a value is known and within the bound."""
        return value is not None and (self.min is None or value >= self.min) and (self.max is None or value <= self.max)


Task = Literal["detect", "image", "map", "obstacles"]


class Scenario(Spec):
    """One experiment: world, flight, radars, what to do with the echoes, and what must come out."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    title: str = ""
    world: WorldSpec = WorldSpec()
    flight: FlightSpec = FlightSpec()
    navigation: NavigationSpec = NavigationSpec()
    sensing: SensingSpec = SensingSpec()
    do: tuple[Task, ...] = ("detect", "image", "map")
    detect: DetectSpec = DetectSpec()
    map: MapSpec = MapSpec()
    image: ImageSpec = ImageSpec()
    remove_own_echo: bool = Field(True, description="subtract direct path and ring-down before all of do")
    seed: int = Field(7, ge=0, lt=2**63)
    expect: dict[str, Bound] = Field({}, description="bounds on metrics; `ullage measure` exits 1 outside them")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if "image" in self.do and self.sensing.fidelity == "thesis" and self.image.method == "backprojection":
            raise ValueError("the thesis' amplitudes have no phase: image.method has to be summation")
        return self

    @property
    def digest(self) -> str:
        """Eight characters that stand for these very settings."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


def run_name(text: str) -> str:
    """Text as the name of a run: letters, digits and _.- only, at most 60 of them."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text).lstrip("_.-")[:60] or "run"


def read_scenario(path: str | Path, *, options: Sequence[str] = ()) -> Scenario:
    """A scenario file, with `a.b=value` options laid over it.

    Raises:
        InputError: the file is missing, not YAML, or a field is unknown or out of bounds.
    """
    file = Path(path)
    tree, text = read_yaml(file)
    if not isinstance(tree, dict):
        raise InputError("not a scenario", where=file, allowed="YAML with fields like world, flight, sensing")
    try:
        return make_scenario({"name": run_name(file.stem)} | tree, options=options, where=str(file))
    except InputError as error:
        place = ".".join(str(part) for part in error.field)
        if is_set_by(options, place):
            raise InputError(error.what, where="-o", allowed=error.allowed, field=error.field) from None
        line = _line(compose_yaml(text), error.field)
        raise InputError(error.what, where=file, line=line, allowed=error.allowed, field=error.field) from None


def is_set_by(options: Sequence[str], place: str) -> bool:
    """Whether one of the `a.b=value` options sets the field at this place, or a group that holds it."""
    return any(f"{place}.".startswith(f"{option.partition('=')[0]}.") for option in options)


def _line(node: Any, path: tuple[str | int, ...]) -> int | None:
    """The line of the setting at `path` [1 = first], or of the group that should hold it."""
    line = None
    for part in path:
        if not isinstance(getattr(node, "value", None), list) or node.id != "mapping":
            break
        found = next((pair for pair in node.value if pair[0].value == str(part)), None)
        if found is None:
            break
        line, node = found[0].start_mark.line + 1, found[1]
    return line


def make_scenario(tree: dict[str, Any], *, options: Sequence[str] = (), where: str = "scenario") -> Scenario:
    """A scenario from plain values, with `a.b=value` options laid over them.

    Raises:
        InputError: a field is unknown or out of bounds.
    """
    try:
        scenario = Scenario(**_overlaid(tree, options))
    except InputError as error:
        raise InputError(error.what, where=where, allowed=error.allowed, field=error.field) from None
    try:
        sensing = scenario.sensing
        if sensing.is_declared:
            RadarSpec.preset(sensing.preset, **sensing.changes)
        else:
            sensing.radars()
    except InputError as error:
        field = ("sensing", "changes", *error.field) if error.field else ("sensing",)
        what = ".".join(("sensing", "changes", error.what)) if error.field else f"sensing: {error.what}"
        raise InputError(what, where=where, allowed=error.allowed, field=field) from None
    return scenario


def _overlaid(tree: dict[str, Any], options: Sequence[str]) -> dict[str, Any]:
    try:
        out: dict[str, Any] = json.loads(json.dumps(tree, default=list))
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(f"not plain values: {reason(error)}", allowed="numbers, text, lists and groups") from None
    for option in options:
        key, sep, text = option.partition("=")
        if not sep or not key:
            raise InputError(f"-o {shown(option)} is not an option", allowed="key=value, e.g. -o map.step_m=0.2")
        *folders, leaf = key.split(".")
        place = out
        for folder in folders:
            place = place.setdefault(folder, {})
            if not isinstance(place, dict):
                raise InputError(f"{folder!r} holds a value, not a group, in -o {shown(option)}")
        try:
            place[leaf] = load_yaml(text, where="-o")
        except InputError as error:
            raise InputError(f"cannot read -o {key}={shown(text)}: {error.what}", allowed="a YAML value") from None
    given = {option.partition("=")[0] for option in options}
    for (key, value), (follows, wanted) in IMPLIED:
        group, leaf = follows.split(".")
        if (
            key in given
            and follows not in given
            and _at(out, key) == value
            and isinstance(out.setdefault(group, {}), dict)
        ):
            out[group][leaf] = wanted
    return out


IMPLIED = (
    (("sensing.fidelity", "thesis"), ("image.method", "summation")),  # its amplitudes have no phase
    (("flight.guard.on", True), ("flight.vehicle", "hector")),  # an ideal vehicle cannot brake
)
"""Options with a value that no other value of a second field fits; the second follows, unless it is an option too."""


def _at(tree: Any, key: str) -> Any:
    """The value at `a.b.c` of nested groups; None where there is none."""
    for name in key.split("."):
        tree = tree.get(name) if isinstance(tree, dict) else None
    return tree


def scenario_text(spec: Spec, *, commented: bool = True) -> str:
    """Settings as YAML, each with its meaning and bounds as a comment."""
    return "\n".join(_lines(spec, 0, commented)) + "\n"


def _lines(spec: BaseModel, depth: int, commented: bool) -> list[str]:
    out: list[str] = []
    for name, info in type(spec).model_fields.items():
        value = getattr(spec, name)
        pad = "  " * depth
        if isinstance(value, BaseModel):
            note = (type(value).__doc__ or "").strip().splitlines()[0]
            out += [f"{pad}{name}:" + (f"  # {note}" if commented else ""), *_lines(value, depth + 1, commented)]
            continue
        plain = spec.model_dump(mode="json", include={name}, exclude_none=False)[name]
        text = json.dumps(plain, ensure_ascii=False)
        bounds = [
            f"{sign} {getattr(m, key):g}" for m in info.metadata for key, sign in SIGNS.items() if hasattr(m, key)
        ]
        notes = [note for note in (info.description, ", ".join(bounds)) if note]
        if info.default is not PydanticUndefined and info.default != value:
            notes.append(f"default {json.dumps(info.default, default=str)}")
        key = f'"{name}"' if name in ("on", "off", "yes", "no") else name  # bare, YAML 1.1 takes them for truth values
        out.append(f"{pad}{key}: {text}" + (f"  # {'; '.join(notes)}" if commented and notes else ""))
    return out


def scenario_schema() -> dict[str, Any]:
    """JSON schema of a scenario file, for editors."""
    return Scenario.model_json_schema()
