"""Figures of a diagnosis.

What carries the weight: curves hold the record's numbers in the units of their labels, draws tell the interval that is
stated, and regions hold the shares of a normal distribution that they claim.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import report_cases
import xarray as xr
from fretflow.core.errors import InputError
from fretflow.inference import words
from fretflow.inference.evidence import DRAWS, drawn
from fretflow.inference.parameters import HALF, Coordinate
from fretflow.inference.verdict import MeasuredCurve, WearTests
from fretflow_post import corner, style
from fretflow_post.report import render_report
from fretflow_post.wear_maps import profile


@pytest.fixture
def cases():
    return report_cases


def test_readings_over_the_cycles_are_drawn_in_their_units(cases):
    diagnosis = cases.named()
    axes = {one.get_ylabel(): one for one in diagnosis.plot("evolution").axes}
    assert list(axes) == ["friction limit (N)", "tangential stiffness (N/µm)", "energy of a cycle (mJ)",
                          "sliding distance (µm)"]
    for name, field, size in (("energy of a cycle (mJ)", "dissipated_energy", 1e-3),
                              ("sliding distance (µm)", "sliding_distance", 1e-6)):
        for line, values in zip(axes[name].lines, getattr(diagnosis.evolution, field), strict=True):
            assert line.get_xdata() == pytest.approx(cases.CYCLES)
            assert line.get_ydata() * size == pytest.approx(values)
    page = render_report(diagnosis)
    assert page.count("over the cycles\"") == 4


def test_a_corner_has_each_parameter_and_each_pair_with_its_correlation(cases):
    figure = cases.named().plot("parameters")
    count = len(cases.PARAMETERS)
    assert len(figure.axes) == count * (count + 1) // 2
    draws = np.array([one.draws for one in cases.PARAMETERS])
    told = [text.get_text() for text in figure.texts]
    assert f"{np.corrcoef(draws)[0, 1]:.2f}" in told
    assert len(set(told) & {f"{r:.2f}" for r in np.corrcoef(draws)[np.triu_indices(count, 1)]}) > 5


def test_regions_hold_their_shares_of_a_normal_distribution():
    """The outline of 90 % of a standard normal pair is a circle of radius sqrt(-2 ln 0.1)."""
    x, y = np.random.default_rng(1).standard_normal((2, 4000))
    with style.styled():
        figure = style.new_figure("", "")
        corner.plot_corner(figure, [("a.x", "1", x), ("a.y", "1", y)])
    outer = figure.axes[1].collections[0].get_paths()[0]
    away = np.hypot(*outer.vertices[outer.codes == 2].T)  # both outlines, of 90 % and of 50 %
    radii = [np.sqrt(-2.0 * np.log(1.0 - share)) for share in corner.HELD]
    off = np.min(np.abs(away[:, None] / radii - 1.0), axis=1)
    assert np.median(off) < 0.05


def test_small_numbers_are_told_with_a_power_of_ten_and_no_correlation_has_no_sign():
    """Ticks as long as 0.00184 would run into each other."""
    x = np.tile([1.0, -1.0], 200)
    with style.styled():
        figure = style.new_figure("", "")
        corner.plot_corner(figure, [("a.damping", "1", 1.84e-3 + 1e-5 * np.repeat([1.0, -1.0], 200)),
                                    ("a.y", "1", x - 1e-5 * np.repeat([1.0, -1.0], 200))])
    assert figure.axes[1].get_xlabel() == "a\ndamping\n($10^{-3}$)"
    assert figure.texts[-1].get_text() == "0.00"


def test_names_of_effects_do_not_run_into_each_other():
    draws = 5.0 + 0.1 * np.random.default_rng(1).standard_normal((4, 200))
    with style.styled():
        figure = style.new_figure("", "", 12.0, 12.0)
        corner.plot_corner(figure, [(f"velocity-dependent-friction.{name}", "N", own)
                                    for name, own in zip("abcd", draws, strict=True)])
        figure.draw_without_rendering()
        below = [axes.xaxis.label.get_window_extent() for axes in figure.axes if axes.get_xlabel()]
        beside = [axes.yaxis.label.get_window_extent() for axes in figure.axes if axes.get_ylabel()]
    assert len(below) == 4
    assert len(beside) == 3
    assert all(one.x1 < other.x0 for one, other in pairwise(below))
    assert all(one.y0 > other.y1 for one, other in pairwise(beside))
    assert min(one.x0 for one in beside) > 0.0
    assert min(one.y0 for one in below) > 0.0


def test_draws_tell_the_stated_interval():
    mean, covariance = np.array([0.3, -1.0]), np.array([[0.5, 0.3], [0.3, 0.4]])
    draws = drawn(mean, covariance)
    assert draws.shape == (2, DRAWS)
    assert np.cov(draws) == pytest.approx(covariance, abs=0.08)
    own = Coordinate("", "size", np.log(2.0), 0.2, True)
    low, high = (own.value(mean[0] + way * HALF * np.sqrt(0.5)) for way in (-1.0, 1.0))
    assert np.mean((own.values(draws[0]) > low) & (own.values(draws[0]) < high)) == pytest.approx(0.9, abs=0.03)


def test_the_posterior_goes_to_a_file_that_keeps_names_draws_and_units(cases, tmp_path):
    diagnosis = cases.named()
    diagnosis.posterior.to_netcdf(tmp_path / "posterior.nc", group="posterior", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "posterior.nc", group="posterior", engine="h5netcdf") as read:
        assert read.sizes == {"chain": 1, "draw": 500}
        energy = read["friction-run-in.energy"]
        assert energy.attrs["units"] == "J"
        assert energy.values[0] == pytest.approx(diagnosis.parameters[2].draws)


def test_maps_law_volumes_and_curves_hold_the_records_numbers(cases):
    diagnosis, unknown = cases.named(), cases.unknown()
    panels = {one.get_title(): one for one in diagnosis.plot("maps").axes if one.images}
    assert list(panels) == [f"{channel}, {name}" for channel in ("friction force", "relative displacement")
                            for name in ("before", "after")]
    drawn = np.asarray(panels["friction force, after"].images[0].get_array())
    assert drawn == pytest.approx(diagnosis.residual_maps[0].after)
    law = unknown.residual_law
    (line,) = unknown.plot("law").axes[0].lines
    assert line.get_xdata() == pytest.approx(np.sort(law.x) * 1e3), "in mm/s"
    assert line.get_ydata() == pytest.approx(law.y[np.argsort(law.x)])
    volume = np.array([1.0, 2.0, 4.0]) * 1e-9
    tests = WearTests(rows=np.arange(3), measured=volume, before=0.5 * volume, after=1.1 * volume, r2_before=0.1,
                      r2_after=0.9)
    curve = MeasuredCurve(label="$$ first", x_label="amplitude", x_unit="m", y_label="damping", y_unit="1",
                          x=volume * 1e3, measured=np.array([0.01, 0.02, 0.03]), before=np.zeros(3),
                          after=np.full(3, 0.02))
    diagnosis = replace(diagnosis, wear_tests=tests, curves=(curve,))
    drawn = {one.get_label(): one for one in diagnosis.plot("volumes").axes[0].lines}
    assert drawn["after"].get_ydata() == pytest.approx([1.1, 2.2, 4.4])
    axes = diagnosis.plot("curves").axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("amplitude (µm)", "damping (%)")
    assert axes.lines[0].get_ydata() == pytest.approx([1.0, 2.0, 3.0])
    assert axes.lines[0].get_xdata() == pytest.approx([1.0, 2.0, 4.0])


def test_what_is_not_there_is_said(cases):
    with pytest.raises(InputError, match=r"'loop' is none of loops, evolution.*; did you mean loops\?"):
        cases.named().plot("loop")
    with pytest.raises(InputError, match="nothing to draw as 'parameters'"):
        cases.empty().plot("parameters")


def test_wear_is_drawn_with_what_it_differs_by_and_its_profiles(cases):
    """A depth of 3 + 2 x on a grid: means across are that line; across, at each x, nothing varies but what y adds."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0.0, 1.0, 11), np.linspace(-1.0, 1.0, 21)))
    places, mean, sd = profile(x, 3.0 + 2.0 * x + y)
    assert places == pytest.approx(np.linspace(0.0, 1.0, 11))
    assert mean == pytest.approx(3.0 + 2.0 * places)
    assert sd == pytest.approx(np.std(np.linspace(-1.0, 1.0, 21)))
    diagnosis = cases.named()
    panels = {one.get_title(): one for one in diagnosis.plot("wear").axes}
    assert {"measured", "before", "after", "measured − before", "measured − after"} < set(panels)
    away = panels["measured − before"].images[0].get_array()
    assert float(away.max()) * 1e-6 == pytest.approx(np.max(diagnosis.wear_map.measured - diagnosis.wear_map.before))
    with pytest.raises(InputError, match="nothing to draw as 'wear'"):
        cases.named("imposed-displacement").plot("wear")


def test_where_noise_is_all_there_is_no_share_of_it_is_explained(cases):
    one = replace(cases.RANKING[0], explained=1.0)
    assert words.explained(cases.none(), one) == words.NOTHING
    assert words.explained(cases.named(), one) == "100 %"


def test_a_diagnosis_shows_itself_in_a_line(cases):
    assert repr(cases.named()).count("\n") == 0
    assert "named, effects=('friction-run-in',), probability=" in repr(cases.named())
    assert len(repr(cases.named())) < 200
