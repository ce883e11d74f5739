"""Write the report of the reproduction: one HTML page in the order of the thesis."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from studies.thesis.results import Results
from studies.thesis.task import Chapter, Reproduction
from ullage.experiments.folder import provenance, write_text

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>The thesis reproduced - ullage</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
 body{font:15px/1.5 system-ui,sans-serif;max-width:74rem;margin:2rem auto;padding:0 1rem;color:#1f2933}
 h1{margin-bottom:0} h2{margin-top:2.5rem;border-bottom:1px solid #d5dae0}
 figure{margin:1.2rem 0} figure img{max-width:100%;border:1px solid #e3e7eb} figcaption{color:#52606d}
 table{border-collapse:collapse;margin:.8rem 0} td,th{padding:.2rem .8rem;text-align:left;
 border-bottom:1px solid #e3e7eb;vertical-align:top} td.n{text-align:right;font-variant-numeric:tabular-nums}
 .bad{color:#b3261e;font-weight:600} .good{color:#1b7f3b} nav a{margin-right:1rem} .small{color:#52606d;font-size:13px}
</style></head><body>
<h1>The thesis, reproduced</h1>
<p>Every experiment of chapter 6 of D. C. Billdal, <i>Sensor Simulation and Environment Mapping using UWB Radar for
Industrial Drone Inspection</i> (NTNU, 2018), run by ullage {{ origin.ullage }}: the thesis' own ray model and
methods beside the physical model and
ullage's. {{ "A small run (--quick)." if quick }} {{ holding }} of {{ total }} statements and bounds hold.
{% if interrupted %}<span class="bad">Interrupted: {{ chapters|length }} of {{ wanted }} experiments are
here; run the same command again to go on.</span>{% endif %}</p>
<p class="small">{{ origin.machine.processor }}, {{ origin.machine.cores }} cores, {{ origin.machine.system }}, Python
{{ origin.python }}, {{ origin.started }}; {{ "%.0f"|format(took) }} s of CPU in all. The thesis' machine: Intel Core
i7-4790 at 3.6 GHz, Ubuntu 16.04, ROS Kinetic, Gazebo 8. Figures numbered 2 to 6 are the thesis'; its pictures are not
copied here, hold it beside this page.</p>
<nav>{% for c in chapters %}<a href="#{{ c.name }}">{{ c.section }} {{ c.title }}</a>{% endfor %}</nav>
{% if broken %}<h2 class="bad">Out of bounds</h2><ul>{% for line in broken %}<li>{{ line }}</li>{% endfor %}</ul>
{% endif %}
<h2>What holds</h2><ul>{% for line in holds %}<li>{{ line }}</li>{% endfor %}</ul>
<h2>Where this reproduction differs</h2>
<table><tr><th>thesis</th><th>it says</th><th>here</th><th>cause</th></tr>
{% for d in differs %}<tr><td>{{ d.where }}</td><td>{{ d.thesis }}</td><td>{{ d.here }}</td><td>{{ d.cause }}</td></tr>
{% endfor %}</table>
<h2>What could not be compared</h2><ul>{% for line in lacking %}<li>{{ line }}</li>{% endfor %}</ul>
<h2>Figure beside figure</h2>
<table><tr><th>thesis</th><th>shows</th><th>here</th></tr>
{% for f in figures %}<tr><td>{{ f.number }}</td><td>{{ f.shows }}</td><td>{{ f.here }}</td></tr>
{% endfor %}</table>
{% for c in chapters %}<h2 id="{{ c.name }}">{{ c.section }} {{ c.title }}</h2>
{% for note in c.notes %}<p>{{ note }}</p>{% endfor %}
{% if c.skipped %}<p class="bad">Not done: {{ c.skipped }}</p>{% endif %}
{% if c.statements %}<table><tr><th>statement</th><th>thesis</th><th>measured</th><th>wanted</th><th></th></tr>
{% for s in c.statements %}<tr><td>{{ s.text }}</td><td>{{ s.where }}</td><td class="n">{{ s.value }}</td>
<td>{{ s.wanted }}</td><td class="{{ "good" if s.holds else "bad" }}">{{ "holds" if s.holds else "does not" }}</td></tr>
{% endfor %}</table>{% endif %}
{% for t in c.tables %}<h3>{{ t.title }}</h3><table><tr>{% for cell in t.head %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in t.rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table>{% if t.note %}<p class="small">{{ t.note }}</p>{% endif %}{% endfor %}
{% for f in c.figures %}<figure><img alt="{{ f.caption }}" src="data:image/png;base64,{{ f.data }}">
<figcaption>{% if f.figure %}<b>Thesis {{ f.figure }}.</b> {% endif %}{{ f.caption }}</figcaption></figure>
{% endfor %}
{% if c.verdicts %}<details><summary>Bounds of its scenarios: {{ c.inside }} of {{ c.verdicts|length }} hold</summary>
<table>{% for v in c.verdicts %}<tr><td>{{ v.name }}</td><td>{{ v.text }}</td>
<td class="{{ "good" if v.inside else "bad" }}">{{ "holds" if v.inside else "does not" }}</td></tr>{% endfor %}</table>
</details>{% endif %}
<p class="small">{{ c.origin }}</p>
{% endfor %}
</body></html>
"""


def write_page(done: Reproduction, *, quick: bool, wanted: int) -> Path:
    """Write the page with all figures embedded."""
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(PAGE)
    holding, total = done.counts
    write_text(done.report, page.render(
        origin=provenance(), quick=quick, wanted=wanted, interrupted=done.interrupted, broken=done.broken,
        **opening([(c.experiment.title, c.results) for c in done.chapters]),
        holding=holding, total=total, took=sum(c.cpu_s for c in done.chapters),
        chapters=[_chapter(c) for c in done.chapters],
    ))  # fmt: skip
    return done.report


FIGURES = {
    "6.1": "the targets, real and simulated", "6.2": "the drone passing them",
    "6.3": "amplitudes of the plate", "6.4": "amplitudes of the turned plate", "6.5": "amplitudes of the square pole",
    "6.6": "amplitudes of the wire", "6.7": "SAR images of the plate, facing and turned",
    "6.8": "SAR images of pole and wire", "6.9": "SAR image of the NTNU room", "6.10": "the simulated NTNU room",
    "6.11": "the cluttered room", "6.12": "the paths flown", "6.13": "maps of the NTNU room, four resolutions",
    "6.14": "maps of the cluttered room, two runs", "6.15": "the ship's hold", "6.16": "the hold simplified",
    "6.17": "the path in the hold", "6.18": "map of the hold",
}  # fmt: skip
"""Every figure of chapter 6 and what it shows."""
ELSEWHERE = {
    "6.1": "the worlds' pictures: docs, Worlds", "6.2": "photographs; not reproduced",
    "6.10": "docs, Worlds", "6.11": "docs, Worlds", "6.12": "drawn into the maps of 6.13 and 6.14",
    "6.15": "docs, Worlds", "6.16": "docs, Worlds",
    "6.17": "drawn into the map of 6.18",
}  # fmt: skip


def opening(chapters: Sequence[tuple[str, Results]]) -> dict[str, Any]:
    """Return the page's summary: what holds, what differs, what was not compared, and every figure by number."""
    shown: dict[str, list[str]] = {}
    for title, found in chapters:
        for item in found.figures:
            for number in _numbers(item.figure):
                shown.setdefault(number, []).append(f"{title}: {item.file}")
    own = [(title, [s for s in found.statements if s.where not in ("beyond", "real")]) for title, found in chapters]
    return {
        "holds": [f"{title}: {sum(s.holds for s in mine)} of {len(mine)} statements about the thesis hold."
                  for title, mine in own if mine],
        "differs": [d for _, found in chapters for d in found.differences],
        "lacking": [line for _, found in chapters for line in (*found.not_compared, *filter(None, [found.skipped]))],
        "figures": [{"number": number, "shows": shows,
                     "here": ", ".join(shown.get(number, [])) or ELSEWHERE.get(number, "not in this run")}
                    for number, shows in FIGURES.items()],
    }  # fmt: skip


def _numbers(figure: str) -> list[str]:
    """Return the numbers in "figure 6.3", "figures 6.15 to 6.17" or "figures 6.11 and 6.12b"."""
    ends = re.findall(r"6\.\d+", figure)
    if " to " in figure and len(ends) == 2:
        first, last = (int(end[2:]) for end in ends)
        return [f"6.{k}" for k in range(first, last + 1)]
    return ends


def _encoded(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()


def _chapter(chapter: Chapter) -> dict[str, Any]:
    found, experiment = chapter.results, chapter.experiment
    return {
        "name": experiment.name, "title": experiment.title, "section": experiment.section, "notes": found.notes,
        "skipped": found.skipped, "tables": found.tables,
        "statements": [
            {"text": s.text, "where": s.where, "value": f"{s.value:.3g} {s.unit}", "wanted": s.wanted, "holds": s.holds}
            for s in found.statements
        ],
        "figures": [
            {"figure": e.figure, "caption": e.caption, "data": _encoded(chapter.folder / e.file)}
            for e in found.figures
        ],
        "verdicts": [{"name": name, "text": v.text, "inside": v.inside} for name, v in chapter.verdicts],
        "inside": sum(v.inside for _, v in chapter.verdicts),
        "origin": chapter.origin,
    }  # fmt: skip
