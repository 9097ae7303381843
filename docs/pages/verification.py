"""What the tests verify and to which bounds, and how trials on concealed recordings came out."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path

from sphinx.application import Sphinx

from pages.markdown import ROOT, escape, prose, table, unbroken

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
them all.

## Bad input

`tests/unit/test_bad_inputs.py` gives commands 615 inputs that none can use: 504 values of the wrong kind, one for each
key and kind, 77 files (nested without end, pipes, claims of sizes that were never written, references in a circle), and
wrong paths and options. All are refused at once, in one line, with exit code 2, within 4 GB and 20 s.

`.venv/bin/python tests/regression/damaged_inputs.py 420 0` damages good cases, recordings (CSV, HDF5, MATLAB) and
meshes at random places, by cuts, noise, turned bits, gaps, lines left out and other numbers. Of 420 such files 114
were taken (a changed digit is a number too) and 305 refused in one line; one mesh ended gmsh and the command with it,
and is refused since meshes of one's own are read in a process of their own."""


def spoken(test: ast.FunctionDef) -> str:
    """Return a test's name as a sentence; a single `s` is a genitive's."""
    return escape(re.sub(r"_s(?=_|$)", "'s", test.name.removeprefix("test_")).replace("_", " "))


def literal_blocks(text: str) -> str:
    """Return a module's docstring as Markdown, with reST's literal blocks as code."""
    pieces = []
    for paragraph in text.replace("::\n\n", ":\n\n").split("\n\n"):
        code = paragraph.startswith("    ")
        pieces.append(f"```text\n{cleandoc(paragraph)}\n```" if code else prose(paragraph))
    return "\n\n".join(pieces)


def bounds(test: ast.FunctionDef) -> Iterator[str]:
    """Yield the bounds that a test asserts: tolerances of comparisons, and numbers that something stays below."""
    texts: dict[str, None] = {}
    for node in ast.walk(test):
        if isinstance(node, ast.Call):
            for word in node.keywords:
                if word.arg in ("rel", "abs", "rtol", "atol") and (value := number(word.value)) is not None:
                    kind = "relative" if word.arg in ("rel", "rtol") else "absolute"
                    texts[f"{value:.3g} {kind}"] = None
        if isinstance(node, ast.Assert):
            for compared in (each for each in ast.walk(node.test) if isinstance(each, ast.Compare)):
                for sign, right in zip(compared.ops, compared.comparators, strict=True):
                    value = number(right)
                    if isinstance(sign, ast.Lt | ast.LtE) and value is not None and 0.0 < value < 1.0:
                        texts[f"below {value:.3g}"] = None
    yield from (unbroken(re.sub("e-0", "e-", text)) for text in list(texts)[:MOST_BOUNDS])


def number(node: ast.expr) -> float | None:
    """Return a literal number, zero excluded."""
    value = node.value if isinstance(node, ast.Constant) else None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and value else None


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
    heads = [f"{each['cases']} recordings, seed {each['seed']}" for each in (board["settings"] for board in boards)]
    rows = [(label, *(f"{board['all'][key]['hits']} of {board['all'][key]['cases']}" for board in boards))
            for key, label in SCORES.items()]
    rows.append(("expected calibration error", *(f"{board['all']['calibration_error']['value']:.3g}"
                                                 for board in boards)))
    rows.append(("seconds a case, median (longest)",
                 *(f"{board['all']['seconds']['value']:.0f} ({board['all']['seconds']['longest']:.0f})"
                   for board in boards)))
    rows = [(label, *(score.replace(" ", "\N{NO-BREAK SPACE}") for score in scores)) for label, *scores in rows]
    links = "; ".join(f'<a href="trials/{name}.html">{head}</a>' for name, head in zip(shown, heads, strict=True))
    return (TRIALS_HEAD + "\n\n" + table(("", *heads), rows)
            + f"\nEvery case as it came out:\n\n```{{raw}} html\n<p>{links}</p>\n```\n")


TRIALS_HEAD = """# Trials on concealed recordings

`fretflow trial` makes recordings with a second simulator that shares no code with fretflow, seals the answers,
diagnoses each recording in a process of its own and only then opens them. A fifth of the recordings hides nothing, a
fifth holds physics beyond the catalogue, a fifth two effects, the rest one, of any size: what stands little above the
noise is not seen by anybody. The trials stand in the order in which they were made, each with seeds that nobody had
seen; scores of all sizes are here, those of strong effects alone in the pages below. They stay as they came out, all
with earlier verdicts; [diagnosis](../diagnosis.md#the-verdict) tells what became of later recordings."""


STYLE = re.compile(r"(?s)<style>.*?</style>")


def dressed(page: str) -> str:
    """Return a trial's page as it came out, in the look of today's, which small screens show too."""
    template = (ROOT / "trial" / "fretflow_trial" / "page.html.j2").read_text(encoding="utf-8")
    style = STYLE.search(template)[0]
    return STYLE.sub(lambda _: style, page, count=1)


def copy_trials(app: Sphinx, error: Exception | None) -> None:
    """Put the trials' own pages into the site."""
    if error is None and app.builder.format == "html":
        for name in TRIALS:
            page = ROOT / "benchmarks" / name / "trial.html"
            if page.is_file():
                target = Path(app.outdir) / "_made" / "trials" / f"{name}.html"
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(dressed(page.read_text(encoding="utf-8")), encoding="utf-8")
