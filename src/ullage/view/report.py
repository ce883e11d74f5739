"""One HTML page for a run: verdict, replay in 3D, figures, metrics and settings; the file contains everything."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from ullage.config import Bound
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.untrusted import load_yaml
from ullage.view.metric_words import grouped, meaning
from ullage.view.replay import FILE as REPLAY

KINDS = {"mapped": "good", "missed": "bad"}
"""Marks of the states of objects."""
UNSAFE = 0.01
"""Share of the surface in sight that may be marked as free before the verdict warns."""


def _part(name: str) -> str:
    """Read a part of the page from the package."""
    return (resources.files("ullage.view") / "web" / name).read_text(encoding="utf-8")


CAPTIONS: dict[str, str] = json.loads(_part("captions.json"))
"""Of figures by their names, in the order of the page."""


def write_report(folder: Path, *, origin: Mapping[str, object] | None = None) -> Path:
    """Write `report.html` from the files of a run folder, also of an unfinished run.

    Args:
        folder: of the run.
        origin: its provenance; None: that of its provenance.json.

    Raises:
        InputError: the folder lacks its scenario or metrics, they cannot be read, or the disk is full.
    """
    settings = _text(folder / "scenario.yaml")
    plan = load_yaml(settings, where=folder / "scenario.yaml")
    expect = plan.get("expect") or {}
    origin = dict(origin or json.loads(_text(folder / "provenance.json")))
    unfinished = origin.get("state") in {"running", "unfinished"}
    lacking = unfinished and not (folder / "metrics.json").exists()
    metrics = {} if lacking else json.loads(_text(folder / "metrics.json"))
    findings = json.loads(_text(folder / "findings.json")) if (folder / "findings.json").exists() else {}
    replay = base64.b64encode((folder / REPLAY).read_bytes()).decode() if (folder / REPLAY).exists() else ""
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(_part("report.html"))
    html = page.render(
        name=plan["name"],
        title=plan.get("title") or plan["name"],
        provenance={"interrupted": False} | origin,
        unfinished=str(origin.get("refused", "its process was ended, or is still at work")) if unfinished else "",
        verdict=verdict_lines(folder, findings, metrics),
        objects=[_object(one) for one in findings.get("objects", [])],
        figures=[_figure(path) for path in _pictures(folder)],
        groups=[
            {"title": title, "rows": [_row(name, metrics[name], expect.get(name) or {}) for name in names]}
            for title, names in grouped(metrics).items()
        ],
        settings=settings,
        origin=json.dumps(origin, indent=2),
        style=Markup(_part("report.css")),
        replay=replay,
        library=Markup(_part("three.min.js")) if replay else "",
        program=Markup(_part("report.js")) if replay else "",
    )
    out = folder / "report.html"
    write_whole(out, lambda file: file.write(html.encode()))
    return out


def verdict_lines(folder: Path, findings: Mapping[str, Any], metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Describe in sentences what was mapped and missed, with bad results marked."""
    out = _mapped(findings, metrics) + _unseen(metrics)
    if (declared := _value(metrics, "surface_declared_free")) is not None:
        unsafe = declared > UNSAFE
        share = f"{_percent(declared)} of the surface" if declared else "no surface"
        text = f"The map marks {share} in sight of the radars as free."
        out.append(_line(text + (" Do not fly by this map." if unsafe else ""), "bad" if unsafe else ""))
    out += _worst(metrics)
    if (compared := findings.get("compared")) and (score := _value(compared["metrics"], "f1")) is not None:
        name = compared["name"][:1].upper() + compared["name"][1:]
        out.append(_line(f"{name} on the same flight reaches F1 {score:.3f}."))
    said = _text(folder / "verdict.txt").splitlines() if (folder / "verdict.txt").exists() else []
    return [*out, *map(_line, said)]


def _mapped(findings: Mapping[str, Any], metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Describe the shares of surface and objects on the map."""
    out, objects = [], findings.get("objects", [])
    names = ("recall", "recall_in_view", "precision", "f1")
    recall, in_view, precision, f1 = (_value(metrics, name) for name in names)
    if recall is not None and precision is not None and f1 is not None:
        of_all = "" if in_view is None else f"{_percent(in_view)} of all surface in range and in sight, and "
        place = findings.get("place") or "In its grid"
        out.append(_line(
            f"{place}, the map shows {of_all}{_percent(recall)} of the surface that the radars could observe. "
            f"{_percent(precision)} of its occupied cells lie on a true surface (F1 {f1:.3f})."
        ))  # fmt: skip
    if objects:
        count = sum(one["state"] == "mapped" for one in objects)
        kind = "good" if 2 * count >= len(objects) else ""
        out.append(_line(f"{count} of the {len(objects)} objects in sight are mapped, at least half of each.", kind))
    for state, words, kind in (("partly mapped", "Mapped in part", ""), ("missed", "Missed", "bad")):
        if named := [one["name"].replace("_", " ") for one in objects if one["state"] == state]:
            out.append(_line(f"{words}: {', '.join(named)}.", kind))
    return out


def _unseen(metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Say which surface no radar could observe, and why."""
    why = {
        "surface_specular_invisible": "was in a beam but never faced a radar, so its echo went elsewhere",
        "surface_hidden": "was hidden, out of range or outside every beam",
    }
    shares = {name: _value(metrics, name) for name in why}
    parts = [f"{_percent(share)} {why[name]}" for name, share in shares.items() if share]
    return [_line(f"Of the surface on the grid, {'; '.join(parts)}.")] if parts else []


def _worst(metrics: Mapping[str, Any]) -> list[dict[str, str]]:
    """Describe the worst moments of the flight."""
    out = []
    false, at = (_value(metrics, f"worst_false_occupied{part}") for part in ("", "_at"))
    if false and at is not None:
        now = _value(metrics, "false_occupied") or 0
        out.append(f"At worst, {at:.0f} s into the flight, {false:.0f} occupied cells lay on no surface; "
                   f"at its end {now:.0f} do.")  # fmt: skip
    free, at = (_value(metrics, f"worst_surface_declared_free{part}") for part in ("", "_at"))
    if free and at is not None:
        out.append(f"At worst, {at:.0f} s into the flight, {_percent(free)} of the surface was marked as free.")
    return [_line(text, "bad" if "marked" in text and (free or 0) > UNSAFE else "") for text in out]


def _line(text: str, kind: str = "") -> dict[str, str]:
    return {"text": text, "kind": kind}


def _value(metrics: Mapping[str, Any], name: str) -> float | None:
    value = (metrics.get(name) or {}).get("value")
    return None if value is None else float(value)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share == 0 or share >= 0.1 else f"{100 * share:.2g} %"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=path, allowed="a run folder") from None


def main_picture(folder: Path) -> Path:
    """Return the figure of a run that says most: its map, else its image, else the first there is.

    Raises:
        InputError: it has no figure.
    """
    found = _pictures(folder)
    if not found:
        raise InputError("has no figure", where=folder, allowed="a run that made a map, an image or echoes")
    return found[0]


def _pictures(folder: Path) -> list[Path]:
    order = list(CAPTIONS)
    found = (folder / "figures").glob("*.png")
    return sorted(found, key=lambda p: (order.index(p.stem) if p.stem in order else len(order), p.name))


def _figure(path: Path) -> dict[str, str]:
    data = base64.b64encode(path.read_bytes()).decode()
    return {"data": data, "caption": CAPTIONS.get(path.stem, path.stem.replace("_", " "))}


def _object(one: Mapping[str, Any]) -> dict[str, str]:
    shares = {name: _percent(float(one[name])) for name in ("mapped", "observable")}
    return {"name": one["name"], "state": one["state"], "kind": KINDS.get(one["state"], ""), **shares}


def _row(name: str, metric: Mapping[str, Any], bound: Mapping[str, float | None]) -> dict[str, str]:
    value = metric["value"]
    text = " .. ".join("" if (k := bound.get(end)) is None else f"{k:g}" for end in ("min", "max")) if bound else ""
    verdict = ("good" if Bound(**bound).holds(value) else "bad") if bound else ""
    shown = "unknown" if value is None else f"{value:.4g}"
    return {"name": name.replace("_", " "), "value": shown, "unit": metric["unit"], "bounds": text,
            "verdict": verdict, "meaning": meaning(name)[1]}  # fmt: skip
