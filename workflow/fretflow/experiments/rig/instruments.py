"""Faults of the instruments, told from the raw loops in no time: no physics is looked for behind them.

A channel that saturates repeats its largest value to the last digit. Unit, gain, sign and delay follow from the rig
alone, whatever the contact does: with the rig's receptances H, block b, arm a, each loop's fundamentals satisfy ::

    H_ab excitation = x / g_x + (H_aa + c) F / g_F

where c is the specimens' compliance; over loops of several amplitudes, loads and frequencies x and F are independent,
and the complex gains g_x and g_F are fitted, at first without c. Soft specimens, of which c is not small beside H_aa,
and what is off by less than a unit or a sign are told by the same equations at more harmonics with c in them, see
`equations`, where repeats tell their errors.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import stats

from fretflow.case.config import Case
from fretflow.case.plausibility import PLAUSIBLE
from fretflow.core.errors import FretflowError
from fretflow.core.records import Array
from fretflow.core.units import pretty_quantity
from fretflow.effects.channel_delay import ChannelDelay
from fretflow.effects.sensor_drift import SensorDrift
from fretflow.experiments.rig.equations import (
    DELAYS,
    GAINS,
    Complex,
    Equations,
    Solution,
    Unknown,
    blocks_of,
    further_forces,
    is_periodic,
)
from fretflow.experiments.rig.hum import MAINS, hum_begun_anew, hum_between_repeats
from fretflow.experiments.rig.observation import CHANNELS, SYNCHRONISED
from fretflow.experiments.rig.setup import FRICTION, first_friction, first_wear, friction_from_energy
from fretflow.inference.parameters import HALF
from fretflow.recordings.loopset import LoopSet, plateau
from fretflow.recordings.periods import LEVEL, is_noisy, standing_still
from fretflow.recordings.plausibility import STATED
from fretflow.recordings.recording import Recording
from fretflow.structure.two_mass_rig.lumped import LumpedRig

LEFT = 0.1  # of what the equations miss: gains that leave more than a hundredth of its square do not explain it
WORDS = {"displacement": "displacement", "friction_force": "friction force", "force": "friction force",
         "excitation": "excitation", "normal_force": "normal force", "approach": "approach"}
UNITS = {"displacement": "m", "approach": "m"}  # of the others newtons


def faults(recording: Recording, case: Case) -> tuple[str, ...]:
    """Return what is wrong with the channels of a recording of the rig, in words; nothing where all may be right."""
    blocks = [recording.loops, None if recording.sweep is None else recording.sweep.loops]
    known = [loops for loops in blocks if loops is not None]
    saturated = [text for loops in known for text in _saturated(loops)]
    if saturated or not known:
        return tuple(saturated[:1])
    implausible = [*_unless_singular(_gains, recording, case), *_friction(recording)] or _wear(recording)
    checks = (_late, _humming, _drifting, lambda *asked: _small_gains(*asked)[0], _drifting_zero)
    told = (_unless_singular(check, recording, case) for check in checks)
    return tuple(implausible or next(filter(None, told), []))


def doubts(recording: Recording, case: Case) -> tuple[str, ...]:
    """Return what may be a fault of the displacement or of what the file states of the rig: both explain the same."""
    if recording.loops is None:
        return ()
    return tuple(_unless_singular(lambda *asked: _small_gains(*asked)[1], recording, case))


def _unless_singular(check: Callable[[Recording, Case], list[str]], recording: Recording, case: Case) -> list[str]:
    """Return what a check tells; nothing where the recording is too little for its equations."""
    try:
        return check(recording, case)
    except (FretflowError, np.linalg.LinAlgError):
        return []


def _saturated(loops: LoopSet) -> list[str]:
    """Return the channels that stand still at an extreme value; none where nothing has noise as sensors have."""
    texts = []
    for name in [name for name in loops.channels if name in WORDS and any(map(is_noisy, map(
            np.ravel, loops.channels.values())))]:
        values = loops.channels[name]
        if (still := standing_still(values)).any():
            limit = pretty_quantity(float(np.abs(values[still]).max()), UNITS.get(name, "N"), 3)
            texts.append(f"the {WORDS[name]} saturates at {limit} in "
                         f"{100.0 * still.sum() / np.isfinite(values).sum():.0f} % of the samples")
    return texts


def _gains(recording: Recording, case: Case) -> list[str]:
    """Return which of displacement and force contradict the rig's periodic motion by more than a stated value may."""
    rows = _fundamentals(recording)
    mistakes = {"excitation and friction force are swapped: the rig's equations of motion hold the other way round":
                rows[:, [2, 1, 0, 3]]} | {
        f"the {name} is recorded with its sign reversed": rows * np.where(np.arange(rows.shape[1]) == column, -1.0, 1.0)
        for column, name in enumerate(("excitation", "displacement", "friction force"))}
    likeliest = min(mistakes, key=lambda text: _left(mistakes[text], case))
    if _left(mistakes[likeliest], case) < LEFT * _left(rows, case):
        return [likeliest]
    if recording.loops is not None and not is_periodic(recording.loops):
        return []
    gains = _fitted_gains(rows, case)
    if gains is None or all(1.0 / STATED < abs(gain) < STATED for gain in gains):
        return []
    equations = Equations.of(recording, LumpedRig.of(case.rig))
    if equations is not None and equations.repeated:  # these know how much the specimens yield
        if not (known := equations.solve()).holds:
            return []  # a play or spring besides
        gains = 1.0 / known.values[GAINS]
    return [f"the {name} is {abs(gain):.3g} times what the rig's masses and springs let the excitation make of it: "
            "check its unit and gain" for name, gain in zip(("displacement", "friction force"), gains, strict=True)
            if not 1.0 / STATED < abs(gain) < STATED]


def _terms(rows: Array, case: Case) -> tuple[Array, Array]:
    """Return what the excitation makes of the rig (K,) and what displacement and force (K, 2) do, of fundamentals."""
    drive, x, force, omega = rows.T
    receptance = np.linalg.inv(LumpedRig.of(case.rig).impedance(omega.real))
    return receptance[:, 1, 0] * drive, np.column_stack([x, receptance[:, 1, 1] * force])


def _left(rows: Array, case: Case) -> float:
    wanted, terms = _terms(rows, case)
    return float(np.linalg.norm(wanted - terms.sum(axis=1)))


def _fitted_gains(rows: Array, case: Case) -> Array | None:
    """Return complex gains of displacement and force that explain the fundamentals (K, 4); None if none do."""
    if len(rows) < 3:
        return None
    wanted, terms = _terms(rows, case)
    if np.linalg.cond(terms / np.linalg.norm(terms, axis=0)) > 1.0 / np.sqrt(np.finfo(np.float32).eps):
        return None
    inverse = np.linalg.lstsq(terms, wanted, rcond=None)[0]
    if np.linalg.norm(wanted - terms @ inverse) > LEFT * _left(rows, case):
        return None  # with other gains the equations hold no better: there are further forces on the rig
    return np.asarray(1.0 / inverse)


def _late(recording: Recording, case: Case) -> list[str]:
    """Return the channel that comes early or late, if the equations of motion hold without that.

    What the catalogue's delay of the force may be is no fault.
    """
    if (equations := Equations.of(recording, LumpedRig.of(case.rig))) is None:
        return []
    rows = _fundamentals(recording)
    gains, period = _fitted_gains(rows, case), 2.0 * np.pi / np.median(rows[:, 3].real)
    guesses = [np.zeros(2)] + ([] if gains is None else [-np.angle(gains) * period / (2.0 * np.pi)])
    tried = map(equations.synchronised, guesses if equations.repeated else [])
    late, solution = next((one for one in tried if one is not None and one[1].holds), (guesses[-1], None))
    if solution is None and equations.repeated:
        return []  # more acts on the rig than a delay, which may turn the fundamentals as one does
    if solution is None:  # nothing tells the errors: the fundamentals tell large delays alone
        off = np.abs(late) > ChannelDelay.priors()["delay"].high
    else:
        covariance, known = solution.covariance[np.ix_(DELAYS, DELAYS)], (SYNCHRONISED * period)**2
        off = np.array([solution.is_off(late[k], covariance[k, k], known) for k in (0, 1)])
        across = np.array([1.0, -1.0])
        if off.all() and not solution.is_off(float(across @ late), float(across @ covariance @ across), 2.0 * known):
            return [_comes("excitation", -float(np.mean(late)), "the other channels")]
        off[1] &= abs(late[1]) > ChannelDelay.priors()["delay"].high
    return [_comes(name, float(late[k]), "the excitation")
            for k, name in enumerate(("displacement", "friction force")) if off[k]]


def _comes(name: str, late: float, against: str) -> str:
    return (f"the {name} comes {1e6 * abs(late):.0f} µs {'late' if late > 0.0 else 'early'} against {against}: "
            "check the filters and the sampling of the channels")


def _humming(recording: Recording, case: Case) -> list[str]:
    """Return the channel that has the hum of the mains in all of its samples, if one alone has.

    A force of that frequency would move the arm, and a motion the force: both have it then, or differ otherwise too,
    except for the drive's own. A period is too short to tell 50 from 60 Hz.
    """
    blocks = blocks_of(recording)
    seen = {name: [hum_between_repeats(blocks, name, mains) for mains in MAINS]
            for name in WORDS if all(name in one.channels for one, _ in blocks)}
    known = {name: hums for name, hums in seen.items() if None not in hums}
    loud = [name for name, hums in known.items()
            if min(one[0] for one in hums if one is not None) < LEVEL / (len(MAINS) * len(seen))]
    unknown = {"displacement", "friction_force", "force"} & (set(seen) - set(known))
    if len(loud) == 1 and len(seen) > 1 and (loud == ["excitation"] or not unknown):
        (name,) = loud
        sizes = sorted(one[1] for one in known[name] if one is not None)
    elif not loud and (equations := Equations.of(recording, LumpedRig.of(case.rig))) is not None:
        told = [one for mains in MAINS if (one := hum_begun_anew(recording, equations, mains)) is not None]
        name = max(told)[1] if told else ""
        sizes = sorted(size for _, own, size in told if own == name)
    else:
        return []
    if not sizes:
        return []
    low, high = (pretty_quantity(size, UNITS.get(name, "N"), 3) for size in (sizes[0], sizes[-1]))
    return [f"the {WORDS[name]} has a hum of the mains, {low} to {high} in all samples"]


def _drifting(recording: Recording, case: Case) -> list[str]:
    """Return the channel whose gain changes over the test, if one real gain a cycle count makes the equations hold.

    Specimens on which wear spreads the pressure otherwise yield otherwise: that is no gain, and has to explain less.
    """
    equations = Equations.of(recording, LumpedRig.of(case.rig))
    if equations is None or recording.loops is None or (plain := equations.solve()).holds:
        return []
    counts, fitted = np.unique(equations.cycles), []

    def by_count(term: Complex) -> Solution:
        return equations.solve([np.where(equations.cycles == count, term, 0.0) for count in counts[1:]])

    yielding = by_count(equations.force)
    for name in ("displacement", "friction force", "excitation"):
        free = plain
        for _ in range(2 if name == "friction force" else 1):  # its gain acts on what the specimens yield too
            own = {"displacement": equations.displacement, "excitation": equations.drive,
                   "friction force": equations.friction + free.values[Unknown.COMPLIANCE] * equations.force}[name]
            free = by_count(own)
        stated = recording.loops.calibration_sd.get(name.replace(" ", "_"), 0.0)
        if (free.holds and free.better_than(plain) and LEVEL * free.odds_over(yielding) > 1.0
                and free.is_off(free.values[-1], free.covariance[-1, -1], stated**2)):
            fitted.append((free.lack_of_fit, name, free))
    if not fitted:
        return []
    _, name, best = max(fitted, key=lambda one: one[0])
    first = {"displacement": best.values[Unknown.DISPLACEMENT], "friction force": best.values[Unknown.FORCE],
             "excitation": -1.0}[name]
    gain = first / (first + best.values[-1])
    return [f"the gain of the {name} drifts: at {int(counts[-1]):,} cycles it is {gain:.3g} times that at "
            f"{int(counts[0]):,}"]


def _small_gains(recording: Recording, case: Case) -> tuple[list[str], list[str]]:
    """Return gains that the equations of motion contradict, and those that another moving mass explains as well."""
    equations = Equations.of(recording, LumpedRig.of(case.rig))
    if equations is None or recording.loops is None or not (solution := equations.solve()).holds:
        return [], []
    loops = recording.loops
    stated = [loops.calibration_sd.get(name, 0.0) for name in ("displacement", loops.force_name)]

    def off(solved: Solution) -> list[bool]:
        """Tell which gains are, whether repeats differ by errors alone or by friction of their own."""
        return [all(solved.is_off(gain - 1.0, solved.covariance[k, k], own**2) for gain in (
            solved.values[k], solved.values[k] - solved.attenuated[k])) for k, own in zip(GAINS, stated, strict=True)]

    x, force = solution.values[GAINS]
    covariance, across = solution.covariance[np.ix_(GAINS, GAINS)], np.array([1.0, -1.0])
    apart, both = float(across @ covariance @ across), float(np.sum(np.square(stated)))
    bent = equations.solve(further_forces(recording, equations))  # which gains may stand in for
    wrong = [one and other for one, other in zip(off(solution), off(bent), strict=True)]
    sd = np.sqrt(np.diag(covariance) + np.square(stated))
    if all(wrong) and not solution.is_off(x - force, apart, both):
        return [_gain("excitation", x, sd[0])], []
    told = [_gain("friction force", 1.0 / force, sd[1] / force**2)] if wrong[1] else []
    mass, arm = case.rig.moving_mass, case.rig.arm_mass
    heavier = (x - 1.0) * (mass + arm) / mass  # with the same in-phase frequency, all receptances go with the total
    return told, [f"the moving mass would be {100.0 * abs(heavier):.2g} % {'above' if heavier > 0.0 else 'below'} the "
                  f"file's: a displacement gain of {1.0 / x:.3g} explains the same"] if wrong[0] else []


def _drifting_zero(recording: Recording, case: Case) -> list[str]:
    """Return the channel whose zero drifts over the test, if means of the loops contradict the rig at rest without it.

    Means obey ``H_ab excitation = x + H_aa F + a constant`` at zero frequency. What the catalogue's drift of the force
    may be is no fault, nor is a channel that has no mean at all.
    """
    loops = recording.loops
    if loops is None or "excitation" not in loops.channels:
        return []
    there = np.flatnonzero(loops.repeats)
    rest = np.linalg.inv(LumpedRig.of(case.rig).stiffness)[1]
    sizes = {"displacement": 1.0, loops.force_name: rest[1], "excitation": -rest[0]}
    signals = {name: loops.mean(name)[there] for name in sizes}
    means = {name: size * signals[name].mean(axis=1) for name, size in sizes.items()}
    zeros = [CHANNELS[own].by_loop * abs(sizes[name]) * np.ptp(signals[name], axis=1).max() / 2.0
             for own, name in (("displacement", "displacement"), ("friction_force", loops.force_name))]
    allowed = float(np.hypot(*zeros) * stats.norm.isf(LEVEL / 2.0))
    cycles = loops.cycles[there].astype(float)
    total = sum(means.values())
    drifting = [name for name in means if _drifts(cycles, total, allowed) and _drifts(cycles, means[name], allowed)
                and not _drifts(cycles, total - means[name], allowed)]
    if len(drifting) != 1 or not np.ptp(means["displacement"]) or not np.ptp(means[loops.force_name]):
        return []
    (name,) = drifting
    by = float(means[name][-1] - means[name][0]) / sizes[name]
    if name == loops.force_name and abs(by) <= SensorDrift.priors()["drift"].high:
        return []
    return [f"the zero of the {WORDS[name]} drifts by {pretty_quantity(by, UNITS.get(name, 'N'), 3)} over the test"]


def _drifts(cycles: Array, values: Array, allowed: float) -> bool:
    """Tell whether values (K,) rise or fall with the cycles by more than chance makes, and than is lost anyway."""
    line = stats.linregress(cycles, values)
    return bool(abs(line.slope) * np.ptp(cycles) > allowed and line.pvalue < LEVEL)


def _gain(name: str, gain: float, sd: float) -> str:
    half = HALF * sd
    return (f"the {name} is {gain:.3g} times what the rig's masses and springs make of the other channels "
            f"({gain - half:.3g} to {gain + half:.3g}): check its gain")


def _fundamentals(recording: Recording) -> Array:
    """Return drive, displacement, force (complex amplitudes) and angular frequency of all loops, (K, 4).

    K is zero without a record of the drive: a stated amplitude has no phase.
    """
    tables = [np.zeros((0, 4), dtype=complex)]
    for loops, frequency in blocks_of(recording):
        if "excitation" in loops.channels:
            lines = [np.fft.rfft(loops.mean(name), axis=1)[:, 1] * 2.0 / len(loops.phase)
                     for name in ("excitation", "displacement", loops.force_name)]
            tables.append(np.column_stack([*lines, 2.0 * np.pi * frequency]))
    rows = np.concatenate(tables)
    return np.asarray(rows[np.isfinite(rows).all(axis=1)])


def _friction(recording: Recording) -> list[str]:
    """Return whether the force is beyond what any dry contact has under the load in all loops.

    A force that rings has high peaks, and dissipates no more for them.
    """
    loops, load = recording.loops, recording.test.normal_load
    if loops is None or not load:
        return []
    ratio = plateau(loops.mean(loops.force_name)) / load
    least, most = float(np.nanmin(ratio)), float(np.nanmax(ratio))
    if most < FRICTION[0] or (least > FRICTION[1] and friction_from_energy(recording) >= FRICTION[1]):
        return [f"the friction force is {0.5 * (least + most):.2g} times the normal load, which no dry contact has: "
                "check the units of the force and of normal_load"]
    return []


def _wear(recording: Recording) -> list[str]:
    """Return whether the worn volume is beyond what any joint wears by the energy that its loops dissipate."""
    volume = recording.wear.worn_volume
    if volume is None:
        return []
    spread = 2.0 * (recording.wear.worn_volume_sd or 0.0) / volume
    coefficient = first_wear(recording, first_friction(recording))
    least, most = PLAUSIBLE["wear.coefficient"]
    if least <= (1.0 + spread) * coefficient and (1.0 - spread) * coefficient <= most:
        return []
    worn, low, high = (pretty_quantity(value, "m^2/N", 2) for value in (coefficient, least, most))
    return [f"the worn volume would be that of a wear coefficient of {worn}, which no joint has ({low} to {high}): "
            "check its unit and that of the cycles, which may be counted in thousands"]
