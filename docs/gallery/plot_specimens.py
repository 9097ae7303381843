"""
The specimens and their faces
=============================

What a full run draws by itself, off-screen: the meshed specimens, the worn faces, the states of the contact.
"""

import fretflow as ff

found = ff.run("../../examples/quick.toml", "runs")
[found.folders["render"] / f"{name}.png" for name in ("specimens", "wear_depth", "stick_slip_worn")]
