"""Scales and numbers for people: a scale covers its data with few round ticks, whatever their size."""

import itertools

import matplotlib
import numpy as np
import pytest
from fretflow.core.errors import InputError
from fretflow.effects.catalogue import catalogue
from fretflow_post import style
from fretflow_post.effect_sheet import plot_effect
from hypothesis import given
from hypothesis import strategies as st

SIZES = st.floats(1e-12, 1e12)


@given(SIZES)
def test_round_scale_covers_the_data_with_few_round_equal_steps(largest):
    top, ticks = style.round_scale(largest)
    assert ticks[0] == 0.0
    assert ticks[-1] == top
    assert largest <= top * (1.0 + 1e-9)
    assert top <= 2.0 * largest
    assert 3 <= len(ticks) <= 8
    step = np.diff(ticks)
    assert step == pytest.approx(step[0])
    assert round(float(f"{step[0]:e}".partition("e")[0]), 6) in (1.0, 2.0, 2.5, 5.0)


@given(SIZES)
def test_root_ticks_are_round_and_clear_of_each_other(largest):
    top = style.round_scale(largest)[0]
    ticks = style.root_ticks(top)
    assert ticks[0] == 0.0
    assert ticks[-1] == top
    assert np.diff(np.sqrt(np.array(ticks) / top)).min() > 0.06
    assert len(ticks) >= 4
    assert all(f"{tick:.6e}"[:2] in ("1.", "2.", "5.") for tick in ticks[1:-1])


def test_scale_of_nothing_is_still_a_scale():
    assert style.round_scale(0.0)[0] == 1.0


@given(st.floats(1.0, 1e9))
def test_round_factor_is_the_next_lower_of_one_two_five(value):
    factor = style.round_factor(value)
    assert factor <= value * (1.0 + 1e-9)
    assert value < 2.5 * factor * (1.0 + 1e-9)
    assert f"{factor:e}"[0] in "125"
    assert float(f"{factor:.0e}") == factor


def test_heights_are_never_drawn_smaller_than_they_are():
    assert style.round_factor(0.3) == 1.0


@pytest.mark.parametrize(("value", "text"), [
    (0.0, "0"), (0.39612, "0.396"), (1.0, "1.00"), (12.345, "12.3"), (136.7, "137"), (20655.0, "20,655"),
    (3.2e-7, "3.2e-07")])
def test_figures_keep_three_digits(value, text):
    assert style.figures(value) == text


def test_neighbouring_curves_differ_in_colour_and_line():
    looks = [style.curve_look(k) for k in range(10)]
    assert all(a[0] != b[0] and a[1] != b[1] for a, b in itertools.pairwise(looks))


def test_the_look_does_not_depend_on_a_matplotlibrc_of_the_working_folder():
    """One with `text.usetex` would have every picture run LaTeX."""
    with matplotlib.rc_context({"text.usetex": True, "lines.linestyle": ":"}), style.styled():
        assert not matplotlib.rcParams["text.usetex"]
        assert matplotlib.rcParams["lines.linestyle"] == "-"
        assert matplotlib.rcParams["font.size"] == 15


@pytest.mark.parametrize("name", catalogue())
def test_the_text_of_every_effect_s_picture_is_within_it(name, tmp_path, monkeypatch):
    drawn = []
    save = style.save_figure
    monkeypatch.setattr(style, "save_figure", lambda figure, path: drawn.append(figure) or save(figure, path))
    plot_effect(tmp_path / "effect.png", name, catalogue()[name]())
    [figure] = drawn
    boxes = [text.get_window_extent() for text in figure.texts]
    assert min(box.x0 for box in boxes) >= 0.0
    assert max(box.x1 for box in boxes) <= figure.bbox.x1


def test_cycles_of_an_effect_s_picture_are_counted_as_everywhere(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(style, "save_figure", lambda figure, path: drawn.append(figure))
    plot_effect(tmp_path / "effect.png", "normal-load-drift", catalogue()["normal-load-drift"]())
    [figure] = drawn
    figure.draw_without_rendering()
    told = [text.get_text() for text in figure.axes[-1].get_xticklabels()]
    assert "100,000" in told
    assert "100000" not in told


def test_titles_are_text_whatever_stands_in_them(tmp_path):
    with style.styled():
        figure = style.new_figure("costs $5 and \\frac{$ \x1b[2J\x07", "none")
        assert style.save_figure(figure, tmp_path / "a.png").is_file()


def test_a_variable_names_the_formats_of_all_pictures(tmp_path, monkeypatch):
    figure = style.new_figure("", "")
    monkeypatch.setenv("FRETFLOW_FORMATS", "svg,pdf")
    assert style.save_figure(figure, tmp_path / "a.png") == tmp_path / "a.svg"
    with style.saved_as(["png"]):
        style.save_figure(figure, tmp_path / "b.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.pdf", "a.svg", "b.png"]
    monkeypatch.setenv("FRETFLOW_FORMATS", "")
    assert style.save_figure(figure, tmp_path / "c.png") == tmp_path / "c.png"
    monkeypatch.setenv("FRETFLOW_FORMATS", "svg, bmp")
    with pytest.raises(InputError, match="FRETFLOW_FORMATS: 'bmp' is none of png, svg, pdf"):
        style.save_figure(figure, tmp_path / "a.png")


def test_a_colour_bar_ends_in_an_arrow_where_values_go_on():
    with style.styled():
        figure = style.new_figure("shape", "", height=6.0)
        bars = [style.add_colour_bar(figure, figure.add_axes((left, 0.1, 0.02, 0.6)), style.SHAPE_MAP, [0.0, 1.0, 2.0],
                                     "over mean", beyond=beyond) for left, beyond in ((0.2, False), (0.6, True))]
    assert [bar.extend for bar in bars] == ["neither", "max"]
