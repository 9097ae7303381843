"""The paper's trends, judged on made-up results whose answer is plain.

What carries the weight: each judgement says met, not met and cannot tell where that is the case, and its
figures are those put in.
"""

import numpy as np
import pytest
from fretflow.case.config import validate_case
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.pipeline.trends import (
    is_papers,
    judge_resonance,
    judge_settling,
    judge_sliding,
    judge_slip_zones,
    judge_wear_pattern,
    mean_sliding,
    settling_cycles,
)
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.history import WearHistory

SIDE = np.linspace(-0.5e-3, 0.5e-3, 5)
NODES = np.array([(x, y) for x in SIDE for y in SIDE])
INTERFACE = Interface(nodes=NODES + 7.0, areas=np.full(25, 4e-8), gap=np.zeros(25))  # anywhere in the plane
EDGE = np.abs(NODES).max(axis=1) / 0.5e-3
CORNER = np.all(np.abs(NODES) > 0.4e-3, axis=1)


def period(state):
    state = np.asarray(state, dtype=np.int8)
    n = len(state)
    return PeriodicSolution(
        method="made up",
        frequency=100.0,
        displacement=np.zeros((n, 25, 3)),
        force=np.zeros((n, 25, 3)),
        state=state,
        internal=np.zeros((n, 2)),
        outputs={},
        friction_force=np.zeros(n),
        residual_history=(0.0,),
        error_estimate=float("nan"),
    )


def history(cycles, depth, sliding=None):
    cycles = np.asarray(cycles, dtype=np.int64)
    depth = np.asarray(depth, dtype=float)
    return WearHistory(
        cycles=cycles,
        depth=depth,
        rate=depth,
        volume=depth @ INTERFACE.areas,
        dissipated_energy=np.zeros(len(cycles)),
        energy=np.zeros(len(cycles)),
        approach=np.zeros(len(cycles)),
        upper_share=0.5,
        solves=1,
        stopped_by="cycles",
        sliding_distance=np.zeros(len(cycles)) if sliding is None else np.asarray(sliding, dtype=float),
    )


def uniform(values):
    return np.outer(values, np.ones(25))


def zones(slipping):
    return np.where(slipping, ContactState.SLIP, ContactState.STICK)


def test_slip_at_the_border_while_the_middle_sticks_is_met():
    trend = judge_slip_zones(INTERFACE, period([zones(EDGE > 2), zones(EDGE > 0.6), zones(EDGE >= 0)]))
    assert trend.met
    assert "slip lies at 1.00 and stick at 0.44" in trend.found  # 8 nodes at 0.5, the centre at 0


def test_slip_in_the_middle_is_not_met_and_gross_slip_alone_cannot_tell():
    assert judge_slip_zones(INTERFACE, period([zones(EDGE < 0.6)])).met is False
    assert judge_slip_zones(INTERFACE, period([zones(EDGE > 2), zones(EDGE >= 0)])).met is None


def test_open_nodes_count_neither_as_stick_nor_as_slip():
    state = zones(EDGE > 0.6)
    state[EDGE > 0.9] = ContactState.SEPARATION
    assert judge_slip_zones(INTERFACE, period([state])).met is None


def corner_history(early, late):
    base = np.ones(25)
    return history([0, 100, 1000], [0 * base, np.where(CORNER, early, 1.0), 10 * np.where(CORNER, late, 1.0)])


def test_corners_first_and_even_later_is_met():
    trend = judge_wear_pattern(INTERFACE, corner_history(8.0, 1.2))
    assert trend.met
    assert (
        f"{8.0 / ((4 * 8 + 21) / 25):.2f} at 100 cycles, {1.2 / ((4 * 1.2 + 21) / 25):.2f} at 1,000"
        in trend.found
    )
    assert f"hold {100 * 32 / 53:.0f} % of the early wear" in trend.found


@pytest.mark.parametrize(("early", "late"), [(8.0, 9.0), (0.5, 1.0), (1.1, 0.1), (4.0, 1.2)])
def test_another_order_is_not_met(early, late):
    assert judge_wear_pattern(INTERFACE, corner_history(early, late)).met is False


def test_a_short_or_wearless_history_cannot_tell():
    assert judge_wear_pattern(INTERFACE, history([0, 100], uniform([0, 1]))).met is None
    assert judge_wear_pattern(INTERFACE, history([0, 100, 1000], uniform([0, 0, 0]))).met is None


def settling(cycles, rate):
    """Return a history whose volume rate is `rate` between the counts `cycles`."""
    return history(cycles, uniform(np.concatenate([[0], np.cumsum(rate * np.diff(cycles))])))


def test_settling_is_where_the_rate_last_enters_its_band():
    cycles = np.arange(0, 1_100_000, 100_000)
    rate = np.array([2.0, 1.5, 1.2, 1.05, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert settling_cycles(settling(cycles, rate)) == 300_000
    assert judge_settling(settling(cycles, rate)).met
    rate[7] = 1.2  # leaves it again
    assert settling_cycles(settling(cycles, rate)) == 800_000
    assert judge_settling(settling(cycles, rate)).met is False
    assert settling_cycles(settling(cycles, np.ones(10))) == 0
    assert judge_settling(settling(cycles, np.ones(10))).met is False  # at once is not after half a million
    assert settling_cycles(history([0, 100], uniform([0, 0]))) is None


def test_settling_cannot_be_told_from_less_than_a_million_cycles():
    assert judge_settling(settling(np.arange(0, 900_001, 100_000), np.ones(9))).met is None


def test_sliding_is_averaged_over_cycles_and_not_over_steps():
    made = history([0, 100, 1000], uniform([0, 1, 2]), sliding=[10e-6, 14e-6, 14e-6])
    assert mean_sliding(made) == pytest.approx((100 * 12e-6 + 900 * 14e-6) / 1000)
    assert judge_sliding(53.0, made).met
    assert judge_sliding(75.0, made).met is False
    assert judge_sliding(60.0, made).met is None
    assert mean_sliding(history([0], uniform([0]), sliding=[5e-6])) == 5e-6


def test_the_resonance_must_rise():
    assert judge_resonance(100.0, 101.0).met
    assert "+1.00 %" in judge_resonance(100.0, 101.0).found
    assert judge_resonance(100.0, 99.0).met is False


@pytest.mark.parametrize(("changed", "own"), [
    ({}, True), ({"test.excitation_amplitude": "75 N"}, True), ({"test.excitation_amplitude": "60 N"}, False),
    ({"test.excitation_frequency": "60 Hz"}, False), ({"test.normal_load": "70 N"}, False),
    ({"specimen.youngs_modulus": "114 GPa"}, False), ({"contact.friction_coefficient": 0.5}, False),
    ({"mesh.contact_elements": 4}, True)])
def test_the_trends_belong_to_the_paper_s_own_tests(changed, own):
    raw = {"format": "fretflow-case/1", "name": "one", "test": {"excitation_amplitude": "53 N", "cycles": 10}}
    for key, value in changed.items():
        table, name = key.split(".")
        raw.setdefault(table, {})[name] = value
    assert is_papers(validate_case(raw)) is own
