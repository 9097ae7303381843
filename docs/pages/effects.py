"""A page and a picture of every effect, and the table of all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from pages.markdown import MADE, ROOT, escape, printed, prose, table, unbroken, write


def write_effects() -> None:
    """Write a page and a picture for each effect, and the table of all."""
    from fretflow.effects.catalogue import catalogue

    known = catalogue()
    rows = [(f"[{name}](_made/effects/{name}.md)", str(kind.block), escape(kind.title)) for name, kind in known.items()]
    write("effect_list.md", table(("effect", "changes", "is"), rows))
    for name, kind in known.items():
        write(f"effects/{name}.md", effect_page(name, kind))
        draw_picture(kind, MADE / "effects" / f"{name}.svg")


def effect_page(name: str, kind: Any) -> str:
    """Return the page of one effect."""
    from fretflow.effects.catalogue import catalogue
    from fretflow.inference.words import EVERYTHING

    known = catalogue()
    where = "recordings of " + ", ".join(f"`{each}`" for each in sorted(kind.acts_in()))
    facts = [f"Changes the **{kind.block}**; known in {where}.",
             *(["Recordings that lack time tell nothing of it."] if kind.needs_time else [])]
    equation = f"$$\n{kind.formula}\n$$" if kind.formula else f"`{kind.equation}`"
    told_from = {**kind.told_from, **{other: known[other].told_from[name] for other in known
                                      if name in known[other].told_from}}
    confirm = [f"- {escape((kind.told_by or EVERYTHING).rstrip(','))}"]
    confirm += [f"- from [{other}]({other}.md): {escape(how.rstrip(','))}" for other, how in told_from.items()]
    pieces = [f"# {name}", f"*{escape(kind.title)}*", prose(kind.__doc__, printed), equation, " ".join(facts),
              f"```{{image}} {name}.svg\n:alt: what {name} does\n```",
              "## Parameters", parameter_table(kind), "In a case file:", example_of(name, kind),
              "## What shows it", "\n".join(f"- {escape(each)}" for each in kind.observables),
              "## What would confirm it", escape(kind.confirmed_by), "\n".join(confirm)]
    if kind.excludes:
        pieces += ["## Not together with",
                   "\n".join(f"- [{other}]({other}.md): {escape(why)}" for other, why in kind.excludes.items())]
    pieces += ["## Source", "\n".join(f"- {escape(each.strip())}" for each in kind.source.split(";"))]
    return "\n\n".join(filter(None, pieces)) + "\n"


def parameter_table(kind: Any) -> str:
    """Return the parameters of an effect with unit, default, plausible range and where that is from."""
    from fretflow.case.casefile import entries
    from fretflow.core.units import pretty_number, pretty_quantity

    rows, sources = [], {}
    priors = kind.priors()
    for entry in entries(kind()):
        prior = priors.get(entry.key)
        ends = () if prior is None else (prior.low, prior.high)
        span = " to ".join(unbroken(pretty_quantity(end, entry.unit, 3) if entry.unit else pretty_number(end, 3))
                           for end in ends)
        default = pretty_number(entry.value) if isinstance(entry.value, float) and not entry.unit else entry.readable
        rows.append((f"`{entry.key}`", unbroken(escape(default)), span, printed(entry.meaning)))
        if prior is not None:
            sources.setdefault(prior.source, []).append(f"`{entry.key}`")
    ranges = "; ".join(f"{escape(source)}{f' ({chr(44).join(keys)})' if len(sources) > 1 else ''}"
                       for source, keys in sources.items())
    return table(("parameter", "default", "plausible range", "meaning"), rows) + (
        f"\nRanges: {ranges}.\n" if ranges else "")


def example_of(name: str, kind: Any) -> str:
    """Return the effect's table of a case file with its defaults."""
    from fretflow.case.casefile import entries

    lines = [f'{entry.key} = "{entry.readable}"' if entry.unit else f"{entry.key} = {entry.toml}"
             for entry in entries(kind()) if entry.value is not None]
    return "\n".join(["```toml", f"[effects.{name}]", *lines, "```"])


def draw_picture(kind: Any, path: Path) -> None:
    """Draw what an effect does; drawn again only when the picture's code or the effect's file is newer."""
    import matplotlib
    from fretflow_post import effect_sheet, style

    sources = [Path(__file__), Path(effect_sheet.__file__), *(ROOT / "workflow" / "fretflow" / "effects").glob("*.py")]
    if path.is_file() and path.stat().st_mtime > max(file.stat().st_mtime for file in sources):
        return
    sketch = kind().sketch()
    beneath = int(effect_sheet.is_comparable(sketch))
    with style.styled(), matplotlib.rc_context({"svg.hashsalt": "fretflow", "font.size": 11, "axes.labelsize": 11,
                                                "xtick.labelsize": 10, "ytick.labelsize": 10, "legend.fontsize": 10}):
        figure = Figure(figsize=(7.2, 3.4 + 1.2 * beneath), layout="constrained")
        panels = figure.subplots(1 + beneath, squeeze=False, height_ratios=[3, 1.4][:1 + beneath])[:, 0]
        effect_sheet.draw_sketch(panels, sketch)
        figure.savefig(path, metadata={"Date": None})
