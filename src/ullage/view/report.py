"""One HTML page for a run: settings, figures, metrics, provenance, everything inside the file."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from ullage.errors import InputError
from ullage.files import write_whole
from ullage.untrusted import load_yaml

CAPTIONS = {
    "map": "Occupancy map over the flown path (blue); red: true walls; circles: surveyed reflectors.",
    "image": "Synthetic aperture image, amplitude in dB below its brightest cell.",
    "own_echo": "Power received over range, the radar's own echo that was removed, and what remains.",
    "calibration": "Posterior of the clock offset between radar and track, and the offsets that were applied.",
    "range_time": "Amplitude of every range bin over time, one panel a radar.",
    "rest": "Mean profile, noise and its correlation while the radar stood still.",
    "explain": "Where the strongest echoes of a frame in the middle of the run came from, and a plan at its height.",
    "snapshot": "One profile of each radar in the middle of the run.",
}

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ name }} - ullage</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
 body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1f2933}
 h1{margin-bottom:0} h2{margin-top:2rem;border-bottom:1px solid #d5dae0}
 figure{margin:1rem 0} figure img{max-width:100%;border:1px solid #e3e7eb} figcaption{color:#52606d}
 table{border-collapse:collapse} td,th{padding:.2rem .8rem;text-align:left;border-bottom:1px solid #e3e7eb}
 td.n{text-align:right;font-variant-numeric:tabular-nums} .bad{color:#b3261e;font-weight:600} .good{color:#1b7f3b}
 pre{background:#f5f7fa;padding:1rem;overflow:auto;font-size:13px}
</style></head><body>
<h1>{{ title }}</h1>
<p>{{ name }}, run {{ provenance.started }} with ullage {{ provenance.ullage }}
{%- if provenance.interrupted %} <span class="bad">interrupted: what had been received by then</span>{% endif %}
{%- if unfinished %} <span class="bad">unfinished: {{ unfinished }}</span>{% endif %}</p>
{% if verdict %}<h2>Verdict</h2><ul>{% for sentence in verdict %}<li>{{ sentence }}</li>{% endfor %}</ul>{% endif %}
<h2>Figures</h2>
{% for figure in figures %}<figure><img alt="{{ figure.caption }}" src="data:image/png;base64,{{ figure.data }}">
<figcaption>{{ figure.caption }}</figcaption></figure>
{% endfor %}
<h2>Metrics</h2>
<table><tr><th>metric</th><th>value</th><th>unit</th><th>bounds</th></tr>
{% for m in metrics %}<tr><td>{{ m.name }}</td><td class="n">{{ m.value }}</td><td>{{ m.unit }}</td>
<td class="{{ m.verdict }}">{{ m.bounds }}</td></tr>
{% endfor %}</table>
<h2>Settings</h2><pre>{{ settings }}</pre>
<h2>Provenance</h2><pre>{{ origin }}</pre>
</body></html>
"""


def write_report(folder: Path, *, origin: Mapping[str, object] | None = None) -> Path:
    """Write `report.html` from what lies in a run folder; an unfinished run gives what it has.

    Args:
        folder: of the run.
        origin: its provenance; None: that of its provenance.json.

    Raises:
        InputError: the folder lacks its scenario or metrics, they cannot be read, or the disk is full.
    """
    settings = _text(folder / "scenario.yaml")
    plan = load_yaml(settings, where=folder / "scenario.yaml")
    origin = dict(origin or json.loads(_text(folder / "provenance.json")))
    unfinished = origin.get("state") in {"running", "unfinished"}
    lacking = unfinished and not (folder / "metrics.json").exists()
    metrics = {} if lacking else json.loads(_text(folder / "metrics.json"))
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(PAGE)
    html = page.render(
        name=plan["name"],
        title=plan.get("title") or plan["name"],
        provenance={"interrupted": False} | origin,
        unfinished=str(origin.get("refused", "its process was ended, or is still at work")) if unfinished else "",
        verdict=_text(folder / "verdict.txt").splitlines() if (folder / "verdict.txt").exists() else [],
        figures=[_figure(path) for path in _pictures(folder)],
        metrics=[_row(name, m, plan.get("expect") or {}) for name, m in metrics.items()],
        settings=settings,
        origin=json.dumps(origin, indent=2),
    )
    out = folder / "report.html"
    write_whole(out, lambda file: file.write(html.encode()))
    return out


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=path, allowed="a run folder") from None


def _pictures(folder: Path) -> list[Path]:
    order = list(CAPTIONS)
    found = (folder / "figures").glob("*.png")
    return sorted(found, key=lambda p: (order.index(p.stem) if p.stem in order else len(order), p.name))


def _figure(path: Path) -> dict[str, str]:
    data = base64.b64encode(path.read_bytes()).decode()
    return {"data": data, "caption": CAPTIONS.get(path.stem, path.stem.replace("_", " "))}


def _row(name: str, metric: dict[str, Any], expect: dict[str, dict[str, float | None]]) -> dict[str, str]:
    value, bound = metric["value"], expect.get(name) or {}
    low, high = bound.get("min"), bound.get("max")
    text = " .. ".join("" if k is None else f"{k:g}" for k in (low, high)) if bound else ""
    inside = value is not None and (low is None or value >= low) and (high is None or value <= high)
    verdict = ("good" if inside else "bad") if bound else ""
    shown = "unknown" if value is None else f"{value:.4g}"
    return {"name": name.replace("_", " "), "value": shown, "unit": metric["unit"], "bounds": text, "verdict": verdict}
