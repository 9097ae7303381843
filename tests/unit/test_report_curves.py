"""Curves in the report: every measured point and both predictions stand at their values, with units on the axes."""

import re

import numpy as np
from fretflow.inference.verdict import MeasuredCurve
from fretflow_post.report.loops import curve_views


def test_points_and_predictions_stand_where_they_belong():
    x, y = np.array([1e-6, 3e-6, 5e-6]), np.array([100.0, 99.0, 97.0])
    one = MeasuredCurve(label="frequency over amplitude", x_label="amplitude of tip", x_unit="m",
                        y_label="natural frequency", y_unit="Hz", x=x, measured=y, before=y + 1.0, after=y)
    ((label, chart),) = curve_views((one,), True)
    assert label == "frequency over amplitude"
    assert "amplitude of tip (µm)" in chart
    assert "natural frequency (Hz)" in chart
    points = np.array(re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', chart), dtype=float)
    assert len(points) == 3
    across, down = np.diff(points, axis=0).T
    assert np.isclose(across[0], across[1], atol=0.2)
    assert np.isclose(down[1], 2.0 * down[0], atol=0.2)
    assert 'class="curve after"' in chart
    assert 'class="curve after"' not in curve_views((one,), False)[0][1]
