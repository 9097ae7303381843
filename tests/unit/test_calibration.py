"""What measurements say of the rig and of the wear coefficient.

What carries the weight: Gaussian problems with a closed-form posterior, a wear law with a closed-form volume, and a
hidden rig that is found again from the sliding that it makes.
"""

import dataclasses
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from fretflow import cli
from fretflow.case.casefile import dump_case
from fretflow.case.config import load_case, validate_case
from fretflow.cli.calibrate import _show_rig
from fretflow.core.errors import InputError, NonConvergenceError
from fretflow.effects.cycle import PeriodicCycle
from fretflow.pipeline import calibrate, run_records
from fretflow.pipeline.calibrate import (
    PRIOR_FACTORS,
    CalibratedRig,
    CalibrationTest,
    calibrate_wear,
    calibrated_case,
    rig_modes,
)
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver, sliding_distance
from fretflow.structure.two_mass_rig.identification import Data, LogNormalPrior, identify, identify_mapped
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from fretflow.wear.history import WearHistory, WearSettings
from fretflow.wear.identification import identify_wear_coefficient, settled_face
from fretflow.wear.march import run_history

REGRESSION = Path(__file__).parents[1] / "regression"
AREA, DEEP, FIRST = 2e-6, 3e-6, 8e2  # m^2, m, N/m: a law q = FIRST exp(-w / DEEP)


@pytest.fixture
def nine_nodes(monkeypatch):
    """Return the reference joint at nine of its nodes, and a coarse solver for it."""
    monkeypatch.syspath_prepend(REGRESSION)
    import kill_run

    yield kill_run.problem(), QuasiStaticSolver(kill_run.SOLVER)
    sys.modules.pop("kill_run")


def closed_form_history(coefficient, cycles, jumps=40):
    """Return the history of ``dw/dn = K q(w)``: ``w = DEEP ln(1 + FIRST K n / DEEP)``."""
    n = np.linspace(0, cycles, jumps + 1).astype(np.int64)
    depth = DEEP * np.log1p(FIRST * coefficient * n / DEEP)
    return WearHistory(cycles=n, depth=depth[:, None], rate=coefficient * FIRST * np.exp(-depth / DEEP)[:, None],
                       volume=depth * AREA, dissipated_energy=np.ones(len(n)), sliding_distance=np.ones(len(n)),
                       energy=1.0 * n, approach=depth, upper_share=0.5, solves=1, stopped_by="cycles")


def test_the_coefficient_and_its_deviation_are_those_of_the_closed_form():
    volume, sd, cycles = 6e-12, 2e-13, 300_000
    history = closed_form_history(1e-14, 10**6)
    identified = identify_wear_coefficient(history, np.array([AREA]), 1e-14, cycles, volume, sd)
    exact = DEEP * np.expm1(volume / AREA / DEEP) / (FIRST * cycles)
    assert identified.value == pytest.approx(exact, rel=1e-5, abs=0.0)
    exact_sd = sd * np.exp(volume / AREA / DEEP) / (AREA * FIRST * cycles)
    assert identified.sd == pytest.approx(exact_sd, rel=1e-4, abs=0.0)
    assert identified.unworn == pytest.approx(volume / (AREA * FIRST * cycles), rel=1e-12, abs=0.0)
    assert identified.interval[1] - identified.interval[0] == pytest.approx(2 * 1.96 * identified.sd, rel=1e-4, abs=0.0)
    assert abs(identified.proportional / exact - 1.0) > 0.1  # which a proportional reading would miss


def test_a_history_that_is_too_short_is_said_to_be_and_one_that_ended_refuses():
    history = closed_form_history(1e-14, 1000)
    areas, volume = np.array([AREA]), 1.01 * history.volume[-1]
    assert identify_wear_coefficient(history, areas, 1e-14, 1000, volume, volume) is None
    ended = dataclasses.replace(history, stopped_by="vanishing rate")
    with pytest.raises(InputError, match="whatever the coefficient"):
        identify_wear_coefficient(ended, areas, 1e-14, 1000, volume, volume)
    with pytest.raises(InputError, match="nothing wears"):
        identify_wear_coefficient(dataclasses.replace(history, rate=0.0 * history.rate), areas, 1e-14, 1, 1.0, 1.0)


def test_a_longer_history_is_asked_for_until_the_volume_is_reached(monkeypatch):
    asked = []

    def read(path, cls):
        return (closed_form_history(case.wear.coefficient, asked[-1]) if cls is WearHistory
                else SimpleNamespace(contact_areas=np.array([AREA])))

    monkeypatch.setattr(run_records, "read_record", read)
    case = a_case(cycles=10_000, worn_volume="6 mm^3")
    case = case.model_copy(update={"measured": case.measured.model_copy(update={"worn_volume": 6e-12})})

    def run(one):
        asked.append(one.test.total_cycles)
        return {"wear": Path(), "reduce": Path()}

    identified = calibrate_wear(case, run)
    needed = DEEP * np.expm1(6e-12 / AREA / DEEP) / (FIRST * case.wear.coefficient)
    assert asked[0] == 10_000
    assert len(asked) < 5
    assert asked[-2] < needed <= asked[-1]
    assert identified.value == pytest.approx(DEEP * np.expm1(6e-12 / AREA / DEEP) / (FIRST * 10_000), rel=1e-4, abs=0.0)


def test_the_worn_volume_depends_on_coefficient_times_cycles_alone(nine_nodes):
    problem, solver = nine_nodes
    model = PeriodicCycle(solver, problem)

    def march(coefficient, cycles):
        return run_history(model, WearSettings(coefficient=coefficient, cycles=cycles, max_depth_per_jump=2e-8))

    one, other = march(1e-14, 6000), march(2.5e-14, 2000)
    identified = identify_wear_coefficient(one, model.areas, 1e-14, 2000, float(other.volume[-1]), 1e-15)
    assert identified.value == pytest.approx(2.5e-14, rel=1e-3, abs=0.0)


def test_the_settled_face_carries_the_load_evenly(nine_nodes):
    problem, _ = nine_nodes
    flexibility, areas = problem.structure.quasi_static().flexibility[2::3, 2::3], problem.interface.areas
    gap = 1e-6 * np.linspace(0.0, 1.0, len(areas))
    depth = settled_face(flexibility, areas, gap, 60.0)
    assert depth.min() == 0.0
    bordered = np.block([[flexibility, np.ones((len(areas), 1))], [np.ones((1, len(areas))), np.zeros((1, 1))]])
    force = np.linalg.solve(bordered, np.r_[-(gap + depth), 60.0])[:-1]
    np.testing.assert_allclose(force / areas, 60.0 / areas.sum(), rtol=1e-9)


def power_laws(exponents):
    return lambda p: np.exp(exponents @ np.log(p))


def test_power_laws_have_the_closed_form_posterior():
    exponents = np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.1]])
    prior = LogNormalPrior(names=("a", "b", "c"), value=np.array([2.0, 5.0, 0.1]), factor=np.array([3.0, 1.5, 10.0]))
    data = Data(names=("x", "y"), value=np.array([6.0, 20.0]), relative_sd=np.array([0.05, 0.02]))
    identified = identify(power_laws(exponents), prior, data)
    weights = np.diag(data.relative_sd**-2.0)
    covariance = np.linalg.inv(np.diag(np.log(prior.factor)**-2.0) + exponents.T @ weights @ exponents)
    mean = np.log(prior.value) + covariance @ exponents.T @ weights @ (
        np.log(data.value) - exponents @ np.log(prior.value))
    np.testing.assert_allclose(np.log(identified.value), mean, atol=1e-5)
    np.testing.assert_allclose(identified.covariance, covariance, rtol=1e-5, atol=1e-9)
    assert not identified.determined[2]
    assert identified.shrinkage[2] > 0.95


def test_of_two_factors_only_the_product_is_determined():
    prior = LogNormalPrior(names=("mass", "gain"), value=np.ones(2), factor=np.full(2, np.e))
    data = Data(names=("product",), value=np.array([1.5]), relative_sd=np.array([0.01]))
    identified = identify(power_laws(np.ones((1, 2))), prior, data)
    assert not identified.determined.any()
    assert identified.product(0) == "mass * gain"
    assert identified.direction_sd[0] == pytest.approx(0.01, rel=1e-3)
    np.testing.assert_allclose(identified.shrinkage, np.sqrt(0.5), rtol=1e-3)
    assert identified.predicted[0] == pytest.approx(1.5, rel=1e-3)


def test_what_a_product_is_known_to_is_an_interval_as_that_of_a_parameter(capsys):
    """Half a width in per cent is no interval where a parameter is known to a factor: "±230 %" was printed."""
    names = tuple(calibrate.UNITS)
    prior = LogNormalPrior(names=names, value=np.ones(5), factor=np.full(5, 10.0))
    data = Data(names=("distance",), value=np.array([1.0]), relative_sd=np.array([5.0]))
    identified = identify(power_laws(np.eye(1, 5)), prior, data)
    product, own = (np.array(ends) for ends in (identified.product_interval, identified.interval))
    np.testing.assert_allclose(product[:, 0], own[:, 0] / identified.value[0], rtol=1e-9)
    _show_rig(identified)
    assert f"{product[0, 0]:.3g} to {product[1, 0]:.3g}" in capsys.readouterr().out


def test_a_rough_model_leads_to_the_parameters_of_the_exact_one():
    prior = LogNormalPrior(names=("a",), value=np.array([1.0]), factor=np.array([4.0]))
    data = Data(names=("x",), value=np.array([3.0]), relative_sd=np.array([0.001]))
    calls = []

    def exact(p):
        calls.append(p)
        return 0.7 * p**1.4

    identified = identify_mapped(exact, lambda p: p, prior, data)
    assert identified.value[0] == pytest.approx((3.0 / 0.7) ** (1 / 1.4), rel=1e-3)
    assert identified.predicted[0] == pytest.approx(3.0, rel=1e-3)
    assert 2 < len(calls) < 15
    fickle = iter([0.8, 1.2] * 20)
    with pytest.raises(NonConvergenceError, match="still miss") as caught:
        identify_mapped(lambda p: next(fickle) * p, lambda p: p, prior, data)
    assert len(caught.value.history) == 20


def test_a_hidden_rig_is_found_again_as_far_as_it_shows(nine_nodes):
    problem, solver = nine_nodes
    hidden = np.array([14.0, 0.5, 40.0, 2500.0, 0.01])
    conditions = [CalibrationTest(f"{force:g} N", problem.vary(amplitude=force), 1.0, 0.01)
                  for force in (60.0, 75.0)]

    def seen(condition):
        joint = dataclasses.replace(problem.structure, rig=LumpedRig.from_modes(*hidden))
        period = solver.solve(dataclasses.replace(condition.problem, structure=joint))
        return sliding_distance(period, problem.interface)

    modes = tuple(PRIOR_FACTORS)[2:4]
    model = CalibratedRig(conditions, modes, solver, 0.0)
    data = Data(names=(*modes, "60 N", "75 N"), relative_sd=np.full(4, 0.01),
                value=np.array([*rig_modes(LumpedRig.from_modes(*hidden)), *(seen(c) for c in conditions)]))
    prior = LogNormalPrior(names=tuple(PRIOR_FACTORS), value=np.array([10.0, 0.5, 40.0, 2500.0, 0.01]),
                  factor=np.array(list(PRIOR_FACTORS.values())))
    identified = identify_mapped(model.predict, model.estimate, prior, data)
    assert identified.value[0] == pytest.approx(14.0, rel=0.02)
    np.testing.assert_allclose(identified.predicted, data.value, rtol=0.01)
    known = dict(zip(prior.names, identified.determined, strict=True))
    assert known["moving_mass"]
    assert not known["damping_ratio"]
    low, high = identified.interval
    assert low[0] < 14.0 < high[0]


def a_case(cycles=1000, name="small", **measured):
    return validate_case({"format": "fretflow-case/1", "name": name, "measured": measured,
                          "test": {"excitation_amplitude": "53 N", "cycles": cycles}})


def test_the_posterior_is_drawn_and_kept_as_draws(tmp_path):
    """The draws' spread of logarithms is the posterior's; what no data touch keeps its prior factor."""
    prior = LogNormalPrior(names=tuple(PRIOR_FACTORS), value=np.array([10.0, 0.5, 40.0, 2500.0, 0.01]),
                           factor=np.array(list(PRIOR_FACTORS.values())))
    rig = identify(lambda p: p[2:3], prior, Data(names=("mode",), value=np.array([41.0]), relative_sd=np.array([0.01])))
    table, picture = calibrate._posterior(tmp_path, rig)
    assert picture.read_bytes().startswith(b"\x89PNG")
    with xr.open_dataset(table, group="posterior", engine="h5netcdf") as draws:
        assert draws.in_phase_frequency.attrs["units"] == "Hz"
        assert float(np.log(draws.in_phase_frequency).std()) == pytest.approx(0.01, rel=0.1)
        assert float(np.log(draws.damping_ratio).std()) == pytest.approx(np.log(10.0), rel=0.1)


def test_a_calibrated_case_is_a_case_file_with_the_new_values(tmp_path):
    prior = LogNormalPrior(names=tuple(PRIOR_FACTORS), value=np.array([10.0, 0.5, 40.0, 2500.0, 0.01]),
                  factor=np.array(list(PRIOR_FACTORS.values())))
    data = Data(names=("mode",), value=np.array([41.0]), relative_sd=np.array([0.001]))
    rig = identify(lambda p: p[2:3], prior, data)
    path = tmp_path / "case.toml"
    path.write_text(dump_case(calibrated_case(a_case(sliding_distance="14 um"), rig, 2e-14)))
    read = load_case(path)
    assert not re.search(r"\d{8}", path.read_text().replace(".", ""))  # no more figures than the data tell
    assert read.name == "small-calibrated"
    assert read.rig.in_phase_frequency == pytest.approx(41.0, rel=1e-4)
    assert read.rig.moving_mass == pytest.approx(10.0, rel=1e-9)
    assert read.wear.coefficient == 2e-14
    assert read.measured.sliding_distance == pytest.approx(14e-6)


@pytest.mark.parametrize(("tables", "message"), [
    (["", ""], "no case has a sliding_distance or a worn_volume"),
    (["[measured]\nsliding_distance_sd = '1 um'\n", ""], "sliding_distance_sd is given without sliding_distance")])
def test_nothing_to_calibrate_on_is_one_clear_error(tmp_path, capsys, tables, message):
    paths = []
    for index, text in enumerate(tables):
        paths.append(str(tmp_path / f"c{index}.toml"))
        Path(paths[-1]).write_text(f'format = "fretflow-case/1"\nname = "c{index}"\n[test]\ncycles = 1\n'
                                   f'excitation_amplitude = "53 N"\n{text}')
    assert cli.execute(["calibrate", *paths, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err


def test_cases_of_different_joints_are_not_calibrated_together():
    other = a_case(name="other", sliding_distance="1 um")
    other = other.model_copy(update={"contact": other.contact.model_copy(update={"friction_coefficient": 0.5})})
    with pytest.raises(InputError, match=r"other: \[contact\] differs"):
        calibrate.calibrate_rig([a_case(sliding_distance="1 um"), other], {})


def test_a_hinge_with_a_damping_ratio_of_its_own_is_not_calibrated_as_if_it_had_none():
    own = a_case(sliding_distance="1 um")
    own = own.model_copy(update={"rig": own.rig.model_copy(update={"hinge_damping_ratio": 0.03})})
    with pytest.raises(InputError, match=r"rig\.hinge_damping_ratio: one damping ratio is identified"):
        calibrate.calibrate_rig([own], {})
