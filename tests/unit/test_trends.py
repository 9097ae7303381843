"""The paper's claims, judged on made-up results whose answer is plain.

What carries the weight: each judgement says met, not met and cannot tell where that is the case, its figures are those
put in, and the claims are those of the example that a diagnosis takes.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import validate_case
from fretflow.contact.interface import Interface
from fretflow.contact.law import ContactState
from fretflow.experiments.facts.quantities import WornTest, mean_sliding, quantity_of
from fretflow.pipeline.trends import is_papers, judge, judge_all, papers_facts
from fretflow.recordings.kinds.facts import Fact, read_facts
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.wear.history import WearHistory

EXAMPLE = Path(__file__).parents[2] / "examples" / "paper.toml"
SIDE = np.linspace(-0.5e-3, 0.5e-3, 17)
WEIGHT = np.r_[0.5, np.ones(15), 0.5]
NODES = np.array([(x, y) for x in SIDE for y in SIDE])
AREAS = np.outer(WEIGHT, WEIGHT).ravel() * (1e-3 / 16)**2  # of a piecewise linear depth
INTERFACE = Interface(nodes=NODES + 7.0, areas=AREAS, gap=np.zeros(289))  # anywhere in the plane
EDGE = np.abs(NODES).max(axis=1) / 0.5e-3
CORNER = np.all(np.abs(NODES) > 0.37e-3, axis=1)  # the nodes of the cells from 0.75 of the half width on
CORNER_AREA = AREAS[CORNER].sum() / AREAS.sum()
END = 1_900_000


def period(state):
    state = np.asarray(state, dtype=np.int8)
    n = len(state)
    return PeriodicSolution(
        method="made up", frequency=100.0, displacement=np.zeros((n, 289, 3)), force=np.zeros((n, 289, 3)),
        state=state, internal=np.zeros((n, 2)), outputs={}, friction_force=np.zeros(n), residual_history=(0.0,),
        error_estimate=float("nan"))


def history(cycles, depth, sliding=None, rate=None):
    cycles, depth = np.asarray(cycles, dtype=np.int64), np.asarray(depth, dtype=float)
    zeros = np.zeros(len(cycles))
    return WearHistory(
        cycles=cycles, depth=depth, rate=depth if rate is None else np.outer(rate, np.ones(289)),
        volume=depth @ AREAS, dissipated_energy=zeros, energy=zeros, approach=zeros, upper_share=0.5, solves=1,
        stopped_by="cycles", sliding_distance=zeros if sliding is None else np.asarray(sliding, dtype=float))


def worn(made, state=((ContactState.SLIP,) * 289,), resonances=None):
    return WornTest(interface=INTERFACE, normal_load=60.0, unworn=period(state), history=made,
                    resonance=lambda cycles: None if resonances is None else resonances[int(cycles > 0)])


def claim(quantity, amplitude=53.0):
    """Return the paper's own claim of a quantity, with the cycles that it is of."""
    paper = papers_facts()
    fact = next(one for one in paper.facts if one.quantity == quantity and paper.condition_of(one)[0] == amplitude)
    return fact, paper.cycles_of(fact)


def judged(quantity, test, amplitude=53.0):
    return judge(*claim(quantity, amplitude), test)


def uniform(values):
    return np.outer(values, np.ones(289))


def zones(slipping):
    return np.where(slipping, ContactState.SLIP, ContactState.STICK)


def test_the_claims_are_those_of_the_example():
    assert papers_facts() == read_facts(EXAMPLE).file


def test_slip_at_the_border_while_the_middle_sticks_is_met():
    state = [zones(EDGE > 2), zones(EDGE > 0.99), zones(EDGE >= 0)]
    trend = judged("slip-outside", worn(history([0, END], uniform([0, 1])), state))
    inner = EDGE < 0.99
    assert trend.met
    assert trend.found == f"{1.0 - (EDGE * AREAS)[inner].sum() / AREAS[inner].sum():.3g}"


def test_a_joint_that_has_stopped_wearing_tells_of_all_later_cycles():
    stuck = replace(history([0], uniform([0])), stopped_by="vanishing rate")
    trend = judged("sliding-distance", worn(stuck), 75.0)
    assert trend.met is False
    assert trend.found.startswith("0 m: ")
    assert "too few" in judged("sliding-distance", worn(history([0], uniform([0]))), 75.0).found


def test_slip_in_the_middle_is_not_met_and_gross_slip_alone_cannot_tell():
    made = history([0, END], uniform([0, 1]))
    assert judged("slip-outside", worn(made, [zones(EDGE < 0.6)])).met is False
    alone = judged("slip-outside", worn(made, [zones(EDGE > 2), zones(EDGE >= 0)]))
    assert (alone.met, alone.found) == (None, "no instant with both stick and slip")


def test_open_nodes_count_neither_as_stick_nor_as_slip():
    state = zones(EDGE > 0.6)
    state[EDGE > 0.6] = ContactState.SEPARATION
    assert judged("slip-outside", worn(history([0, END], uniform([0, 1])), [state])).met is None


def corner_history(early, late):
    base = np.ones(289)
    return worn(history([0, 190_000, END], [0 * base, np.where(CORNER, early, 1.0), 10 * np.where(CORNER, late, 1.0)]))


def over_mean(corner):
    return corner / (corner * CORNER_AREA + 1.0 - CORNER_AREA)


def test_corners_are_read_off_between_the_nodes():
    """A twelfth of the face is the corners' nodes; their cells are a sixteenth."""
    test = corner_history(40.0, 1.2)
    share = quantity_of(*claim("corner-share"), test)
    assert share == pytest.approx(over_mean(40.0) / 16.0)
    assert quantity_of(*claim("corner-depth-ratio"), test) == pytest.approx(over_mean(1.2))
    assert quantity_of(*claim("corner-depth-growth"), test) == pytest.approx(12.0 / 40.0)


@pytest.mark.parametrize(("early", "late", "met"), [
    (40.0, 1.2, (True, True, True)), (40.0, 9.0, (True, False, False)), (0.5, 1.0, (False, True, False)),
    (1.1, 0.1, (False, False, True)), (12.0, 1.2, (False, True, False))])
def test_corners_first_then_even_and_no_deeper(early, late, met):
    """Mainly means more than half: twelve times as deep, the corners hold a third of the wear."""
    test = corner_history(early, late)
    verdicts = [judged(name, test).met for name in ("corner-share", "corner-depth-ratio", "corner-depth-growth")]
    assert tuple(verdicts) == met


def test_a_short_or_wearless_history_cannot_tell():
    short, none = (worn(history(cycles, uniform(np.zeros(len(cycles)) + value))) for cycles, value in (
        ([0, 100], 1.0), ([0, 190_000, END], 0.0)))
    for quantity in ("corner-share", "corner-depth-ratio", "corner-depth-growth", "settling-cycles"):
        assert judged(quantity, short).met is None
        assert "100 cycles are too few" in judged(quantity, short).found
        assert judged(quantity, none).met is None or quantity == "settling-cycles"


def settling(times):
    """Return a test whose rate falls to its final value over so many cycles, exponentially."""
    cycles = np.r_[0, np.geomspace(100, END, 200).astype(int)]
    return worn(history(cycles, uniform(cycles), rate=1.0 + np.exp(-cycles / times)))


@pytest.mark.parametrize(("times", "met"), [(500_000 / np.log(10.0), True), (3_700 / np.log(10.0), False),
                                            (350_000 / np.log(10.0), True), (800_000 / np.log(10.0), False)])
def test_settling_is_where_the_rate_enters_a_tenth_of_its_last_value(times, met):
    """1 + exp(-n / t) is within a tenth of one from t ln 10 on."""
    test = settling(times)
    assert quantity_of(*claim("settling-cycles"), test) == pytest.approx(times * np.log(10.0), rel=0.02)
    assert judged("settling-cycles", test).met is met


def test_a_claim_that_is_missed_says_by_how_much():
    """3,700 cycles are a factor of 135 from half a million, and 3.3 of its standard deviations."""
    assert judged("settling-cycles", settling(3_700 / np.log(10.0))).found.endswith("3.3 sd too low, a factor of 135")


def test_a_rate_that_is_steady_from_the_start_or_leaves_again():
    cycles = np.arange(0, 2_000_000, 100_000)
    steady = worn(history(cycles, uniform(cycles), rate=np.ones(20)))
    assert quantity_of(*claim("settling-cycles"), steady) == 0.0
    assert judged("settling-cycles", steady).met is False
    rate = np.where(cycles == 700_000, 1.2, 1.0)  # leaves it once more
    left = quantity_of(*claim("settling-cycles"), worn(history(cycles, uniform(cycles), rate=rate)))
    assert left is not None
    assert 700_000 < left < 800_000


def test_sliding_is_averaged_over_cycles_and_not_over_steps():
    made = history([0, 100, 1000], uniform([0, 1, 2]), sliding=[10e-6, 14e-6, 14e-6])
    assert mean_sliding(made, 1000) == pytest.approx((100 * 12e-6 + 900 * 14e-6) / 1000)
    assert mean_sliding(made, 50) == pytest.approx(11e-6)
    assert mean_sliding(made, 0) == 10e-6


@pytest.mark.parametrize(("amplitude", "sliding", "met"), [(53.0, 14.5e-6, True), (53.0, 12.4e-6, False),
                                                           (75.0, 22.9e-6, True), (75.0, 36e-6, False)])
def test_sliding_is_met_within_its_uncertainty(amplitude, sliding, met):
    made = worn(history([0, END], uniform([0, 1]), sliding=[sliding, sliding]))
    assert judged("sliding-distance", made, amplitude).met is met


def test_the_resonance_must_rise():
    made = history([0, END], uniform([0, 1]))
    assert judged("resonance-change", worn(made, resonances=(100.0, 101.0))).met
    fallen = judged("resonance-change", worn(made, resonances=(100.0, 99.0)))
    assert (fallen.met, fallen.found) == (False, "-0.01: 5.0 sd too low")
    assert judged("resonance-change", worn(made)).met is None


def test_each_test_is_held_against_its_own_claims():
    made = history([0, END], uniform([0, 1]))
    state = period([zones(EDGE > 0.6)])
    for amplitude, count in ((53.0, 8), (75.0, 1)):
        test = validate_case(own(amplitude)).test
        assert len(judge_all(test, INTERFACE, state, made, None)) == count


def test_a_bound_says_which_side_it_is_of():
    assert Fact(quantity="stick-share", at_least=0.1, sd=0.01).label == "stick share: at least 0.1"


def own(amplitude=53.0):
    return {"format": "fretflow-case/1", "name": "one", "test": {"excitation_amplitude": f"{amplitude} N",
                                                                 "cycles": 10}}


@pytest.mark.parametrize(("changed", "papers"), [
    ({}, True), ({"test.excitation_amplitude": "75 N"}, True), ({"test.excitation_amplitude": "60 N"}, False),
    ({"test.excitation_frequency": "60 Hz"}, False), ({"test.normal_load": "70 N"}, False),
    ({"specimen.youngs_modulus": "114 GPa"}, False), ({"contact.friction_coefficient": 0.5}, False),
    ({"specimen.face": "crowned", "specimen.face_radius": "80 mm"}, False), ({"specimen.body_height": "9 mm"}, False),
    ({"mesh.upper": "a.msh", "mesh.lower": "b.msh"}, False), ({"mesh.contact_elements": 4}, True),
    ({"specimen.observation_distance": "2 mm"}, True)])
def test_the_claims_belong_to_the_paper_s_own_tests(changed, papers):
    raw = own()
    for key, value in changed.items():
        table, name = key.split(".")
        raw.setdefault(table, {})[name] = value
    assert is_papers(validate_case(raw)) is papers
