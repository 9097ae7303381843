"""An effect of one's own, found in a recording: the file in own_effects/ is all that it takes.

Shown: 1. the effect joins the catalogue; 2. a joint that has it is predicted; 3. a diagnosis of its recording names it.
"""

import tempfile
from pathlib import Path

import fretflow as ff
import numpy as np

HERE = Path(__file__).parent
SLIDER, SPRING = 50.0, 28e6  # N, N/m
STROKE, HERTZ, RATE = 7e-6, 100.0, 20_000.0  # m, Hz, samples a second


def recorded(height: float, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, displacement and force of a slider with a bump, marched sample by sample, with 2 % of noise."""
    time = np.arange(round(6.6 / HERTZ * RATE)) / RATE
    x, spring, force = -STROKE * np.cos(2.0 * np.pi * HERTZ * time), -SLIDER / SPRING, []
    for place, step in zip(x, np.diff(x, prepend=x[0]), strict=True):
        limit = SLIDER * (1.0 + height * np.exp(-((place / width) ** 2))) / SPRING
        spring = min(max(spring + step, -limit), limit)
        force.append(SPRING * spring)
    noise = np.random.default_rng(5).standard_normal((2, len(x)))
    return time, x + 7e-9 * noise[0], np.array(force) + 1.0 * noise[1]


def main() -> None:
    """Diagnose a recording with the effect in it."""
    ff.add_effects(HERE / "own_effects")  # or name the folder in the variable FRETFLOW_EFFECTS
    assert ff.catalogue()["friction-bump"].title == "friction that is larger in the middle of the stroke"

    with tempfile.TemporaryDirectory() as folder:
        columns = np.column_stack(recorded(height=0.3, width=1.5e-6)) * [1.0, 1e6, 1.0]
        np.savetxt(Path(folder, "series.csv"), columns, delimiter=",", header="time_s,x_um,force_N", comments="")
        Path(folder, "recording.toml").write_text("""
            format = "fretflow-recording/1"
            [test]
            kind = "imposed-displacement"
            excitation_frequency = "100 Hz"
            [series]
            file = "series.csv"
            time = { column = "time_s", unit = "s" }
            displacement = { column = "x_um", unit = "um" }
            force = { column = "force_N", unit = "N" }
            """, encoding="utf-8")
        diagnosis = ff.diagnose(ff.read_recording(folder))

    assert diagnosis.verdict.value == "named"
    assert diagnosis.effects == ("friction-bump",)
    height = next(one for one in diagnosis.parameters if one.name == "friction-bump.height")
    assert abs(height.value - 0.3) < 0.03
    assert height.low < 0.3 < height.high  # 90 % interval


if __name__ == "__main__":
    main()
