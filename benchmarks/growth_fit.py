"""The table of `growth.py`: rows of one series and the exponent fitted to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

Figures = Mapping[str, float]


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return p of the power law ``value ~ size^p`` that fits best in logarithms; nan for fewer than two sizes."""
    if len(set(sizes)) < 2:
        return float("nan")
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def rows(what: str, harmonics: int | None, found: Mapping[int, Figures | None]) -> list[tuple[str, ...]]:
    """Return the table's rows of one series, figures by nodes; a size that failed is said so and not fitted."""
    done = {nodes: figures for nodes, figures in found.items() if figures is not None}
    power = exponent(list(done), [figures["seconds"] for figures in done.values()])
    lines = []
    for nodes, figures in found.items():
        head = (what, "" if harmonics is None else str(harmonics), str(nodes))
        if figures is None:
            lines.append((*head, "failed", "", "", "", ""))
            continue
        again = f"{figures['again']:.2f}" if "again" in figures else ""
        last = f"{power:.2f}" if nodes == max(done) and not np.isnan(power) else ""
        lines.append((*head, f"{figures['seconds']:.2f}", again, f"{figures['MiB']:.0f}", f"{figures['size']:.0f}",
                      last))
    return lines
