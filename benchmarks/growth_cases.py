"""The problems of `growth.py` and `peers.py`: test 1 with another number of contact nodes, reduced once and kept."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

from fretflow.case.config import PeriodicMethod, load_case
from fretflow.pipeline.problem import make_problem
from fretflow.solvers.periodic import PeriodicProblem

ROOT = Path(__file__).parents[1]
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fretflow"


def elements(nodes: int) -> int:
    """Return the elements on one side of a contact with `nodes` nodes in all.

    Raises
    ------
    ValueError
        If `nodes` is not a square, or under 9.
    """
    side = math.isqrt(nodes)
    if side * side != nodes or side < 3:
        raise ValueError(f"{nodes} contact nodes: give a square of 3 or more, such as 36, 121, 441, 1681")
    return side - 1


def case_file(nodes: int) -> Path:
    """Return the case file of test 1 with `nodes` contact nodes."""
    count = elements(nodes)
    text = (ROOT / "examples" / "test1.toml").read_text()
    text = text.replace("contact_elements = 10 ", f"contact_elements = {count} ").replace('"test1"', f'"nodes{nodes}"')
    path = CACHE / f"nodes{nodes}.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def reduced_folder(nodes: int, limit: float | None = None) -> Path:
    """Return the folder with both reduced specimens; made at the first call, in `limit` seconds or less, then kept."""
    return _stage(nodes, "reduce", limit)


def meshed_folder(nodes: int) -> Path:
    """Return the folder with both meshes; made at the first call, then kept."""
    return _stage(nodes, "mesh", None)


def _stage(nodes: int, stage: str, limit: float | None) -> Path:
    path = case_file(nodes)
    command = [sys.executable, "-c", "from fretflow.cli import main; main()", "run", path, "--until", stage]
    subprocess.run([*command, "--out", CACHE / "runs"], check=True, capture_output=True, timeout=limit)
    folders = (CACHE / "runs" / path.stem).glob(f"{stage}-*")
    return max(folders, key=lambda folder: folder.stat().st_mtime)


def problem(nodes: int, force: float, method: PeriodicMethod) -> PeriodicProblem:
    """Return test 1 at `force` (N) with `nodes` contact nodes."""
    case = load_case(case_file(nodes))
    test = case.test.model_copy(update={"excitation_amplitude": force})
    solver = case.solver.model_copy(update={"method": method})
    return make_problem(case.model_copy(update={"test": test, "solver": solver}), reduced_folder(nodes))


def dlft_problem(nodes: int, force: float) -> PeriodicProblem:
    """Return it for DLFT."""
    return problem(nodes, force, PeriodicMethod.DLFT)
