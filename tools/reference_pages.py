"""The pages of scenarios, materials and references as Markdown, made from the code as the documentation is built."""

from __future__ import annotations

import re

from ullage.config import Scenario, scenario_text
from ullage.specs import RadarSpec
from ullage.world.materials import MATERIALS, Material

SCENARIOS = """# Scenarios

A scenario is one YAML file: world, flight, radars, what to make of the echoes, and what must come out. `ullage list`
names those that come with ullage, `ullage config NAME` prints one in full, `ullage run NAME` or `ullage run FILE.yaml`
runs it.

| option | does | for |
|---|---|---|
| `--law thesis` | simulates the ray model of 2018 and maps with Elfes' grid | every family; used if no law is named |
| `--law physical` | simulates physical echoes and maps them by the default method | every family |
| `--by-hand` | adds the errors of a human pilot, at 1 m/s | `ntnu-plate`, `ntnu-plate45`, `ntnu-pole`, `ntnu-wire` |

The options work with `ullage run`, `config` and `sweep`; `ullage fly` takes `--law`. Each variant also has a name of
its own. For example, `ullage run ntnu-wire --law physical --by-hand` is `ullage run ntnu-wire-physical-by-hand`.
`ullage list scenarios` shows both names of every variant. Three of them differ from `ntnu-mapping` only in the size of
their cells: `ntnu-mapping-5cm`, `ntnu-mapping-20cm` and `ntnu-mapping-50cm`.

- Absent fields have the defaults below. `name` is by default the file name.
- `-o a.b=value` changes one field; values are YAML, e.g. `-o flight.waypoints='[[0, 0, 1], [2, 0, 1]]'`.
- A field that does not exist, or a value out of bounds, is refused with its name.
- `ullage config --schema` prints the JSON schema, with which editors complete and check such files.

Choices that the comments do not list:

| field | values |
|---|---|
| `world.geometry` | `collision`, `visual` |
| `world.missing` | `refuse`, `skip` |
| `sensing.fidelity` | `physical`, `thesis` |
| `do` | any of `detect`, `image`, `map`, `obstacles` |
| `detect.method` | `first_peak`, `peaks`, `cfar`, `os-cfar`, `clean`, `track` |
| `map.method` | `ullage`, `likelihood`, `elfes` |
| `map.dims` | `2`, `3` |
| `image.method` | `backprojection`, `summation` |

`image.z_m` or
`image.volume` choose the plane or the heights that are imaged. `remove_own_echo: false` keeps the
[radar's own echo](imaging.md#the-radars-own-echo).

## Files that a scenario names

A world, a `search_path` folder or an antenna table in a scenario file lies in one of three places: the scenario's own
folder, the current folder, or a folder of `GZ_SIM_RESOURCE_PATH`. ullage refuses anything else in one line. Options may
name any file: `-o world.file=PATH`. A `.xacro` world runs only with `--trust-xacro`. A scenario file has at most 1 MB,
50 levels and 100,000 values. Dates are text.

## All fields

```yaml
{scenario}```

## Bounds

```yaml
expect:
  f1: {{min: 0.6}}
  surface_declared_free: {{max: 0.02}}
```

Any metric in the run's `metrics.json` can be bounded. `ullage measure` checks each, and exits 1 when one
is broken or unknown.

## Fields of a radar

For `sensing.changes`, and for `ul.RadarSpec.preset("x4m05", ...)` in Python. Other presets: {presets}.

```yaml
{radar}```
"""

MATERIALS_HEAD = """# Materials

The material of a surface decides how much it reflects and how much it lets through. This page lists the values and
their sources. Permittivity is `eps' = a f^b`, conductivity `sigma = c f^d` [S/m], f in GHz
([ITU-R-P2040]); water and tissue have relaxation models. A carrier outside a material's range is refused.

![Power that a sheet of each material returns and lets through](pictures/concepts/materials.png)

- **Names** go by any letter case, with `_` for `-`, and with or without `itu_` in front: `itu_concrete` is `concrete`.
- **Thickness** is that of the slab that every face of the material stands for; *thick* means that nothing comes out at
  the back. Within a slab all inner reflections count; when the slab is long against the pulse, its echoes are separate.
- **Conductors** reflect everything: at 1-10 GHz real metal loses less than 0.01 dB.
- **Roughness** (`roughness_m`, rms height) and its `correlation_m` (ten times the height unless you set it) are fields
  of `Material`, and attributes of `<ullage:material>` in SDF; 0 unless you set them. The coherent amplitude falls by
  `exp(-(2 k s cos)^2 / 2)`, its power by `exp(-(2 k s cos)^2)` [Ament1953]. The lost power is scattered diffusely, by
  Kirchhoff's law for exponentially correlated heights [BeckmannSpizzichino1963]: see [Physics](physics.md).
- **Reflection** is the coefficient I_m of the ray model of 2018 (`laser_retro` in SDF), not used by the physical model.

| name | model | a | b | c | d | valid [GHz] | slab [m] | eps at 7.29 GHz | I_m | source |
|---|---|---|---|---|---|---|---|---|---|---|
"""


def scenario_page() -> str:
    """The page on scenario files, as Markdown."""
    others = ", ".join(name for name in RadarSpec.names() if name != "x4m05")
    return SCENARIOS.format(
        scenario=scenario_text(Scenario(name="mine")), radar=scenario_text(RadarSpec()), presets=others
    )


def materials_page() -> str:
    """The page of materials, as Markdown."""
    return MATERIALS_HEAD + "".join(f"| {' | '.join(_cells(name, one))} |\n" for name, one in MATERIALS.items())


def _cells(name: str, one: Material) -> list[str]:
    kind = "conductor" if one.conductor else one.model
    itu = [f"{value:g}" for value in (one.a, one.b, one.c, one.d)] if kind == "itu" else [""] * 4
    low, high = one.valid_ghz
    at = one.permittivity(7.29e9) if not one.conductor and low <= 7.29 <= high else None
    return [
        name,
        kind,
        *itu,
        "any" if one.conductor else f"{low:g}-{high:g}",
        "thick" if one.thickness_m is None else f"{one.thickness_m:g}",
        "" if at is None else f"{at.real:.2f} - {-at.imag:.3f}j",
        f"{one.reflection:g}",
        one.source,
    ]


def references_page(bibtex: str) -> str:
    """The page of references, as Markdown, from BibTeX text."""
    lines = ["# References", "", "From `docs/references.bib`.", ""]
    for key, body in sorted(re.findall(r"@\w+\{([^,\s]+),(.*?)\n\}", bibtex, re.S), key=lambda e: e[0].lower()):
        lines.append(f"- **[{key}]** {_told(body)}")
    return "\n".join(lines) + "\n"


def _told(body: str) -> str:
    fields = {
        name: _plain(value)
        for name, value in re.findall(r"(\w+)\s*=\s*\{((?:[^{}]|\{(?:[^{}]|\{[^{}]*\})*\})*)\}", body)
    }
    who = (fields.get("author") or fields.get("editor") or fields.get("organization") or "").replace(" and ", "; ")
    where = [
        fields[k] for k in ("journal", "booktitle", "publisher", "school", "institution", "howpublished") if k in fields
    ]
    volume = [f"{k} {fields[k]}" for k in ("volume", "number", "pages", "edition") if k in fields]
    link = [f"doi:{fields['doi']}"] if "doi" in fields else [f"arXiv:{fields['eprint']}"] if "eprint" in fields else []
    parts = [who, fields.get("title", ""), *where, *volume, fields.get("year", ""), *link]
    return ". ".join(part.rstrip(".") for part in parts if part) + "."


def _plain(text: str) -> str:
    text = re.sub(r"\\url\{([^}]*)\}", r"\1", text)
    for mark, letter in {'\\"a': "ä", '\\"o': "ö", '\\"u': "ü", "\\'e": "é", "\\_": "_", "\\&": "&", "--": "-"}.items():
        text = text.replace(mark, letter)
    return re.sub(r"\s+", " ", re.sub(r"[{}]", "", text)).strip()
