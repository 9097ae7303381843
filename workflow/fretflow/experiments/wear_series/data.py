"""A wear series as its diagnosis takes it: states, tests that stand twice, repeats, and how scatter grows with wear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fretflow.core.errors import UnreliableRecordingError
from fretflow.core.records import Array
from fretflow.effects.volume_law import CYCLES, FREQUENCY, POWER, PRESSURE, SLIDING
from fretflow.experiments.independent import FREEDOM
from fretflow.experiments.wear_series.scatter import POWERS, Tests, curve_square, power_designs
from fretflow.recordings.kinds.wear_series import WearSeries
from fretflow.recordings.notes import row_ranges, rows_in_words

Ids = NDArray[np.int64]

ALIKE = 1.3  # largest over smallest value of a condition that does not vary, or of what is measured between repeats


@dataclass(frozen=True)
class WearData:
    """Tests with their conditions; `condition` tells repeats and rows that stand twice, (n,)."""

    series: WearSeries
    tests: Tests
    condition: Ids
    varied: tuple[str, ...]  # states that vary
    base_power: float  # lambda under which the baseline is most probable
    pure_freedom: int  # degrees of freedom among repeats
    curve: Array  # (n, k) columns of a curve through whatever was recorded
    sd: float  # of h(V) by scatter, m^3
    sd_from: str
    notes: tuple[str, ...]


def wear_data(series: WearSeries) -> WearData:
    """Return a wear series as its diagnosis takes it.

    Raises
    ------
    UnreliableRecordingError
        If it has too few conditions.
    """
    states, notes = _states(series)
    varied = tuple(name for name, x in states.items() if x.max() > ALIKE * x.min())
    condition = _conditions(series)
    twice = _twice(series, condition)
    weight = 1.0 / np.bincount(twice)[twice]
    if (count := len(np.unique(condition))) < FREEDOM:
        raise UnreliableRecordingError(f"{series.path}: {count} different conditions are too few for a law of wear, at "
                                       f"least {FREEDOM} are needed; add tests")
    if (repeated := weight < 1.0).any():
        notes.append(f"{rows_in_words(row_ranges(series.rows[repeated] - 1))} repeat the volume and energy of another "
                     "row at the same conditions: such a test counts once")
        notes += _that_differ(series, twice)
    if series.volume_sd is not None:  # of the relative scatter that they state
        precise = (series.volume / series.volume_sd)**2
        weight = weight * precise / np.average(precise, weights=weight)
    tests = Tests(series.volume, series.energy, states, varied, weight)
    tests = replace(tests, scale=float(np.exp(np.average(np.log(tests.volume), weights=weight))))
    curve = _curve(tests, varied, series.further)
    power = base_power = 0.0
    if series.volume_sd is None:
        designs = list(power_designs(tests).values())
        power, base_power = _power(tests, [curve, *designs]), _power(tests, designs[:1])
        tests = replace(tests, power=power)
    square, freedom = _repeats(tests, condition)
    if freedom >= FREEDOM:
        sd, source = float(np.sqrt(square / freedom)), f"repeated tests, {freedom} degrees of freedom"
    else:
        left = tests.count - curve.shape[1]
        sd = float(np.sqrt(curve_square(curve, tests) / left))
        source = ("a smooth curve through all columns, as there are " + (
            f"only {freedom} degree{'s' * (freedom > 1)} of freedom among repeats" if freedom else "no repeated tests")
            + ": what no column tells counts as scatter")
    return WearData(series, tests, condition, varied, base_power, freedom, curve, sd, source, tuple(notes))


def _states(series: WearSeries) -> tuple[dict[str, Array], list[str]]:
    given, notes = series.states, []
    states: dict[str, Array] = {}
    if "pressure" in given:
        states[PRESSURE] = given["pressure"]
    elif "load" in given:
        states[PRESSURE] = given["load"]
        notes.append("no pressure is given: the load stands for it, as for one area of contact")
    if "amplitude" in given:
        states[SLIDING] = 4.0 * given["amplitude"]  # there and back, twice a cycle
    elif {"sliding_distance", "cycles"} <= set(given):
        states[SLIDING] = given["sliding_distance"] / given["cycles"]
    if "frequency" in given:
        states[FREQUENCY] = given["frequency"]
    if "power_density" in given:
        states[POWER] = given["power_density"]
    elif "pressure" in given and {SLIDING, FREQUENCY} <= set(states):
        states[POWER] = states[PRESSURE] * states[SLIDING] * states[FREQUENCY]
        notes.append("no power density is given: pressure times mean speed stands for it, without the friction "
                     "coefficient")
    if "cycles" in given:
        states[CYCLES] = given["cycles"]
    return states, notes


def _conditions(series: WearSeries) -> Ids:
    """Return which set conditions each test has, (n,); what is measured, such as power, is none if another is set."""
    own = {name: x for name, x in series.states.items() if name != "power_density"} or dict(series.states)
    columns = [np.log(x) for x in own.values()] + [np.nan_to_num(x) for x in series.further.values()]
    columns = columns or [np.log(series.energy)]  # all that tells one test from another
    table = np.stack([np.round(x / max(np.abs(x).max(), 1e-300), 9) for x in columns], axis=1)
    return np.asarray(np.unique(table, axis=0, return_inverse=True)[1]).ravel()


def _twice(series: WearSeries, condition: Ids) -> Ids:
    """Return an id of each test, (n,), the same for rows that state one test again: conditions, volume and energy."""
    table = np.stack([condition, *(np.unique(np.round(np.log(x), 9), return_inverse=True)[1].ravel()
                                   for x in (series.volume, series.energy))], axis=1)
    return np.asarray(np.unique(table, axis=0, return_inverse=True)[1]).ravel()


def _that_differ(series: WearSeries, twice: Ids) -> list[str]:
    """Return which rows state one test but differ in a condition."""
    notes = []
    for name, x in series.states.items():
        apart = [k for k in np.unique(twice) if np.ptp(np.log(x[twice == k])) > np.finfo(np.float32).eps]
        if apart:
            rows = rows_in_words(row_ranges(series.rows[np.isin(twice, apart)] - 1))
            notes.append(f"{rows}: among them are tests that stand twice with different {name.replace('_', ' ')}")
    return notes


def _repeats(tests: Tests, condition: Ids) -> tuple[float, int]:
    """Return the sum of squares of repeats about their means, scaled to one energy, and its degrees of freedom."""
    square, freedom = 0.0, 0
    for k in np.unique(condition):
        own = condition == k
        measured = [tests.energy] + ([tests.states[POWER]] if POWER in tests.states else [])
        count = float(np.count_nonzero(np.unique(np.round(np.log(tests.volume[own]), 9)) < np.inf))
        if count < 2 or any(x[own].max() > ALIKE * x[own].min() for x in measured):
            continue
        scaled = tests.transformed(tests.volume[own] * tests.energy[own].mean() / tests.energy[own])
        weight = tests.weight[own]
        square += float(weight @ (scaled - np.average(scaled, weights=weight))**2)
        freedom += int(count) - 1
    return square, freedom


def _curve(tests: Tests, varied: tuple[str, ...], further: Mapping[str, Array]) -> Array:
    """Return the columns (n, k) of a curve through whatever was recorded, as many as the tests can bear."""
    logs = [np.log(tests.states[name]) for name in varied] + [np.log(tests.energy)]
    more = [np.log(x) if np.all(x > 0.0) else x for x in further.values() if np.isfinite(x).all() and np.ptp(x) > 0.0]
    squares = [(x - x.mean())**2 for x in logs]
    kept = [np.ones(len(tests.energy))]
    for column in (*logs, *squares, *more):
        wider = np.stack([*kept, _standard(column)], axis=1)
        if tests.count - wider.shape[1] < FREEDOM:
            break
        if np.linalg.svd(wider / np.linalg.norm(wider, axis=0), compute_uv=False)[-1] > 1e-3:
            kept.append(wider[:, -1])
    return np.stack(kept, axis=1)


def _standard(x: Array) -> Array:
    return np.asarray((x - x.mean()) / max(float(x.std()), 1e-300))


def _power(tests: Tests, designs: Sequence[Array]) -> float:
    """Return the lambda of the law, or curve, and lambda that are most probable together."""
    best = {}
    for power in POWERS:
        one = replace(tests, power=power)
        best[power] = max(_log_evidence(curve_square(own, one), own.shape[1], one) for own in designs)
    return max(best, key=lambda power: best[power])


def scatter_odds(data: WearData, powers: tuple[str, ...], power: float) -> float:
    """Return how many times less probable a law with `powers` of states is if scatter grew with another `power`."""
    design = power_designs(data.tests)[powers]
    own, other = (_log_evidence(curve_square(design, one), design.shape[1], one)
                  for one in (data.tests, replace(data.tests, power=power)))
    return float(np.exp(own - other))


def _log_evidence(square: float, size: int, tests: Tests) -> float:
    """Return log Z of a fit with `size` parameters up to a constant.

    A parameter costs what G. Schwarz, Ann. Stat. 6 (1978) 461-464 asks, or where that is more, among few tests, what
    C. M. Hurvich, C.-L. Tsai, Biometrika 76 (1989) 297-307 ask.
    """
    n = tests.count
    cost = max(0.5 * np.log(n), n / max(n - size - 2.0, 0.1))
    return float(-0.5 * n * np.log(max(square / tests.scale**2, 1e-24)) - cost * size)


def tests_of_detection(data: WearData) -> dict[str, float]:
    """Return the p-values of tests of one coefficient against the data, by name, not corrected.

    Each is the larger one of two growths of scatter: that of the most probable law, and that of the baseline, so that
    no law makes itself probable by a growth of its own.
    """
    base = replace(data.tests, power=data.base_power)
    p_values = _tests(data, data.tests)
    return {name: max(p, p_values[name]) for name, p in _tests(data, base).items()}


def growths(data: WearData, model: Array) -> tuple[tuple[Array, float], ...]:
    """Return what a `model` (n,) leaves, (n,) m^3, and its scatter in m^3, with both of these growths of scatter."""
    base = replace(data.tests, power=data.base_power)
    left, free = base.residual(model), data.tests.count - data.curve.shape[1]
    left = left - np.average(left, weights=base.weight)  # its coefficient fitted with this growth
    square, freedom = _repeats(base, data.condition)
    sd = square / freedom if freedom >= FREEDOM else curve_square(data.curve, base) / free
    return (data.tests.residual(model), data.sd), (left, float(np.sqrt(sd)))


def _tests(data: WearData, tests: Tests) -> dict[str, float]:
    p_values: dict[str, float] = {}
    designs = power_designs(tests)
    base = curve_square(designs[()], tests)
    names = max(designs, key=len)
    lacks, least = designs[names].shape[1], curve_square(designs[names], tests)
    if names:
        p_values[f"powers of {', '.join(names)}"] = _f_test(base, least, lacks - 1, tests.count - lacks)
    free = tests.count - data.curve.shape[1]
    if data.curve.shape[1] > lacks and free > 0:
        p_values["curve through all columns"] = _f_test(least, min(least, curve_square(data.curve, tests)),
                                                        data.curve.shape[1] - lacks, free)
    square, freedom = _repeats(tests, data.condition)
    if freedom:
        p_values["lack of fit against repeats"] = _f_test(base, min(square, base), tests.count - 1.0 - freedom, freedom)
    return p_values


def _f_test(fewer: float, more: float, added: float, free: float) -> float:
    if added <= 0.0 or free <= 0.0:
        return 1.0
    ratio = max(fewer - more, 0.0) / added / max(more / free, 1e-12 * fewer, 1e-300)
    return float(stats.f.sf(ratio, added, free))
