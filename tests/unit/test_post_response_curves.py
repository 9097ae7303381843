"""Pictures of frequency responses: what is unstable is dashed, and each sign stands where it belongs."""

import numpy as np
from fretflow.pipeline.response_curves import RunCurve
from fretflow.solvers.continuation.curve import ResponseCurve
from fretflow_post import response_curves
from matplotlib.figure import Figure
from matplotlib.image import imread


def folded(bridged=False):
    """Return a curve that turns back twice, its middle branch unstable."""
    s = np.linspace(-2.0, 2.0, 41)
    frequency, amplitude = 60.0 + s**3 - 1.5 * s, 1e-5 * np.exp(-(s + 0.7)**2)
    motion = np.repeat((amplitude * np.exp(-1j * (1.5 + s)))[:, None], 5, axis=1)
    turned = np.diff(frequency, append=np.inf) < 0.0
    count = len(s)
    return ResponseCurve(
        excitation=53.0, frequency=frequency, first_harmonic=motion, peak_to_peak=2.0 * np.abs(motion),
        direction=np.ones(count, dtype=np.int8), branch=np.cumsum(np.diff(turned, prepend=False)),
        multiplier=np.where(turned, 1.2, 0.9), stable=~turned, bridged=np.arange(count) == (5 if bridged else -1),
        iterations=np.ones(count, dtype=np.int64), residual=np.zeros(count), samples=np.full(count, 64),
        sampling_error=0.0)


def test_the_picture_is_drawn(tmp_path):
    runs = [RunCurve(state="unworn", cycles=0, curve=folded()), RunCurve(state="worn", cycles=9000, curve=folded(True))]
    (png,) = response_curves.plot_curves(tmp_path / "curves.png", runs)
    image = imread(png)
    assert image.shape[1] == 1600
    assert 0.005 < np.mean(image[..., :3].min(axis=2) < 0.9) < 0.6


def test_unstable_parts_are_dashed_and_folds_marked():
    run = RunCurve(state="unworn", cycles=0, curve=folded())
    upper, lower = Figure().subplots(2)
    response_curves._draw(upper, lower, run, "#0072B2")
    lines = upper.get_lines()
    middle = [line for line in lines if line.get_linestyle() == "--"]
    assert len(middle) == 1
    turns = next(line for line in lines if line.get_marker() == "^")
    np.testing.assert_allclose(turns.get_xdata(), 60.0 + np.array([1.0, -1.0]) / np.sqrt(2.0), atol=0.01)
    drawn = np.sort(middle[0].get_xdata())
    assert drawn[0] < 59.5
    assert drawn[-1] > 60.5


def test_only_the_signs_that_occur_are_explained():
    plain = RunCurve(state="unworn", cycles=0, curve=folded())
    gap = RunCurve(state="worn", cycles=1, curve=folded(True))
    assert list(response_curves._signs([plain])) == ["resonance", "unstable", "turning point"]
    assert list(response_curves._signs([plain, gap]))[-1] == "gap bridged"
