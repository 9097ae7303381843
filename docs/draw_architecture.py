"""Draws architecture.svg: the protocols and how they follow each other, and the floors of the house below.

The floors are those of the import contract in pyproject.toml, so that the picture cannot part from it.
"""

import tomllib
from html import escape
from pathlib import Path

DOCS = Path(__file__).parent
WIDTH, FLOOR, TOP = 1180, 44, 356
INK, LINE, PAPER = "#1b2733", "#7a8896", "#ffffff"
CENTRE, CLIENT, ROOM = "#dcebf7", "#fdebd3", "#f2f4f6"

WORDS = {
    "cli": "one file a command; computes nothing", "fretflow_post": "pictures, report", "fretflow_meshes": "gmsh",
    "pipeline": "stages, runs, processes: run(), diagnose()", "experiments": "rig, driven joint, wear series, bolted",
    "inference": "parameters, least squares, evidence, search, verdict", "effects": "one file each",
    "recordings": "kinds, readers, cleaning", "wear": "Archard, cycle jumps",
    "solvers": "periodic, continuation, modes", "structure": "matrices, elements, reduction, rig",
    "contact": "interface, law, kernels", "case": "TOML",
    "core": "units, records, store, errors, plugins",
}
# Name, a line below it, left edge, upper edge, width, fill.
BOXES = (
    ("Structure", "M, C, K; inputs, outputs", 20, 30, 190, CENTRE),
    ("Interface", "nodes, areas, gap", 20, 102, 190, CENTRE),
    ("ContactLaw", "limit, slope, mapping", 20, 174, 190, CENTRE),
    ("loads", "Harmonic, NormalLoad", 20, 246, 190, CENTRE),
    ("Effect", "changes any of these", 280, 30, 210, CLIENT),
    ("PeriodicProblem", "all that a period depends on", 280, 138, 210, CENTRE),
    ("PeriodicSolver", "quasi-static, DLFT", 560, 66, 190, CENTRE),
    ("continuation, wear", "curves, millions of cycles", 560, 138, 190, CENTRE),
    ("PeriodicSolution", "loops, states, forces", 820, 102, 190, CENTRE),
    ("Recording", "loops, series, sweeps", 280, 246, 210, CLIENT),
    ("Experiment", "measured, predicted", 560, 246, 190, CLIENT),
    ("inference", "fit, compare, judge", 820, 246, 150, CLIENT),
    ("Diagnosis", "verdict, report", 1010, 246, 150, CLIENT),
)
ARROWS = (((210, 55), (280, 150)), ((210, 127), (280, 159)), ((210, 199), (280, 171)), ((210, 271), (280, 180)),
          ((490, 155), (560, 95)), ((490, 163), (560, 163)), ((385, 80), (385, 138)), ((750, 91), (820, 120)),
          ((750, 163), (820, 136)), ((490, 271), (560, 271)), ((655, 188), (655, 246)), ((750, 271), (820, 271)),
          ((970, 271), (1010, 271)))


def box(name: str, words: str, x: float, y: float, width: float, fill: str, height: float = 50) -> str:
    """Return a box with its name and a line of words."""
    middle = x + width / 2
    return (f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="5" fill="{fill}" stroke="{LINE}"/>'
            f'<text x="{middle}" y="{y + height / 2 - 4}" class="name">{escape(name)}</text>'
            f'<text x="{middle}" y="{y + height / 2 + 13}" class="words">{escape(words)}</text>')


def floors() -> list[list[str]]:
    """Return the rooms of each floor of the import contract, the highest first."""
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))
    layers = next(one["layers"] for one in project["tool"]["importlinter"]["contracts"] if one["type"] == "layers")
    return [[room.strip(" ()").removeprefix("fretflow.") for room in layer.split("|")] for layer in layers]


def draw() -> str:
    """Return the picture."""
    house = floors()
    height = TOP + FLOOR * len(house) + 16
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">',
             f'<style>text{{fill:{INK};text-anchor:middle}}.name{{font-size:15px;font-weight:bold}}'
             '.words{font-size:12px}.side{font-size:13px;text-anchor:start}</style>'
             '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="9" markerHeight="9" orient="auto">'
             f'<path d="M0 0L8 4L0 8z" fill="{LINE}"/></marker>',
             f'<rect width="{WIDTH}" height="{height}" fill="{PAPER}"/>']
    parts += [f'<path d="M{x1} {y1}L{x2} {y2}" stroke="{LINE}" stroke-width="1.6" marker-end="url(#tip)"/>'
              for (x1, y1), (x2, y2) in ARROWS]
    parts += [box(*one) for one in BOXES]
    parts.append(f'<text x="20" y="{TOP - 14}" class="side">The house: each floor imports from those below it '
                 'alone.</text>')
    for level, rooms in enumerate(house):
        width = (WIDTH - 40 - 8 * (len(rooms) - 1)) / len(rooms)
        for k, room in enumerate(rooms):
            parts.append(box(room, WORDS[room], 20 + k * (width + 8), TOP + level * FLOOR, width, ROOM, FLOOR - 6))
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    (DOCS / "architecture.svg").write_text(draw(), encoding="utf-8")
