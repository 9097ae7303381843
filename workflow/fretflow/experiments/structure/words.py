"""What a diagnosis of a structure says in words."""

from __future__ import annotations

from collections.abc import Sequence

from fretflow.inference.verdict import Place, Verdict

THIRDS = ("small amplitudes", "middle amplitudes", "large amplitudes")
NEXT = "pressure between the faces (film), the form of both faces, and the backbone at another bolt load"
MEANINGS = {"bolt_load": "load of the bolts", "friction_coefficient": "friction of the faces",
            "modal_damping": "damping ratio of the structure without its joint"}


def sentence(verdict: Verdict, sets: Sequence[frozenset[str]], explained: float, where: str) -> str:
    """Return the verdict in a sentence or two."""
    if verdict is Verdict.NONE:
        return "Bolt load, friction and modal damping explain frequency and damping over the amplitude."
    if verdict is Verdict.UNKNOWN:
        return (f"Something is missing that no effect of the catalogue explains; the best leaves "
                f"{100.0 * (1.0 - explained):.0f} % of the difference. {where}").strip()
    names = " or ".join(" with ".join(sorted(one)) for one in sets)
    return f"What is missing is {names}: {100.0 * explained:.0f} % of the difference. {where}".strip()


def parted(channel: Place, zone: Place) -> str:
    """Return where measured and predicted part."""
    return (f"They part most in the {channel.where} ({100.0 * channel.share:.0f} % of the difference) and at "
            f"{zone.where} ({100.0 * zone.share:.0f} %).")
