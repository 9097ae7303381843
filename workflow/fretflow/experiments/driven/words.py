"""What is said of a driven joint's diagnosis: what to measure next, and the case that documents the model."""

from __future__ import annotations

from fretflow.case.casefile import entries
from fretflow.effects.catalogue import tables
from fretflow.effects.driven import DrivenJoint
from fretflow.inference.verdict import ResidualLaw


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
