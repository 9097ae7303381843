"""Curves in the report: every measured point and both predictions stand at their values, with units on the axes."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from fretflow.inference.verdict import Evolution, MeasuredCurve
from fretflow_post.report.loops import curve_views, evolution_views


def test_points_and_predictions_stand_where_they_belong(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    from report_cases import chart_of, drawn

    x, y = np.array([1e-6, 3e-6, 5e-6]), np.array([100.0, 99.0, 97.0])
    one = MeasuredCurve(label="frequency over amplitude", x_label="amplitude of tip", x_unit="m",
                        y_label="natural frequency", y_unit="Hz", x=x, measured=y, before=y + 1.0, after=y)
    ((label, chart),) = curve_views((one,), True)
    assert label == "frequency over amplitude"
    axes = chart_of(chart, "natural frequency over amplitude of tip")["attributes"]
    assert axes["below"][0]["attributes"]["axis_label"]["attributes"]["text"] == "amplitude of tip (µm)"
    assert axes["left"][0]["attributes"]["axis_label"]["attributes"]["text"] == "natural frequency (Hz)"
    assert axes["below"][0]["attributes"]["major_label_policy"]["name"] == "NoOverlap"
    assert axes["left"][0]["attributes"]["major_label_policy"]["name"] != "NoOverlap"
    shown = drawn(chart, "natural frequency over amplitude of tip")
    for name, values in (("measured", y), ("before", y + 1.0), ("after", y)):
        assert np.allclose(shown[name]["x"], 1e6 * x, rtol=1e-6)
        assert np.allclose(shown[name]["y"], values, rtol=1e-6)
    assert "after" not in drawn(curve_views((one,), False)[0][1], "natural frequency over amplitude of tip")


def test_cycles_are_counted_in_whole_numbers(monkeypatch):
    """Ticks at 1.5 and 2.5 would be written as 2 and 3, each number twice."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    from report_cases import chart_of

    seen = Evolution(cycles=np.arange(1.0, 5.0), **{name: np.ones((3, 4)) for name in (
        "friction_limit", "tangential_stiffness", "dissipated_energy", "sliding_distance")})
    charts = evolution_views(SimpleNamespace(evolution=seen), after=False)
    assert len(charts) == 4
    for name, chart in charts:
        below = chart_of(chart, f"{name} over the cycles")["attributes"]["below"][0]["attributes"]
        assert below["ticker"]["attributes"]["min_interval"] == 1.0
