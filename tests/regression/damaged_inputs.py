"""Damage files that are good, at random places in many ways, and count how commands take them.

    .venv/bin/python tests/regression/damaged_inputs.py [inputs] [seed]

Each input is given to a process of its own. It may be taken, as a changed digit is, or refused: one line, exit code 2.
What else comes of it, an error that nobody thought of, a signal, more than a minute, is printed, and the file kept.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from shutil import copytree, rmtree

import h5py
import numpy as np
from fretflow import cli
from fretflow.case.config import Mesh, Specimen
from fretflow_meshes.specimen import Side, build_specimen
from scipy.io import savemat

LONGEST = 60  # s
EXAMPLES = Path(__file__).parents[2] / "examples"
NUMBERS = [b"nan", b"inf", b"-1", b"0", b"1e400", b"1e-300", b"true", b"", b"9" * 400, b"0x1F", "٣".encode()]
NUMBER = re.compile(rb"-?\d[\d._]*(?:e[+-]?\d+)?")
RIG = (EXAMPLES / "quick.toml").read_text(encoding="utf-8")


def good_files(home: Path) -> Iterator[tuple[str, Path, list[str]]]:
    """Make folders of good files; yield name, file to damage and the command that reads it."""
    home.mkdir()
    t = np.arange(1200) / 400.0
    turn = 2 * np.pi * t
    columns = {"time": t, "displacement": 1e-5 * np.sin(turn), "force": 30 * np.tanh(20 * np.cos(turn))}
    np.savetxt(home / "loops.csv", np.column_stack(list(columns.values())), delimiter=",", comments="",
               header="time_s,displacement_m,force_N")
    savemat(home / "loops.mat", columns)
    with h5py.File(home / "loops.h5", "w") as file:
        for (name, values), unit in zip(columns.items(), ("s", "m", "N"), strict=True):
            file[name] = values
            file[name].attrs["unit"] = unit
    (home / "recording.toml").write_text(
        'format = "fretflow-recording/1"\n[test]\nkind = "imposed-displacement"\nnormal_load = "60 N"\n[series]\n'
        'file = "loops.csv"\ntime = { column = "time_s", unit = "s" }\ndisplacement = { column = "displacement_m", '
        'unit = "m" }\nforce = { column = "force_N", unit = "N" }\n', encoding="utf-8")
    (home / "case.toml").write_text(RIG, encoding="utf-8")
    yield "case", home / "case.toml", ["show", "case.toml"]
    yield "recording.toml", home / "recording.toml", ["loops", "recording.toml"]
    units = ["--displacement", "displacement [m]", "--force", "force [N]"]
    for kind, told in (("csv", []), ("h5", []), ("mat", units)):
        yield f"loops.{kind}", home / f"loops.{kind}", ["loops", f"loops.{kind}", *told]
    yield "loops.csv", home / "loops.csv", ["init", "new.toml", "--recording", "loops.csv"]
    for side in Side:
        build_specimen(Specimen(), Mesh(contact_elements=2), side, home / f"{side}.msh")
    (home / "mesh.toml").write_text(RIG.replace("[mesh]", '[mesh]\nupper = "upper.msh"\nlower = "lower.msh"'), "utf-8")
    yield "mesh", home / "upper.msh", ["run", "mesh.toml", "--until", "mesh"]


def damaged(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Return a way to damage a file's `content`, and what is left of it."""
    at, span = int(rng.integers(len(content))), int(rng.integers(1, 100))
    ways: dict[str, Callable[[], bytes]] = {
        "cut off": lambda: content[:at],
        "a bit turned": lambda: content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1:],
        "noise": lambda: content[:at] + rng.bytes(span) + content[at + span:],
        "zeros": lambda: content[:at] + bytes(span) + content[at + span:],
        "a gap": lambda: content[:at] + content[at + span:],
        "a part twice": lambda: content[:at + span] + content[at:],
        "a line gone": lambda: _without_line(content, at),
        "another number": lambda: _other_number(content, rng)}
    name = list(ways)[int(rng.integers(len(ways)))]
    return name, ways[name]()


def _without_line(content: bytes, at: int) -> bytes:
    return content[:content.rfind(b"\n", 0, at) + 1] + content[at:].partition(b"\n")[2]


def _other_number(content: bytes, rng: np.random.Generator) -> bytes:
    places = list(NUMBER.finditer(content))
    one = places[int(rng.integers(len(places)))]
    return content[:one.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + content[one.end():]


def outcome(folder: Path, command: list[str]) -> str:
    """Return what comes of a command in `folder`: "taken", "refused", or what should not be."""
    child = os.fork()
    if not child:
        os.chdir(folder)
        for number, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        signal.alarm(LONGEST)  # which ends it
        os._exit(cli.execute(command))
    _, status = os.waitpid(child, 0)
    error = (folder / "err").read_text(encoding="utf-8", errors="replace")
    if os.WIFSIGNALED(status):
        return f"ended by {signal.Signals(os.WTERMSIG(status)).name}"
    if os.WEXITSTATUS(status) == 0:
        return "taken"
    one_line = error.startswith("fretflow: ") and error.count("\n") == 1 and "unexpected" not in error
    return "refused" if one_line and os.WEXITSTATUS(status) == 2 else f"{os.WEXITSTATUS(status)}: {error[:300]}"


def damage(home: Path, inputs: int, seed: int) -> Counter[tuple[str, str]]:
    """Damage each kind of file in turn, `inputs` in all, and count (kind, outcome); what should not be stays there."""
    rng, counts = np.random.default_rng(seed), Counter[tuple[str, str]]()
    kinds = list(good_files(home / "good"))
    for kind, _, command in kinds:
        copytree(home / "good", home / "tried")
        if outcome(home / "tried", command) != "taken":
            raise SystemExit(f"{kind}: the good file is refused: {(home / 'tried' / 'err').read_text('utf-8')}")
        rmtree(home / "tried")
    for k in range(inputs):
        kind, path, command = kinds[k % len(kinds)]
        folder = home / f"{k:05d}"
        copytree(home / "good", folder)
        way, content = damaged(path.read_bytes(), rng)
        (folder / path.name).write_bytes(content)
        result = outcome(folder, command)
        counts[kind, result] += 1
        if result in ("taken", "refused"):
            rmtree(folder)
        else:
            sys.stderr.write(f"{folder}: {path.name}, {way}: fretflow {' '.join(command)}: {result}\n")
    return counts


if __name__ == "__main__":
    inputs, seed = (int(text) for text in (sys.argv[1:] + ["400", "0"][len(sys.argv) - 1:]))
    for (kind, result), count in sorted(damage(Path(tempfile.mkdtemp(prefix="damaged-")), inputs, seed).items()):
        sys.stdout.write(f"{kind:15} {count:5} {result}\n")
