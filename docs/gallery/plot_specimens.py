"""
The specimens and their faces
=============================

What a full run draws by itself, off-screen: the meshed specimens, the worn faces, the states of the contact.
"""

import fretflow as ff

results = ff.run("../../examples/quick.toml", "runs")
[results.folders["render"] / f"{name}.png" for name in ("specimens", "wear_depth", "stick_slip_worn")]
