"""Diagnoses of measured series of wear tests.

What carries the weight: what their authors published. Steel against steel: one energy coefficient leaves a third of the
variance, powers of pressure, amplitude and frequency a fifteenth (Baydoun et al. 2019). Ti-6Al-4V: one coefficient
explains less than half, the power density brings it above nine tenths (Fouvry et al. 2017).
"""

from functools import cache
from pathlib import Path

import pytest
from fretflow.experiments.wear_series.run import diagnose_wear_series
from fretflow.inference.verdict import Diagnosis, Verdict
from fretflow.recordings.kinds.wear_series import read_wear_series

pytestmark = pytest.mark.real_data
STEEL, TITANIUM = "baydoun2019_flat_on_flat_steel", "fouvry2017ti_appendixA_test_matrix"


@cache
def diagnosed(path: Path) -> Diagnosis:
    return diagnose_wear_series(read_wear_series(path), False, lambda share, text: None)


def series(recordings, name):
    return diagnosed(recordings / "wear_series" / f"{name}.csv")


def parameters(diagnosis):
    return {one.name: one for one in diagnosis.parameters}


def test_steel_wears_by_powers_of_pressure_amplitude_and_frequency(recordings):
    diagnosis = series(recordings, STEEL)
    assert diagnosis.verdict is Verdict.NAMED
    assert diagnosis.effects == ("wear-power-law",)
    assert diagnosis.wear_tests.r2_before == pytest.approx(0.69, abs=0.03)
    assert diagnosis.wear_tests.r2_after == pytest.approx(0.93, abs=0.02)
    exponents = parameters(diagnosis)
    assert exponents["wear-power-law.pressure_exponent"].low > 0.0
    assert exponents["wear-power-law.sliding_exponent"].low > 0.0
    assert exponents["wear-power-law.frequency_exponent"].high < 0.0
    assert diagnosis.detection.p_value < 0.05
    assert diagnosis.held_out.after < 0.6 * diagnosis.held_out.before


def test_what_steel_does_not_tell_is_said(recordings):
    """One pressure was never put under a joule meter, and the power of the pressure hangs on the smallest volumes."""
    diagnosis = series(recordings, STEEL)
    said = " ".join((*diagnosis.warnings, *diagnosis.notes))
    assert "energy, row 9: is taken in proportion" in said
    assert "energy, rows 10-28: is taken as volume over coefficient" in said
    assert "if scatter grew in proportion to the volume" in said
    assert "pressure_exponent = 0.62 lies beyond the plausible -0.5 to 0.5" in said


def test_titanium_wears_by_the_power_density(recordings):
    diagnosis = series(recordings, TITANIUM)
    assert diagnosis.verdict is Verdict.NAMED
    assert diagnosis.effects == ("wear-power-law",)
    assert diagnosis.wear_tests.r2_before == pytest.approx(0.45, abs=0.01)
    assert diagnosis.wear_tests.r2_after == pytest.approx(0.92, abs=0.01)
    exponent = parameters(diagnosis)["wear-power-law.power_density_exponent"]
    assert -0.30 < exponent.low < exponent.value < exponent.high < -0.19
    assert diagnosis.detection.p_value < 1e-6
    assert diagnosis.held_out.after < 0.5 * diagnosis.held_out.before
    assert "frequency" in diagnosis.separating_measurement


def test_titanium_rows_that_stand_twice_are_named(recordings):
    """P_1 and R_4 are one test, as f_8 is; Rp_5, f_6 and RP_f_5 are one, with two values of the power density."""
    diagnosis = series(recordings, TITANIUM)
    said = " ".join(diagnosis.warnings)
    assert "rows 4-5, 10-14, 20, 22-27 repeat the volume" in said
    assert "tests that stand twice with different power density" in said
    assert "worn volume, row 18: has no number" in said
    assert diagnosis.ranking[0].degrees_of_freedom == 39 - 2
    assert "38 conditions" in diagnosis.held_out.what
