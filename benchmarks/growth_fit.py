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


def markdown(title: str, columns: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    head = [f"# {title}", "", f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return "\n".join([*head, *(f"| {' | '.join(line)} |" for line in lines)]) + "\n"


def rows(what: str, harmonics: int | None, series: Mapping[int, Figures | str]) -> list[tuple[str, ...]]:
    """Return the table's rows of one series, figures by nodes or why there are none; those are not fitted."""
    done = {nodes: figures for nodes, figures in series.items() if not isinstance(figures, str)}
    power = exponent(list(done), [figures["seconds"] for figures in done.values()])
    lines = []
    for nodes, figures in series.items():
        head = (what, "" if harmonics is None else str(harmonics), str(nodes))
        if isinstance(figures, str):
            lines.append((*head, figures, "", "", "", ""))
            continue
        again = f"{figures['again']:.2f}" if "again" in figures else ""
        last = f"{power:.2f}" if nodes == max(done) and not np.isnan(power) else ""
        lines.append((*head, f"{figures['seconds']:.2f}", again, f"{figures['MiB']:.0f}", f"{figures['size']:.0f}",
                      last))
    return lines
