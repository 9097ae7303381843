"""An effect of one's own: this file is all that it takes."""

import fretflow as ff
import numpy as np
from fretflow import units as u


class FrictionBump(ff.Effect):
    """Friction ``mu (1 + a exp(-(x / w)^2))``: a patch in the middle of the stroke holds better."""

    id = "friction-bump"
    title = "friction that is larger in the middle of the stroke"
    block = ff.Block.CONTACT
    equation = "mu (1 + a exp(-(x / w)^2))"
    formula = r"\mu \left(1 + a e^{-(x / w)^2}\right)"  # for pages that set it
    source = "made up for this example"
    observables = ("force in the middle of both plateaus of a loop",)
    kinds = ff.ALL_KINDS

    height: float = ff.parameter(0.2, "a: largest friction over that elsewhere, less one", 0.02, 0.5, gt=-1.0,
                                 neutral=0.0)
    width: u.Length = ff.parameter(1.5e-6, "w: half-width of the patch", 0.5e-6, 4e-6)

    def limit(self, motion: ff.Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the factors (N,) on the friction limit, alike for both directions of sliding."""
        factor = 1.0 + self.height * np.exp(-((motion.displacement / self.width) ** 2))
        return factor, factor
