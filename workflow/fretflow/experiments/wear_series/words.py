"""What is said of a wear series' diagnosis: the sentence, what to measure next, warnings, the case with the effects."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from fretflow.core.units import format_quantity
from fretflow.effects.catalogue import catalogue, tables
from fretflow.effects.effect import Effect, declared_priors
from fretflow.effects.volume_law import UNITS
from fretflow.experiments.wear_series.laws import Law, LawFit, fit
from fretflow.experiments.wear_series.search import Search, other_powers, together
from fretflow.inference.verdict import EXPLAINED_GATE, Estimate, ResidualLaw, Verdict
from fretflow.inference.words import listed
from fretflow.inference.words import separating as between


def sentence(verdict: Verdict, effects: Sequence[str], law: Law, share: float, fits: tuple[float, float],
             left: ResidualLaw | None) -> str:
    """Return the verdict in one sentence; `fits` are R2 before and after."""
    one = f"One wear coefficient gives R2 = {fits[0]:.2f} of the worn volumes"
    if verdict is Verdict.NONE:
        return f"{one}, within their scatter: no condition changes it."
    explained = f"explains {100.0 * share:.0f} % of what that leaves beyond scatter (R2 = {fits[1]:.2f})"
    if verdict is Verdict.NAMED:
        of = f" of {listed(law.states)}" if law.states else ""
        return f"{one}; {listed(effects)}{of} {explained}."
    if verdict is Verdict.AMBIGUOUS:
        return f"{one}; one of {listed(effects, 'or')} {explained}, and these tests cannot tell which."
    told = "" if left is None or left.explained < 0.2 else f", which follows the {left.state}"
    best = f"the best of the catalogue, {listed(law.effects)}, {explained}" if law.effects else "no effect explains it"
    return f"{one}; something that is not in the catalogue changes the wear{told}: {best}."


def separating(sets: Sequence[Sequence[str]], looked: Search, found: LawFit, left: ResidualLaw | None) -> str:
    """Return the measurement that would tell alternatives apart, or more of what is left."""
    if left is not None:
        return (f"Tests at further values of the {left.state} with all else the same, each repeated three times, to "
                "see whether what is left follows it.")
    if len(sets) > 1:
        return between(sets)
    mixed = [pair for pair in together(looked.data) if set(pair) & set(found.law.states)] if sets else []
    if mixed:
        return f"Tests that change {mixed[0][0]} and {mixed[0][1]} apart, to tell whose power it is."
    rivals = other_powers(looked, found) if sets else ()
    if rivals:
        return (f"Tests that change the {listed(found.law.states)} and keep the {listed(rivals[0].law.states)}, or the "
                "reverse, to tell whose power it is.")
    return ""


def warnings(looked: Search, found: LawFit, verdict: Verdict, made: Iterable[Estimate]) -> tuple[str, ...]:
    """Return what limits the diagnosis."""
    data, tests = looked.data, looked.data.tests
    grows = {0.0: "in proportion to the volume", 1.0: "not at all with the volume"}.get(
        tests.power, f"as the power {1.0 - tests.power:g} of the volume")
    notes = [*map(str, data.series.notes), *data.notes,
             f"scatter: {data.sd / tests.scale:.2g} of the volume at {1e9 * tests.scale:.3g} mm^3, growing {grows}; "
             f"from {data.sd_from}"]
    notes += [f"{one} and {other} vary together in these tests, so that their powers are not known apart"
              for one, other in together(data)]
    if verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
        return tuple(notes)
    notes += [f"powers of {listed(one.law.states)} instead of {listed(found.law.states)} explain "
              f"{100.0 * looked.explained(one):.0f} %, about as well" for one in other_powers(looked, found)]
    for one in made:
        effect, _, field = one.name.rpartition(".")
        prior = declared_priors(catalogue()[effect]).get(field) if effect in catalogue() else None
        if field.endswith("_exponent") and prior is not None and not prior.low <= one.value <= prior.high:
            notes.append(f"{one.name} = {one.value:.2f} lies beyond the plausible {prior.low:g} to {prior.high:g}")
    return (*notes, *_by_scatter(looked, found))


def _by_scatter(looked: Search, found: LawFit) -> list[str]:
    """Return a warning where another growth of the scatter would leave the law without a name."""
    notes = []
    for power, words in ((0.0, "in proportion to the volume"), (1.0, "not at all with the volume")):
        tests = replace(looked.data.tests, power=power)
        before, after = (fit(law, tests) for law in (Law(), found.law))
        share = 1.0 - after.square / before.square
        if share < 0.5 * EXPLAINED_GATE or _apart(found, after):
            powers = ", ".join(f"{name} {a:.2f}" for name, a in zip(found.law.states, after.value[1:], strict=False))
            notes.append(f"if scatter grew {words}, the law would remove {100.0 * share:.0f} % of all squares"
                         + (f", with the powers {powers}" if powers else ""))
    return notes


def _apart(one: LawFit, other: LawFit) -> bool:
    count = len(one.law.states)
    return bool(np.any(np.abs(one.value[1:1 + count] - other.value[1:1 + count]) > 0.2))


def case_text(title: str, found: LawFit, made: Sequence[Estimate]) -> str:
    """Return the effects as tables of a case file; what a case needs beyond the tests stands in comments."""
    values = {one.name: one.value for one in made}
    lines = [f"# {line}" for line in (
        "The effects that the diagnosis named, as tables of a case file; the parameters are those of the fit.",
        "A wear series holds no rig, specimens or mesh: `fretflow run` needs these tables in a whole case.",
        f"recording: {title}".replace("\n", " "),
        f"{made[0].name} = {made[0].value:.6g} {made[0].unit}: {made[0].meaning}")]
    effects: list[Effect] = []
    for law in found.law.laws:
        own = {parameter.name: _rounded(values[f"{law.effect}.{parameter.name}"]) for parameter in law.parameters}
        if (effect := law.built(own)) is not None:
            effects.append(effect)
        else:
            lines += [f"# {law.effect}: {law.needs.format(**own)}"]
    for name, table in tables(effects).items():
        lines += ["", f"[effects.{name}]"]
        lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}"
                  for key, value in table.items()]
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def within(name: str, low: float, high: float) -> str:
    """Return a range of a condition for people."""
    unit = UNITS.get(name, "")
    ends = [format_quantity(v, unit, 3) if unit not in ("", "1") else f"{v:,.6g}" for v in (low, high)]
    return f"{name} {ends[0]}" if ends[0] == ends[1] else f"{name} {ends[0]} to {ends[1]}"
