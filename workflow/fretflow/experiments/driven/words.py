"""What is said of a driven joint's diagnosis: the sentence, what to measure next, the case that documents the model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fretflow.case.casefile import entries
from fretflow.effects.catalogue import tables
from fretflow.effects.driven import DrivenJoint
from fretflow.inference.verdict import Location, ResidualLaw, Verdict
from fretflow.inference.words import blocks_of as blocks_of
from fretflow.inference.words import listed as listed
from fretflow.inference.words import separating as separating


def sentence(verdict: Verdict, chosen: Iterable[str], stand_ins: Mapping[str, tuple[str, ...]], share: float,
             location: Location, law: ResidualLaw | None) -> str:
    """Return the verdict in one sentence."""
    if verdict is Verdict.NONE:
        return "The baseline with its own parameters refitted explains the recording within what its cycles differ by."
    if verdict is Verdict.NAMED:
        many = "explain" if len(list(chosen)) > 1 else "explains"
        return f"The model leaves out {listed(chosen)}, which {many} {100.0 * share:.0f} % of what the baseline leaves."
    if verdict is Verdict.AMBIGUOUS:
        sure = [name for name in chosen if not stand_ins.get(name)]
        either = "; ".join(listed((name, *stand_ins[name]), "or") for name in sorted(chosen) if stand_ins.get(name))
        also = f"{listed(sure)}, and " if sure else ""
        return f"The model leaves out {also}one of {either}, which act alike on this recording; " \
               f"{100.0 * share:.0f} % of what the baseline leaves is explained."
    best = "no effect of it earns a place"
    if list(chosen):
        best = f"the best of it, {listed(chosen)}, explains {100.0 * share:.0f} % of what the baseline leaves"
    told = "" if law is None or law.explained < 0.2 else f"; what is left follows the {law.state}"
    return f"Something that is not in the catalogue acts on the force in the phase '{location.phase}': {best}{told}."


def next_measurement(law: ResidualLaw) -> str:
    """Return what to measure where nothing of the catalogue fits."""
    return (f"Records at other amplitudes and frequencies, to see whether what is left still follows the {law.state}, "
            "and at another normal load, to see whether it belongs to the friction.")


def case_text(title: str, joint: DrivenJoint) -> str:
    """Return the effects as tables of a case file, the baseline's own parameters as comments."""
    lines = [f"# {line}" for line in (
        "The effects that the diagnosis named, as tables of a case file; the parameters are those of the fit.",
        "This documents the model of a joint that a measured motion drives: it holds no rig, specimens or mesh, so",
        "that `fretflow run` needs these tables in a whole case.", f"recording: {title}".replace("\n", " "))]
    lines += [f"# baseline {entry.key} = {entry.value:.6g} {entry.unit}" for entry in entries(joint.baseline)
              if isinstance(entry.value, float)]
    for name, table in tables(joint.effects).items():
        lines += ["", f"[effects.{name}]"]
        lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}"
                  for key, value in table.items()]
    return "\n".join(lines) + "\n"
