"""Pages made from the code when the site is built: effects, keys of files, commands, verification, scoreboards.

They are written to `docs/_made` before Sphinx reads its sources, so that they cannot fall behind the code.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import types
from collections.abc import Iterable, Iterator
from enum import Enum
from html.parser import HTMLParser
from inspect import cleandoc
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin
from urllib.parse import unquote, urlsplit

from annotated_types import Ge, Gt, Le, Lt
from matplotlib.figure import Figure
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util import logging

DOCS = Path(__file__).parent
ROOT = DOCS.parent
MADE = DOCS / "_made"
LOG = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, bool]:
    """Have the pages made before Sphinx looks for its sources, and the trials' own pages copied into the site."""
    app.connect("builder-inited", make_pages, priority=100)  # before sphinx-gallery, whose pages link to these
    app.connect("autodoc-process-docstring", keep_bars, priority=1)  # before its sections become reST
    app.connect("build-finished", copy_trials)
    app.connect("build-finished", check_links, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def make_pages(app: Sphinx) -> None:
    """Write all pages of this module; runs of scripts begin afresh, and are then shared among them."""
    forget_effects({}, "")
    for folder in ("tutorials", "gallery"):
        shutil.rmtree(DOCS / folder / "runs", ignore_errors=True)
    write("cli.md", commands())
    write("case_keys.md", case_keys())
    write("recording_keys.md", recording_keys())
    write("structure_keys.md", structure_keys())
    write("verification.md", verification())
    write("trials.md", scoreboards())
    write("api.rst", public_names())
    write_effects()


def write(name: str, text: str) -> None:
    """Write the page `name`, unless it stands there already, so that Sphinx reads again what changed alone."""
    path = MADE / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table; what would end a cell is escaped."""
    lines = [tuple(head)]
    lines += [tuple("---" for _ in lines[0]), *(tuple(row) for row in rows)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |"
                     for row in lines) + "\n"


def escape(text: str) -> str:
    """Return plain text as Markdown that shows it letter by letter."""
    return re.sub(r"([\\`*_\[\]<>$#~])", r"\\\1", text)


def prose(docstring: str | None) -> str:
    """Return a docstring's text as Markdown: reST's double backticks and colons in Markdown's way."""
    text = cleandoc(docstring or "")
    text = re.sub(r"(?m)^\s*(Parameters|Attributes|Raises|Returns|Examples)\n\s*-{3,}\n(?s:.*)", "", text).strip()
    parts = re.split(r"(`+[^`]+`+)", text.replace("::\n", ":\n"))
    return "".join("`" + part.strip("`") + "`" if part.startswith("`") else escape(part) for part in parts)


# Effects

def write_effects() -> None:
    """Write a page and a picture for each effect, and the table of all."""
    from fretflow.effects.catalogue import catalogue

    known = catalogue()
    rows = [(f"[{name}](_made/effects/{name}.md)", str(kind.block), escape(kind.title)) for name, kind in known.items()]
    write("effect_list.md", table(("effect", "changes", "is"), rows))
    for name, kind in known.items():
        write(f"effects/{name}.md", effect_page(name, kind))
        draw_sketch(kind, MADE / "effects" / f"{name}.svg")


def effect_page(name: str, kind: Any) -> str:
    """Return the page of one effect."""
    from fretflow.effects.effect import ALL_KINDS

    where = "all kinds of recordings" if kind.kinds == ALL_KINDS else "recordings of " + ", ".join(
        f"`{each}`" for each in sorted(kind.kinds))
    facts = [f"Changes the **{kind.block}**; known in {where}.",
             *(["Recordings that lack time tell nothing of it."] if kind.needs_time else [])]
    equation = f"$$\n{kind.formula}\n$$" if kind.formula else f"`{kind.equation}`"
    confirm = [f"- {escape(kind.told_by.rstrip(','))}"] if kind.told_by else []
    confirm += [f"- from [{other}]({other}.md): {escape(how.rstrip(','))}" for other, how in kind.told_from.items()]
    pieces = [f"# {name}", f"*{escape(kind.title)}*", prose(kind.__doc__), equation, " ".join(facts),
              f"```{{image}} {name}.svg\n:alt: what {name} does\n```",
              "## Parameters", parameter_table(kind), "In a case file:", example_of(name, kind),
              "## What shows it", "\n".join(f"- {escape(each)}" for each in kind.observables)]
    if confirm or kind.confirmed_by:
        pieces += ["## What would confirm it", escape(kind.confirmed_by), "\n".join(confirm)]
    if kind.excludes:
        pieces += ["## Not together with",
                   "\n".join(f"- [{other}]({other}.md): {escape(why)}" for other, why in kind.excludes.items())]
    pieces += ["## Source", "\n".join(f"- {escape(each.strip())}" for each in kind.source.split(";"))]
    return "\n\n".join(filter(None, pieces)) + "\n"


def parameter_table(kind: Any) -> str:
    """Return the parameters of an effect with unit, default, plausible range and where that is from."""
    from fretflow.case.casefile import entries
    from fretflow.core.units import format_quantity

    rows, sources = [], {}
    priors = kind.priors()
    for entry in entries(kind()):
        prior = priors.get(entry.key)
        ends = () if prior is None else (prior.low, prior.high)
        span = " to ".join(format_quantity(end, entry.unit, 3) if entry.unit else f"{end:g}" for end in ends)
        default = f"{entry.value:g}" if isinstance(entry.value, float) and not entry.unit else entry.readable
        rows.append((f"`{entry.key}`", escape(default), span, escape(entry.meaning)))
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


def draw_sketch(kind: Any, path: Path) -> None:
    """Draw what an effect does; drawn again only when the picture's code or the effect's file is newer."""
    import matplotlib
    from fretflow_post import style

    sources = [Path(__file__), *(ROOT / "workflow" / "fretflow" / "effects").glob("*.py")]
    if path.is_file() and path.stat().st_mtime > max(file.stat().st_mtime for file in sources):
        return
    sketch = kind().sketch()
    with style.styled(), matplotlib.rc_context({"svg.hashsalt": "fretflow", "font.size": 11, "axes.labelsize": 11,
                                                "xtick.labelsize": 10, "ytick.labelsize": 10, "legend.fontsize": 10}):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        axes = figure.add_subplot()
        for k, (label, (x, y)) in enumerate(sketch.curves.items()):
            colour, line = style.curve_look(k)
            axes.plot(x, y, color=colour, linestyle=line, label=label)
        axes.set(xlabel=sketch.x_label, ylabel=sketch.y_label)
        if any(sketch.curves):
            axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)
        figure.savefig(path, metadata={"Date": None})


# Keys of case files and recordings

def case_keys() -> str:
    """Return every key of a case file, table by table."""
    from fretflow.case.config import Case

    return "\n\n".join(key_tables(Case)) + "\n"


def recording_keys() -> str:
    """Return every key of a ``recording.toml``, and the channels."""
    from fretflow.recordings.channels import CHANNELS
    from fretflow.recordings.schema import ChannelSpec, RecordingFile

    shared = ("rig", "specimen")
    channels = table(("channel", "SI unit"), ((f"`{name}`", " or ".join(f"`{unit}`" for unit in units))
                                              for name, units in CHANNELS.items()))
    return "\n\n".join([*key_tables(RecordingFile, skip=shared),
                        "### A channel", key_table(ChannelSpec), "### Names of channels", channels]) + "\n"


def structure_keys() -> str:
    """Return every key of a recording of a structure."""
    from fretflow.recordings.kinds.structures import StructureFile

    return "\n\n".join(key_tables(StructureFile)) + "\n"


def key_tables(model: type[BaseModel], name: str = "", skip: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield heading, explanation and keys of `model`, then of the tables in it."""
    from fretflow.case.config import Specimens

    if model is Specimens:
        yield from key_tables(get_args(model)[0] if get_args(model) else model.model_fields["upper"].annotation, name)
        yield ("`[specimen.upper]` and `[specimen.lower]` take the same keys, for what differs between the two; "
               "keys under `[specimen]` hold for both.")
        return
    yield f"### `[{name}]`" if name else "### At the top"
    yield prose(model.__doc__)
    if keys := key_table(model):
        yield keys
    for key, info in model.model_fields.items():
        if key not in skip and (inner := table_in(info)):
            double = get_origin(plain_type(info.annotation)) is tuple
            inside = f"{name}.{key}" if name else key
            yield from key_tables(inner, f"[{inside}]" if double else inside)


def key_table(model: type[BaseModel]) -> str:
    """Return the keys of `model` that are no tables, with unit, default and limits."""
    rows = [(f"`{key}`", kind_of(info), default_of(info), limits_of(info), escape(info.description or ""))
            for key, info in model.model_fields.items()
            if table_in(info) is None and get_origin(plain_type(info.annotation)) is not dict]
    return table(("key", "takes", "default", "limits", "meaning"), rows) if rows else ""


def plain_type(annotation: Any) -> Any:
    """Return a type without ``None`` beside it and without annotations."""
    options = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    kept = [option for option in options if option is not type(None)]
    first = kept[0]
    return get_args(first)[0] if hasattr(first, "__metadata__") else (first if len(kept) == 1 else annotation)


def table_in(info: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a key that is a table, or an array of tables."""
    kind = plain_type(info.annotation)
    if get_origin(kind) is tuple:
        kind = get_args(kind)[0]
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) and not is_channel(kind) else None


def is_channel(kind: Any) -> bool:
    """Return whether a type is the table of one column, which is told once."""
    return isinstance(kind, type) and issubclass(kind, BaseModel) and "column" in kind.model_fields


def marks_of(info: FieldInfo) -> Iterator[Any]:
    """Yield the annotations of a key, also those inside an optional type."""
    yield from info.metadata
    for option in get_args(info.annotation):
        yield from getattr(option, "__metadata__", ())


def unit_of(info: FieldInfo) -> str:
    """Return the SI unit of a key, if it has one."""
    from fretflow.core.units import Unit

    return next((mark.unit for mark in marks_of(info) if isinstance(mark, Unit)), "")


def kind_of(info: FieldInfo) -> str:
    """Return in words what a key takes."""
    if unit := unit_of(info):
        return f'text as `"1 {unit}"`'
    kind = plain_type(info.annotation)
    if is_channel(kind):
        return "a channel"
    if isinstance(kind, type) and issubclass(kind, Enum):
        return " or ".join(f'`"{option.value}"`' for option in kind)
    if get_origin(kind) is Literal:
        return " or ".join(f"`{json.dumps(option)}`" for option in get_args(kind))
    if get_origin(kind) is tuple:
        return "whole numbers in brackets"
    if get_origin(kind) in (Union, types.UnionType):
        return " or ".join(WORDS.get(option, "text") for option in get_args(kind) if option is not type(None))
    return WORDS.get(kind, "text")


WORDS = {int: "whole number", float: "number", bool: "`true` or `false`", str: "text", Path: "path of a file"}


def default_of(info: FieldInfo) -> str:
    """Return the default as a case file would have it."""
    from fretflow.core.units import format_quantity

    if info.is_required():
        return "**required**"
    value = info.get_default(call_default_factory=True)
    if value is None or value in ("", ()):
        return "none"
    if unit := unit_of(info):
        return f'`"{format_quantity(value, unit)}"`'
    return f"`{json.dumps(value.value if isinstance(value, Enum) else value)}`"


def limits_of(info: FieldInfo) -> str:
    """Return the limits of a number."""
    names = {Ge: ("ge", "≥"), Gt: ("gt", ">"), Le: ("le", "≤"), Lt: ("lt", "<")}
    found = [f"{sign} {getattr(mark, attribute):g}" for mark in marks_of(info)
             for kind, (attribute, sign) in names.items() if isinstance(mark, kind)]
    checks = {getattr(getattr(mark, "func", None), "__name__", "") for mark in marks_of(info)}
    return ", ".join(found) or ("> 0" if "_positive" in checks else "≥ 0" if "_not_negative" in checks else "")


# Commands

def commands() -> str:
    """Return the reference of all commands, as their help has it."""
    from fretflow.cli.app import app

    text = app.generate_docs(output_format="markdown")
    body = re.sub(r"(?s)^.*?(?=^## fretflow run)", "", text, count=1, flags=re.MULTILINE)
    return "# Commands\n\nWhat `./fretflow COMMAND --help` says.\n\n" + body.replace(
        "OUT/NAME", "`OUT/NAME`").replace(" -m sphinx", "")  # what started this process


# Python API

def public_names() -> str:
    """Return a section of reST for each kind of public name."""
    import fretflow

    groups: dict[str, list[str]] = {"Functions": [], "Classes": [], "Errors": [], "Modules": [], "Values": []}
    for name in fretflow.__all__:
        value = getattr(fretflow, name)
        where = ("Modules" if isinstance(value, types.ModuleType) else "Values" if not callable(value)
                 else "Functions" if not isinstance(value, type)
                 else "Errors" if issubclass(value, Exception) else "Classes")
        groups[where].append(name)
    directives = {"Functions": "autofunction", "Classes": "autoclass", "Modules": "automodule",
                  "Errors": "autoexception", "Values": "autodata"}
    lines = []
    for title, names in groups.items():
        if names:
            lines += [title, "-" * len(title), ""]
        for name in sorted(names, key=str.lower):
            value = getattr(fretflow, name)
            lines += [f".. {directives[title]}:: {value.__name__ if title == 'Modules' else f'fretflow.{name}'}"]
            lines += ["   :members:"] if title in ("Classes", "Modules") else []
            lines += [""]
    return "\n".join(lines)


def keep_bars(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Have the bars of absolute values in docstrings read as such, not as reST's substitutions."""
    for row, line in enumerate(lines):
        parts = re.split(r"(``.+?``)", line)
        lines[row] = "".join(part if part.startswith("``") else part.replace("|", "\\|") for part in parts)


# Verification

ROOMS = {"analytic": "Closed forms, balances and other integrators", "convergence": "Convergence under refinement",
         "regression": "Peers, published matrices and recorded results", "mpi": "Any number of ranks"}
MOST_BOUNDS = 3


def verification() -> str:
    """Return what each test module verifies against, and the figures that its tests assert."""
    pieces = [VERIFICATION_HEAD]
    for room, title in ROOMS.items():
        pieces.append(f"## {title}")
        for file in sorted((ROOT / "tests" / room).glob("test_*.py")):
            tree = ast.parse(file.read_text(encoding="utf-8"))
            tests = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")]
            heading, _, rest = (ast.get_docstring(tree) or file.stem).partition("\n")
            rows = [(spoken(test), "; ".join(bounds(test))) for test in tests]
            pieces += [f"### {escape(heading.rstrip('.'))}", literal_blocks(rest.strip()),
                       f"`tests/{room}/{file.name}`", table(("what holds", "to"), rows)]
    return "\n\n".join(filter(None, pieces)) + "\n"


VERIFICATION_HEAD = """# Verification

Every test that compares with something independent: a closed form, a limit, a balance, a rate of convergence, another
integrator or code, a measurement. The right column holds the bounds that the test asserts, as its code has them; a
test without one asserts an identity, an order or a message. This page is made from the tests; `./fretflow test` runs
them all."""


def spoken(test: ast.FunctionDef) -> str:
    """Return a test's name as a sentence."""
    return escape(test.name.removeprefix("test_").replace("_", " "))


def literal_blocks(text: str) -> str:
    """Return a module's docstring as Markdown, with reST's literal blocks as code."""
    pieces = []
    for paragraph in text.replace("::\n\n", ":\n\n").split("\n\n"):
        code = paragraph.startswith("    ")
        pieces.append(f"```text\n{cleandoc(paragraph)}\n```" if code else prose(paragraph))
    return "\n\n".join(pieces)


def bounds(test: ast.FunctionDef) -> Iterator[str]:
    """Yield the bounds that a test asserts: tolerances of comparisons, and numbers that something stays below."""
    found: dict[str, None] = {}
    for node in ast.walk(test):
        if isinstance(node, ast.Call):
            for word in node.keywords:
                if word.arg in ("rel", "abs", "rtol", "atol") and (value := number(word.value)) is not None:
                    kind = "relative" if word.arg in ("rel", "rtol") else "absolute"
                    found[f"{value:.3g} {kind}"] = None
        if isinstance(node, ast.Assert):
            for compared in (each for each in ast.walk(node.test) if isinstance(each, ast.Compare)):
                for sign, right in zip(compared.ops, compared.comparators, strict=True):
                    value = number(right)
                    if isinstance(sign, ast.Lt | ast.LtE) and value is not None and 0.0 < value < 1.0:
                        found[f"below {value:.3g}"] = None
    yield from list(found)[:MOST_BOUNDS]


def number(node: ast.expr) -> float | None:
    """Return a literal number, zero excluded."""
    value = node.value if isinstance(node, ast.Constant) else None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and value else None


# Scoreboards

TRIALS = ("trial", "trial-100", "trial-100-2029", "trial-100-2030", "trial-100-2031")
SCORES = {"right_name": "right name", "wrong_name": "wrong name", "wrong_and_sure": "wrong, at probability above 0.9",
          "false_alarms": "false alarms", "missed": "missed", "unknown_recognised": "unlisted effects called unknown",
          "pairs": "both effects of a pair", "location": "right place",
          "coverage": "90 % intervals that hold the truth",
          "failed": "failed"}


def scoreboards() -> str:
    """Return the results of the trials on concealed recordings, side by side."""
    shown = [name for name in TRIALS if (ROOT / "benchmarks" / name / "trial.json").is_file()]
    boards = [json.loads((ROOT / "benchmarks" / name / "trial.json").read_text(encoding="utf-8")) for name in shown]
    rows = [(label, *(f"{board['all'][key]['hits']} of {board['all'][key]['cases']}" for board in boards))
            for key, label in SCORES.items()]
    rows.append(("expected calibration error", *(f"{board['all']['calibration_error']['value']:.3g}"
                                                 for board in boards)))
    rows.append(("seconds a case, median (longest)",
                 *(f"{board['all']['seconds']['value']:.0f} ({board['all']['seconds']['longest']:.0f})"
                   for board in boards)))
    links = ", ".join(f'<a href="trials/{name}.html">{name}</a>' for name in shown)
    return (TRIALS_HEAD + "\n\n" + table(("", *shown), rows)
            + f"\nEvery case as it came out:\n\n```{{raw}} html\n<p>{links}</p>\n```\n")


TRIALS_HEAD = """# Trials on concealed recordings

`fretflow trial` makes recordings with a second simulator that shares no code with fretflow, seals the answers,
diagnoses each recording in a process of its own and only then opens them. A fifth of the recordings hides nothing, a
fifth holds physics beyond the catalogue, a fifth two effects, the rest one, of any size: what stands little above the
noise is not seen by anybody. The trials stand in the order in which they were made, each with seeds that nobody had
seen; scores of all sizes are here, those of strong effects alone in the pages below. They stay as they came out."""


def copy_trials(app: Sphinx, error: Exception | None) -> None:
    """Copy the trials' own pages into the site."""
    if error is None and app.builder.format == "html":
        for name in TRIALS:
            page = ROOT / "benchmarks" / name / "trial.html"
            if page.is_file():
                target = Path(app.outdir) / "_made" / "trials" / f"{name}.html"
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(page, target)


# Links

class Links(HTMLParser):
    """Gathers what a page refers to, and whether a browser loads it."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, bool]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep the tag's references."""
        self.found += [(value, tag != "a") for name, value in attrs if name in ("href", "src") and value]


def check_links(app: Sphinx, error: Exception | None) -> None:
    """Warn of links to files that are not in the site, and of anything that a page would load from a network."""
    site = Path(app.outdir)
    for page in sorted(site.rglob("*.html")) if error is None and app.builder.format == "html" else ():
        links = Links()
        links.feed(page.read_text(encoding="utf-8"))
        for link, loaded in links.found:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if loaded and parts.scheme not in ("data", ""):
                    LOG.warning("%s loads %s; the site has to work without a network", page.relative_to(site), link)
            elif parts.path and not (page.parent / unquote(parts.path)).exists():
                LOG.warning("%s: there is no %s", page.relative_to(site), link)


# Scripts

def forget_effects(gallery_conf: dict[str, Any], file: str) -> None:
    """Take back the effects that a script, or who builds the site, has added."""
    from fretflow.effects.catalogue import FOLDERS

    os.environ.pop(FOLDERS, None)



def shown_pictures(block: Any, variables: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Return what a block of a script ends with as pictures: a figure, a picture's path, or a list of either."""
    from sphinx_gallery.scrapers import figure_rst

    last, saved = variables["example_globals"].get("___"), []
    if last is variables["example_globals"].get("_drawn"):
        return ""  # the end of an earlier block
    variables["example_globals"]["_drawn"] = last
    for shown in last if isinstance(last, list | tuple) else [last]:
        if isinstance(shown, Figure) or (isinstance(shown, Path) and shown.suffix == ".png"):
            target = next(variables["image_path_iterator"])
            shown.savefig(target) if isinstance(shown, Figure) else shutil.copyfile(shown, target)
            saved.append(target)
    return figure_rst(saved, gallery_conf["src_dir"]) if saved else ""
