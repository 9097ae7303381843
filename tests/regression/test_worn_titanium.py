"""Worn profiles of Ti-6Al-4V, cylinder on flat, at two frequencies (Arnaud et al. 2021; measured by Fouvry 2017).

What carries the weight: one wear coefficient fails, and what is named with debris is what the authors name: oxygen does
not reach the middle. Their own model has 0.242 and 0.156 mm2 of the 0.351 and 0.172 mm2 that were measured.
"""

import numpy as np
import pytest
from fretflow.experiments.structure.run import diagnose_structure
from fretflow.inference.verdict import Verdict
from fretflow.recordings.kinds.structures import read_structure_recording
from scipy.integrate import trapezoid

pytestmark = pytest.mark.real_data

HEAD = """format = "fretflow-recording/1"
[test]
kind = "structure"
[structure]
friction_coefficient = 0.8
[structure.line_contact]
radius = "80 mm"
load = "1066 N/mm"
elastic_modulus = "114 GPa"
poisson_ratio = 0.34
"""
PROFILE = """[[profile]]
file = "{file}"
cycles = 5000
frequency = "{frequency} Hz"
displacement_amplitude = "75 um"
x = {{ column = "x_mm", unit = "mm" }}
depth = {{ column = "z_mm", unit = "mm", sd = "4 um" }}
"""


def test_one_coefficient_fails_and_oxygen_that_does_not_reach_is_named(recordings, tmp_path):
    folder = recordings / "arnaud_profiles"
    (tmp_path / "recording.toml").write_text(HEAD + "".join(
        PROFILE.format(file=folder / f"profile_{name}Hz.csv", frequency=frequency)
        for name, frequency in (("0p1", 0.1), ("2", 2))))
    diagnosis = diagnose_structure(read_structure_recording(tmp_path), True, lambda share, text: None)
    assert diagnosis.detection.p_value < 1e-6
    assert diagnosis.verdict is Verdict.NAMED
    assert diagnosis.effects == ("oxygen-limited-wear", "third-body")
    slow, fast = diagnosis.curves
    for one, measured in ((slow, 0.351), (fast, 0.172)):
        assert 1e6 * trapezoid(one.measured, one.x) == pytest.approx(measured, abs=0.001)
        assert 1e6 * trapezoid(one.after, one.x) == pytest.approx(measured, rel=0.1)
    middle = np.argmin(np.abs(slow.x))
    assert slow.after[middle] == slow.after.max()  # U
    assert fast.after[middle] < 0.95 * fast.after.max()  # W
