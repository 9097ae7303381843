"""What holds for every effect of the catalogue, whoever wrote it.

What carries the weight: an effect at its neutral parameters leaves the baseline as it is; derivatives by parameters,
which never solve again, match central differences of full solutions; and any two effects work together in a solved
period, in either order, or say why not.
"""

import itertools
from functools import cache, reduce
from pathlib import Path

import numpy as np
import pytest
from fretflow.case.config import Solver
from fretflow.contact.interface import Interface
from fretflow.core.errors import ConfigError
from fretflow.effects.catalogue import catalogue, parse_effects, tables
from fretflow.effects.cycle import respond
from fretflow.effects.derivative import directions_to
from fretflow.effects.effect import Effect
from fretflow.effects.model import EffectModel
from fretflow.pipeline.problem import rig_problem
from fretflow.recordings.kinds.joints import FRETTING_RIG
from fretflow.solvers.quasi_static.solver import QuasiStaticSolver
from fretflow.solvers.sensitivity import sensitivities
from fretflow.structure.sensors import Signals
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig

DATA = np.load(Path(__file__).parents[1] / "data" / "periodic" / "krel_49.npz")
FEW = np.flatnonzero((np.arange(49) // 7 % 3 == 0) & (np.arange(49) % 7 % 3 == 0))  # 3 x 3
HARMONICS, SAMPLES = 6, 32
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
SOLVER = QuasiStaticSolver(Solver(harmonics=HARMONICS, samples=SAMPLES, tolerance=1e-12, estimate_error=False))
IDS = sorted(catalogue())
# Ranges hold for the rig; on nine nodes and six harmonics milder values keep a period that exists.
MILD = {"backlash": 0.05}


@cache
def baseline():
    dofs = (3 * FEW[:, None] + np.arange(3)).ravel()
    stiffness = np.linalg.inv(np.linalg.inv(1e3 * DATA["K"])[np.ix_(dofs, dofs)])
    face = Interface(nodes=1e-3 * DATA["x"][FEW, :2], areas=np.full(9, 1e-6 / 9), gap=2e-8 * np.arange(9.0))
    return rig_problem(joint=QuasiStaticJoint.from_stiffness(0.5 * (stiffness + stiffness.T), RIG), interface=face,
                           friction_coefficient=0.88, frequency=100.0, excitation=70.0, normal_load=60.0)


@cache
def solved():
    return SOLVER.solve(baseline())


def modest(kind):
    """Return the effect in the lower part of its ranges."""
    values = {}
    for name, prior in kind.priors().items():
        share = MILD.get(kind.id, 0.3)
        low, high = prior.low, prior.high
        values[name] = low * (high / low)**share if prior.logarithmic else low + share * (high - low)
    return kind().changed(**values)


def later(model):
    """Return a joint that has worn a little, unevenly, and remembers it."""
    start = model.initial()
    worn = 2e-8 * (1.0 + 0.3 * np.cos(np.arange(9.0)))
    return model.evolve(start, 3e4, worn, 40.0, respond(solved(), baseline().interface))


def signals(period):
    return Signals(step=1e-2 / SAMPLES, displacement=period.displacement[:, :, 0].mean(axis=1),
                   friction_force=period.friction_force, arm=period.rig_displacement[:, 1],
                   excitation=70.0 * np.cos(2.0 * np.pi * np.arange(SAMPLES) / SAMPLES))


def close(a, b, tolerance=1e-12):
    scale = max(float(np.abs(b).max()), 1e-300)
    return float(np.abs(np.asarray(a) - np.asarray(b)).max()) < tolerance * scale


@pytest.mark.parametrize("name", IDS)
def test_neutral_is_the_baseline(name):
    neutral = catalogue()[name].neutral()
    model, plain = EffectModel.build(baseline(), [neutral]), EffectModel.build(baseline())
    slow, bare = later(model), later(plain)
    period, expected = SOLVER.solve(model.problem(slow)), SOLVER.solve(plain.problem(bare))
    for part in ("displacement", "force", "rig_displacement", "friction_force"):
        assert close(getattr(period, part), getattr(expected, part)), part
    response = respond(expected, plain.problem(bare).interface)
    assert close(model.wear_factor(response, slow), np.ones(9))
    assert close(model.opening_share(slow, 1e4), np.ones(9))
    seen, unseen = model.sense(signals(expected)), signals(expected)
    assert close(seen.displacement, unseen.displacement)
    assert close(seen.friction_force, unseen.friction_force)


def acting_in_the_period():
    """Return (effect, parameter) of all that change a period's problem."""
    for name in IDS:
        kind = catalogue()[name]
        if FRETTING_RIG in kind.kinds and kind.period is not Effect.period:
            yield from ((name, parameter) for parameter in kind.priors())


def shown(period):
    """Return the motion of block and arm, and the friction force, of a period or of its sensitivities."""
    return {"block": period.outputs["block"], "arm": period.outputs["arm"], "friction force": period.friction_force}


@pytest.mark.parametrize(("name", "parameter"), list(acting_in_the_period()))
def test_derivatives_are_those_of_central_differences(name, parameter):
    effect = modest(catalogue()[name])
    model = EffectModel.build(baseline(), [effect])
    slow = later(model)
    period = SOLVER.solve(model.problem(slow), solved())
    step = 1e-4 * max(abs(getattr(effect, parameter)), 0.01 * abs(effect.priors()[parameter].high))
    changed = [effect.changed(**{parameter: getattr(effect, parameter) + by}) for by in (-step, step)]
    varied = [EffectModel.build(baseline(), [one]).problem(slow) for one in changed]
    directions = directions_to(varied, model.problem(slow), period)
    exact = sensitivities(model.problem(slow), period, directions, HARMONICS)
    both = [shown(SOLVER.solve(one, period)) for one in varied]
    for part, value in shown(period).items():
        own, difference = ((two - one) / (2.0 * step) for one, two in (shown(exact)[part], [one[part] for one in both]))
        # what a step of the size of the parameter's range would change, against what the period itself is
        visible = 1e-7 * np.abs(value).max() / effect.priors()[parameter].high
        assert np.abs(own - difference).max() < max(1e-5 * np.abs(difference).max(), abs(visible)), part


def pairs():
    rig = [name for name in IDS if FRETTING_RIG in catalogue()[name].kinds]
    return list(itertools.combinations(rig, 2))


@pytest.mark.parametrize("first", sorted({first for first, _ in pairs()}))
def test_any_two_work_together_or_say_why_not(first):
    for second in (b for a, b in pairs() if a == first):
        effects = [modest(catalogue()[name]) for name in (first, second)]
        if second in effects[0].excludes or first in effects[1].excludes:
            with pytest.raises(ConfigError, match=r"do not work together: .+"):
                EffectModel.build(baseline(), effects)
            continue
        one, other = EffectModel.build(baseline(), effects), EffectModel.build(baseline(), effects[::-1])
        assert one.effects == other.effects
        problem = one.problem(later(one))
        period = SOLVER.solve(problem, solved())
        assert period.residual_history[-1] < 1e-12
        factor = one.wear_factor(respond(period, problem.interface), later(one))
        assert np.all(np.isfinite(factor))
        if effects[0].acts_at != effects[1].acts_at:
            continue
        there, back = (reduce(lambda changed, effect: effect.period(changed, later(one)), order, baseline())
                       for order in (effects, effects[::-1]))
        assert np.broadcast_to(there.friction_coefficient, 9) == pytest.approx(
            np.broadcast_to(back.friction_coefficient, 9), rel=1e-12)
        assert there.interface.gap == pytest.approx(back.interface.gap, abs=1e-18)
        assert there.law.asymmetry == pytest.approx(back.law.asymmetry)


@pytest.mark.parametrize("name", IDS)
def test_a_case_file_keeps_every_parameter(name):
    effect = modest(catalogue()[name])
    assert parse_effects(tables([effect])) == (effect,)


@pytest.mark.parametrize("name", IDS)
def test_the_sheet_is_complete(name):
    kind = catalogue()[name]
    assert kind.priors()
    for prior in kind.priors().values():
        assert prior.low < prior.high
        assert prior.source
    sketch = kind().sketch()
    assert sketch.curves
    for x, y in sketch.curves.values():
        assert len(x) == len(y)
        assert np.all(np.isfinite(y))
    assert kind.source
    assert kind.equation
    assert kind.observables
