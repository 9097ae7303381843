"""First-order changes of a whole recording against simulating again.

What carries the weight: for parameters of the baseline and for effects in friction, load, drive, sensors, friction that
runs in and wear laws, the change that one march of the simulated periods predicts is the difference of two simulations.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fretflow.core.errors import NonConvergenceError
from fretflow.effects.contact_stiffness_evolution import ContactStiffnessEvolution
from fretflow.effects.distributed_micro_slip import places
from fretflow.effects.normal_load_coupling import NormalLoadCoupling
from fretflow.experiments.rig import model as rig_model
from fretflow.experiments.rig.experiment import BASELINE, RigExperiment, hypothesis
from fretflow.experiments.rig.model import RigModel
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.experiments.rig.tangent import neighbours
from fretflow.inference.experiment import Point, jacobian
from fretflow.inference.parameters import Parameters
from fretflow.recordings.schema import SweepCondition

CHANNELS = ("displacement", "friction_force", "normal_force", "approach")
COUNTS = (0, 5000, 20000, 60000)
CONDITIONS = (SweepCondition(id=0, excitation_amplitude="75 N"), SweepCondition(id=1, normal_load="50 N"),
              SweepCondition(id=2, excitation_frequency="80 Hz"))
# exponentially: of another order friction hardly moves the wear; a scar that fills late and ends near: no fold is near;
# friction that settles over all counts, between which changes count as linear; a guide that is curved
GENTLE = {"order": 1.0, "depth_scale": 4e-6, "reach": 1.2, "energy": 300.0, "curvature": 2e4}


@pytest.fixture
def rig(monkeypatch):
    """Return the rig whose tests tell more than a diagnosis would need."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    seen = small_rig.observed(dict.fromkeys(CHANNELS, 1.0), COUNTS, CONDITIONS, 1.0, 1.0)
    return replace(small_rig.rig(seen), wear_tolerance=0.05)


@pytest.fixture(autouse=True)
def accurate(monkeypatch):
    """Solve well below the differences that are looked at; a diagnosis stops at what noise hides."""
    monkeypatch.setattr(rig_model, "TOLERANCE", 1e-8)


def counted_from(rig, channel):
    """Return a rig whose recording counts the phase from the largest value of a channel's fundamental."""
    return replace(rig, observation=replace(rig.observation, aligned_to=channel))


@pytest.mark.parametrize(("effects", "aligned_to"), [
    (("friction-run-in",), "excitation"), (("normal-load-drift", "sensor-path-compliance"), "excitation"),
    (("wear-power-law",), "excitation"), (("scar-edge",), "excitation"), (("third-body",), "excitation"),
    (("directional-friction", "excitation-distortion"), "excitation"), (("normal-load-coupling",), "excitation"),
    (("viscous", "sensor-path-compliance"), "displacement")])
def test_neighbours_are_what_another_simulation_shows(rig, effects, aligned_to):
    model, space = counted_from(rig, aligned_to), Parameters.of(BASELINE, effects)
    z = np.array([one.place(GENTLE[one.field]) if one.field in GENTLE else 0.0 for one in space.coordinates])
    base = model.simulate(hypothesis(Point(space, z)))
    step = 0.02
    beside, taken = Point(space, z).beside(step)
    changes = neighbours(model, base, [hypothesis(one) for one in beside]) * np.sign(taken)
    for i, coordinate in enumerate(space.coordinates):
        ends = []
        for sign in (-1.0, 1.0):
            moved = z.copy()
            moved[i] += sign * step
            ends.append(model.predict(model.simulate(hypothesis(Point(space, moved)), base)))
        difference = 0.5 * (ends[1] - ends[0])
        places = [(piece.channel, piece.place) for piece in model.observation.pieces]
        for channel, place in places:
            whole = max(np.abs(difference[other]).max() for name, other in places if name == channel)
            shown = model.predict(base)[place]
            size = np.ptp(shown) if channel in ("displacement", "friction_force") else np.abs(shown).max()
            assert np.abs(changes[place, i] - difference[place]).max() < max(0.3 * whole, 2e-4 * size), (
                coordinate.name, channel)


def test_of_a_tilt_that_wear_has_levelled_nothing_is_left_but_the_depth(monkeypatch):
    """What more of it would change at the end is the depth by which it is levelled, and no motion."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    counts = (*COUNTS, 200_000, 400_000)
    rig = small_rig.rig(small_rig.observed(dict.fromkeys(CHANNELS, 1.0), counts, (), 1.0, 1.0))
    space = Parameters.of(BASELINE, ["initial-gap"])
    z = np.array([one.place({"tilt_x": 0.5e-6}.get(one.field, 0.0)) if one.effect else 0.0
                  for one in space.coordinates])
    step = 0.02 * np.eye(space.size)[[one.field for one in space.coordinates].index("tilt_x")]
    base, (more,) = rig.simulate(hypothesis(Point(space, z))), hypothesis(Point(space, z + step)).effects
    change = neighbours(rig, base, [hypothesis(Point(space, z + step))])[:, 0]
    seen = rig.observation
    levelled = (more.period(rig.problem, None).interface.gap
                - base.hypothesis.effects[0].period(rig.problem, None).interface.gap)
    deeper = change[seen.rows(block="map")]
    np.testing.assert_allclose(deeper - deeper.mean(), levelled.mean() - levelled, atol=0.02 * np.ptp(levelled))
    for channel in ("displacement", "friction_force"):
        first, last = (np.abs(change[seen.rows(block="loops", channel=channel, cycles=count)]).max()
                       for count in (counts[0], counts[-1]))
        assert last < 0.01 * first


def test_friction_that_runs_in_by_energy_follows_the_energy_of_another_mass(rig):
    space = Parameters.of(BASELINE, ["friction-run-in"])
    z = np.array([one.place(GENTLE[one.field]) if one.field in GENTLE else 0.0 for one in space.coordinates])
    base, step = rig.simulate(hypothesis(Point(space, z))), 0.02 * np.eye(space.size)[2]
    heavier, lighter = (hypothesis(Point(space, z + sign * step)) for sign in (1.0, -1.0))
    difference = 0.5 * np.subtract(*(rig.predict(rig.simulate(one, base)) for one in (heavier, lighter)))
    missed = neighbours(rig, base, [heavier])[:, 0] - difference
    for channel in ("displacement", "friction_force"):
        rows = rig.observation.rows(channel=channel)
        assert np.linalg.norm(missed[rows]) < 0.1 * np.linalg.norm(difference[rows]), channel


def test_what_chance_decides_has_a_coordinate_for_each_place(rig):
    """Another face with the same limits is this one with every place so many standard deviations off its own.

    What each place's limit does is told by one march.
    """
    size = len(rig.observation.values)
    experiment = RigExperiment(rig, np.zeros(size), np.zeros((size, 0)))
    space = experiment.parameters(["distributed-micro-slip"])
    point = Point(space, np.where(space.own("distributed-micro-slip") & ~space.chances, [-1.3], 0.0))
    (even,) = hypothesis(point).effects
    problem, at = rig.problem, places(rig.problem.interface)
    limits = even._limits(len(at), 0)[np.argsort(np.argsort(at))]
    off = np.zeros(even.chances)
    off[at] = (np.roll(limits, 2) - limits) / limits.std()
    there = Point(space, point.z.copy())
    there.z[space.chances] = off
    (other,) = hypothesis(there).effects
    friction, areas = np.roll(even.period(problem, None).friction_coefficient, 2), problem.interface.areas
    friction *= problem.friction_coefficient * areas.sum() / (friction @ areas)
    np.testing.assert_allclose(other.period(problem, None).friction_coefficient, friction, rtol=1e-9)
    base = experiment.predict(point)
    slopes = jacobian(experiment, base)
    for place in np.flatnonzero(space.chances)[at[:3]]:  # others move less
        step = 0.2 * np.eye(space.size)[place]
        more, less = (experiment.predict(Point(space, point.z + way * step), base).values for way in (1.0, -1.0))
        simulated = (more - less) / 0.4
        for channel in ("displacement", "friction_force"):
            rows = np.hstack([np.arange(size)[one.place] for one in rig.observation.pieces if one.channel == channel])
            missed = np.linalg.norm(slopes[rows, place] - simulated[rows])
            assert missed < 0.1 * np.linalg.norm(simulated[rows]), channel
    assert not experiment.parameters(()).chances.any()


def test_errors_of_a_mesh_are_told_without_what_it_leaves_to_chance(rig):
    """On a finer mesh the same law has another arrangement, which is no error of the coarse one."""
    size = len(rig.observation.values)
    finer = replace(rig, problem=replace(rig.problem, interface=replace(
        rig.problem.interface, nodes=rig.problem.interface.nodes[::-1].copy())))  # other places for the same nodes
    experiment = RigExperiment(rig, np.zeros(size), np.zeros((size, 0)), checks=(finer, rig.denser()))
    space = experiment.parameters(["distributed-micro-slip"])
    scattered, even = (experiment.predict(Point(space, np.zeros(space.size), neutral)) for neutral in (
        frozenset(), frozenset({"distributed-micro-slip"})))
    turned = finer.predict(finer.refine(scattered.state)) - scattered.values
    missed = experiment.corrected(scattered).correction - experiment.corrected(even).correction
    for channel in ("displacement", "friction_force"):
        rows = np.hstack([np.arange(size)[one.place] for one in rig.observation.pieces if one.channel == channel])
        assert np.abs(missed[rows]).max() < 0.01 * np.abs(turned[rows]).max(), channel  # wear steps begin elsewhere


def test_what_sensors_alone_change_is_exact_of_a_prediction_with_finer_wear_steps(rig, monkeypatch):
    """What the steps change is not the sensor's, and no motion is sought for it."""
    size = len(rig.observation.values)
    coarse = replace(rig, wear_tolerance=0.1)
    experiment = RigExperiment(coarse, np.zeros(size), np.zeros((size, 0)), checks=(coarse, coarse.denser()))
    point = Point(experiment.parameters(()), np.zeros(len(BASELINE)))
    delayed = experiment.parameters(("channel-delay",))
    there = Point(delayed, np.r_[np.zeros(len(BASELINE)), np.ones(delayed.size - len(BASELINE))])
    finer = experiment.finer()
    fine = finer.predict(point)
    wanted = finer.predict(there, fine).values - fine.values
    assert not experiment.has_made(fine)
    assert [one.wear_tolerance for one in finer.checks] == [finer.rig.wear_tolerance] * 2
    assert np.abs(experiment.predict(point).values - fine.values).max() > 1e-4 * np.abs(wanted).max()
    monkeypatch.setattr(rig_model.RigModel, "simulate", None)
    (change,) = experiment.changes(fine, [there]).T
    assert change == pytest.approx(wanted, rel=1e-9, abs=1e-12 * np.abs(wanted).max())
    assert np.abs(wanted).max() > 0.0


def test_numbers_beyond_all_bounds_are_no_prediction(rig):
    """A worn depth that overflows is refused, and a correction by such a model is none."""
    base = rig.simulate(Hypothesis())
    size, last = len(rig.observation.values), base.steps[-1]
    endless = replace(base, steps=(replace(last, slow=replace(last.slow, depth=last.depth + np.inf)),))
    with pytest.raises(NonConvergenceError, match="beyond all bounds"):
        rig.predict(endless)
    finer = SimpleNamespace(samples=rig.samples, refine=lambda _: endless, predict=rig.predict,
                            resolving=lambda _: finer)
    experiment = RigExperiment(rig, np.zeros(size), np.zeros((size, 0)), checks=(finer, finer))
    space = Parameters.of(BASELINE, ())
    assert experiment.corrected(experiment.predict(Point(space, np.zeros(space.size)))) is None


@pytest.mark.parametrize("misleads", [False, True])
def test_a_closer_model_begins_from_nothing_where_the_coarse_motion_misleads(rig, monkeypatch, misleads):
    """As where too few samples ring at another harmonic."""
    coarse = rig.simulate(Hypothesis())

    def simulate(self, asked, near=None):
        if misleads and near is not None:
            raise NonConvergenceError("lost")
        return asked, near

    monkeypatch.setattr(RigModel, "simulate", simulate)
    assert rig.denser().refine(coarse) == (coarse.hypothesis, None if misleads else coarse)


def test_a_finer_mesh_begins_from_the_motion_on_the_coarse_one(rig):
    """With the same answer as from nothing, in fewer steps of Newton."""
    import small_rig

    fine = replace(small_rig.rig(rig.observation, np.arange(49)), wear_tolerance=0.05)
    anew, near = fine.simulate(Hypothesis()), fine.refine(rig.simulate(Hypothesis()))
    predicted, wanted = fine.predict(near), fine.predict(anew)
    for piece in rig.observation.pieces:
        size = np.abs(wanted[piece.place]).max()
        assert predicted[piece.place] == pytest.approx(wanted[piece.place], abs=1e-3 * size)
    steps = [sum(len(period.solution.residual_history) for period in (*one.loops[:1], *one.sweep))
             for one in (near, anew)]
    assert steps[0] < steps[1]


def test_softer_bodies_are_no_springs_between_the_faces(rig):
    """A sensor at the faces sees their own motion, of which asperities would hide a part and the bodies do not."""
    model, space = rig, Parameters.of(BASELINE, [])
    place = [coordinate.field for coordinate in space.coordinates].index("compliance")
    base = model.simulate(hypothesis(Point(space, np.zeros(space.size))))
    ends = [hypothesis(Point(space, sign * 0.2 * np.eye(space.size)[place])) for sign in (1.0, -1.0)]
    difference = 0.5 * np.subtract(*(model.predict(model.simulate(one, base)) for one in ends))
    change = neighbours(model, base, ends[:1])[:, 0]
    for piece in model.observation.pieces:
        if piece.channel == "displacement" and piece.block == "loops":
            missed = np.linalg.norm(change[piece.place] - difference[piece.place])
            assert missed < 0.03 * np.linalg.norm(difference[piece.place])


def test_without_the_drive_the_phase_is_counted_from_the_displacement(rig):
    """The same loops, each begun where the displacement's fundamental is largest, as such recordings are put."""
    base = rig.simulate(Hypothesis())
    seen, moved = (counted_from(rig, channel).predict(base) for channel in ("excitation", "displacement"))
    loops = {}
    for piece in rig.observation.pieces:
        if piece.block in ("loops", "sweep"):
            at = loops.setdefault(piece.label, {})
            at[piece.channel] = [np.fft.rfft(vector[piece.place]) for vector in (seen, moved)]
    orders = np.arange(len(at["displacement"][0]))
    for at in loops.values():
        x = at["displacement"]
        assert abs(np.angle(x[0][1])) > 0.3
        assert np.angle(x[1][1]) == pytest.approx(0.0, abs=1e-9)
        for before, after in at.values():
            turned = before * np.exp(-1j * orders * np.angle(x[0][1]))
            np.testing.assert_allclose(after, turned, atol=1e-9 * np.abs(before).max())


def test_a_neighbour_without_data_at_the_motion_is_left_out_alone(rig):
    """A load that would vanish under the arm's motion has no period; those beside it are as without it."""
    base = rig.simulate(Hypothesis())
    good = [Hypothesis(friction=1.01), Hypothesis(wear=1.01), Hypothesis(mass=1.01)]
    lifts = Hypothesis(effects=(NormalLoadCoupling().changed(slope=1e9),))
    changes = neighbours(rig, base, [good[0], lifts, *good[1:]])
    assert np.all(np.isnan(changes[:, 1]))
    np.testing.assert_allclose(changes[:, [0, 2, 3]], neighbours(rig, base, good), rtol=1e-9, atol=1e-12)


class Witness(ContactStiffnessEvolution):
    """The same springs, which tell what they were asked of."""

    def period(self, problem, slow):
        """Keep the slow state."""
        ASKED.append(slow)
        return super().period(problem, slow)


ASKED = []


def test_no_neighbour_is_so_far_off_that_it_has_given_energy_back(rig):
    """Where first order would take more energy than was dissipated there is none yet, and no less wear than none."""
    ASKED.clear()
    base = rig.simulate(Hypothesis())
    assert np.isfinite(neighbours(rig, base, [Hypothesis(mass=5.0, effects=(Witness(),))])).all()
    worn = [slow for slow in ASKED if slow.cycles]
    assert min(slow.energy for slow in worn) == 0.0
    assert min(slow.depth.min() for slow in worn) >= 0.0


def test_normal_force_and_approach_are_those_of_the_period(rig):
    """The contact carries the load at every sample; the backs stand nearer by what the mean pressure gives way."""
    model = rig
    space = Parameters.of(BASELINE, ["normal-load-coupling"])
    base = model.simulate(hypothesis(Point(space, np.zeros(space.size))))
    for period in (base.loops[0], base.sweep[1]):
        signals = model.signals(period)
        carried = period.solution.force[:, :, 2].sum(axis=1)
        lines, wanted = (np.fft.rfft(one)[:11] / len(one) for one in (signals.normal_force, carried))
        np.testing.assert_allclose(lines, wanted, atol=1e-6 * carried.mean())
        assert np.ptp(signals.normal_force) > 1e-3 * signals.normal_force.mean()
    lighter, heavier = (model.signals(base.sweep[k]) for k in (1, 0))  # 50 N and 60 N
    assert lighter.approach.mean() < heavier.approach.mean()


def test_a_change_of_friction_acts_on_the_conditions_of_the_sweep(monkeypatch):
    """At another load the friction force of sliding changes by the same share of that load.

    With all harmonics that the samples hold, for corners that are not rounded.
    """
    monkeypatch.syspath_prepend(Path(__file__).parent)
    import small_rig

    monkeypatch.setattr(small_rig, "HARMONICS", 19)
    monkeypatch.setattr(small_rig, "SAMPLES", 39)
    model = small_rig.rig(small_rig.observed(dict.fromkeys(CHANNELS, 1.0), COUNTS, CONDITIONS, 1.0, 1.0))
    space = Parameters.of(BASELINE, [])
    z = np.zeros(space.size)
    base = model.simulate(hypothesis(Point(space, z)))
    moved = z.copy()
    moved[0] = 0.02
    factor = hypothesis(Point(space, moved)).friction / hypothesis(Point(space, z)).friction
    change = neighbours(model, base, [hypothesis(Point(space, moved))])[:, 0]
    before = model.predict(base)
    for piece in model.observation.pieces:
        if piece.channel == "friction_force" and piece.block == "sweep":
            at = np.argmax(before[piece.place])
            assert change[piece.place][at] == pytest.approx((factor - 1.0) * before[piece.place][at], rel=0.1)


@pytest.mark.parametrize(("exponent", "is_told"), [(1.0, True), (-1.5, False)])
def test_of_faces_that_wear_makes_unstable_no_change_is_of_first_order(rig, exponent, is_told):
    """What is pressed more wears less: any change of depth grows two hundred times, and is told as not known."""
    space = Parameters.of(BASELINE, ["wear-power-law"])
    (place,) = (one.place(exponent) for one in space.coordinates if one.field == "pressure_exponent")
    at = {"wear": 1.5, "pressure_exponent": place}
    point = Point(space, np.array([at.get(one.field, 0.0) for one in space.coordinates]))
    coarse = replace(rig, wear_tolerance=rig_model.WEAR_TOLERANCE)  # or it takes a step for every wobble
    changes = neighbours(coarse, coarse.simulate(hypothesis(point)), [hypothesis(one) for one in point.beside()[0]])
    assert (np.isfinite(changes) == is_told).all()
