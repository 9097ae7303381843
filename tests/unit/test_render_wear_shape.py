"""Shapes of worn faces: what is nearly uniform on the common scale shows its pattern on one of its own.

What carries the weight: the pixels of the picture of a known pattern.
"""

import numpy as np
import pytest
from fretflow.wear.history import WearHistory
from matplotlib.image import imread

pytestmark = pytest.mark.render


def test_each_time_has_a_scale_of_its_own_beside_the_common_one(tmp_path):
    from fretflow_post import faces
    from fretflow_post.offscreen import require_offscreen

    require_offscreen()
    x, y = np.meshgrid(*[np.linspace(-5e-4, 5e-4, 9)] * 2, indexing="ij")
    nodes = np.column_stack([x.ravel(), y.ravel()])
    away = (nodes**2).sum(axis=1) / 5e-7
    away -= away.mean()
    depth = np.stack([0.0 * away, 1e-9 * (1.0 + 0.8 * away), 1e-5 * (1.0 + 4e-3 * away)])
    zero = np.zeros(3)
    history = WearHistory(
        cycles=np.array([0, 1, 1_900_000]), depth=depth, rate=depth, volume=zero, dissipated_energy=zero,
        sliding_distance=zero, energy=zero, approach=zero, upper_share=0.5, solves=1, stopped_by="cycles")
    faces.plot_wear_shape(tmp_path / "a.png", nodes, np.full(81, 1e-6 / 81), history, [1, 2])
    picture = imread(tmp_path / "a.png")[..., :3]
    last = picture[:, int(0.55 * picture.shape[1]):int(0.75 * picture.shape[1])]
    above, below = np.array_split(last, 2)
    coloured = [float(np.mean(np.ptp(part, axis=2) > 0.2)) for part in (above, below)]
    assert coloured[0] < 0.01
    assert coloured[1] > 0.3
