"""Two recordings of a joint that a measured motion drives: one the model explains, one it does not.

They are made here, a slider of 50 N behind 28 N/um with 2 % of noise, the second with a play of 2 um before it.
"""

import json
import tempfile
from pathlib import Path

import fretflow as ff
import numpy as np

SLIDER, SPRING, PLAY = 50.0, 28e6, 2e-6  # N, N/m, m
RECORDING = """
format = "fretflow-recording/1"
[test]
kind = "imposed-displacement"
excitation_frequency = "100 Hz"
[series]
file = "series.csv"
time = { column = "time_s", unit = "s" }
displacement = { column = "x_um", unit = "um" }
force = { column = "force_N", unit = "N" }
"""


def make_recording(folder: Path, play: float) -> Path:
    """Write a recording with a `play` in m before the slider, and return its folder."""
    folder.mkdir()
    time = np.arange(1320) / 20_000.0
    x = -7e-6 * np.cos(2.0 * np.pi * 100.0 * time)
    reach = 0.5 * play + SLIDER / SPRING
    stretch, force = -reach, []  # of play and spring together
    for step in np.diff(x, prepend=x[0]):
        stretch = min(max(stretch + step, -reach), reach)
        force.append(SPRING * (stretch - min(max(stretch, -0.5 * play), 0.5 * play)))
    noise = np.random.default_rng(2).standard_normal((2, len(time)))
    columns = [time, 1e6 * x + 7e-3 * noise[0], np.array(force) + 0.02 * SLIDER * noise[1]]
    np.savetxt(folder / "series.csv", np.column_stack(columns), delimiter=",", header="time_s,x_um,force_N",
               comments="")
    (folder / "recording.toml").write_text(RECORDING, encoding="utf-8")
    return folder


def main(folder: Path) -> None:
    """Diagnose both recordings, with the second one's report, JSON and figure in `folder`."""
    plain = ff.diagnose(ff.read_recording(make_recording(folder / "plain", 0.0)))
    assert plain.verdict.value == "none"

    diagnosis = ff.diagnose(ff.read_recording(make_recording(folder / "loose", PLAY)))
    assert diagnosis.verdict.value == "named"
    assert diagnosis.effects == ("backlash",)
    assert diagnosis.probability > 0.5  # more than all other explanations together, those beyond the catalogue too
    play = next(one for one in diagnosis.parameters if one.name.startswith("backlash."))
    assert abs(play.value / PLAY - 1.0) < 0.05
    assert play.unit == "m"

    diagnosis.to_html(folder / "report.html")
    diagnosis.to_json(folder / "diagnosis.json")
    diagnosis.plot().savefig(folder / "loops.png")
    assert json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))["effects"] == ["backlash"]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        main(Path(made))
