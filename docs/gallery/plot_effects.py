"""
All effects at a glance
=======================

What each effect of the catalogue does, with its default parameters: mostly a loop without (blue) and with it, else the
law itself. Where both loops look alike here, the :doc:`effect's own page </effects>` draws their difference.
"""

import fretflow as ff
import matplotlib.pyplot as plt

known = ff.catalogue()
figure, panels = plt.subplots(-(-len(known) // 4), 4, figsize=(11, 16), layout="constrained")
for axes, (name, kind) in zip(panels.flat, known.items(), strict=False):
    for x, y in kind().sketch().curves.values():
        axes.plot(x, y, lw=1.2)
    axes.set_title(name, fontsize=8)
    axes.set(xticks=[], yticks=[])
for axes in panels.flat[len(known):]:
    axes.axis("off")
plt.show()
