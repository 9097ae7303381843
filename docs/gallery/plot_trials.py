"""
How often a diagnosis is right
==============================

Scores of the last trial on 100 concealed recordings, all sizes of effects together, with 95 % intervals. It is of an
earlier verdict; :doc:`how far to trust </diagnosis>` that of now rests on fewer recordings.
"""

import json
from pathlib import Path

import matplotlib.pyplot as plt

board = json.loads(Path("../../benchmarks/trial-100-2031/trial.json").read_text(encoding="utf-8"))["all"]
scores = {"right_name": "right name", "unknown_recognised": "unlisted called unknown", "location": "right place",
          "coverage": "90 % intervals hold the truth", "pairs": "both of a pair", "false_alarms": "false alarms",
          "missed": "missed", "wrong_name": "wrong name", "wrong_and_sure": "wrong, probability above 0.9"}
figure, axes = plt.subplots(figsize=(7.5, 4), layout="constrained")
for row, key in enumerate(reversed(scores)):
    low, high = board[key]["interval_95"]
    axes.plot([low, high], [row, row], color="#9DC3E6", lw=8, solid_capstyle="butt")
    axes.plot(board[key]["value"], row, "o", color="#0072B2")
    axes.text(1.02, row, f"{board[key]['hits']} of {board[key]['cases']}", va="center", fontsize=9)
axes.set(yticks=range(len(scores)), yticklabels=list(scores.values())[::-1], xlim=(0, 1), xlabel="share")
plt.show()
