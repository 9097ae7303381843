"""Layers fill their length exactly and no two neighbours differ by more than the growth."""

import numpy as np
import pytest
from fretflow.core.errors import MeshError
from fretflow_meshes.grading import graded_sizes, levels, subdivide
from hypothesis import given, settings
from hypothesis import strategies as st


@settings(max_examples=200, deadline=None, derandomize=True)
@given(length=st.floats(0.01, 300.0), growth=st.floats(1.0, 3.0), largest=st.floats(0.5, 20.0))
def test_layers_fill_the_length_and_grow_within_bounds(length, growth, largest):
    sizes = graded_sizes(length, 1.0, growth, largest)
    assert sizes.sum() == pytest.approx(length, rel=1e-12)
    ratios = sizes[1:] / sizes[:-1]
    assert np.all(ratios >= 1.0 - 1e-9)
    assert np.all(ratios <= growth * (1.0 + 1e-9))
    assert sizes[0] <= 1.0 + 1e-8
    assert sizes.max() <= max(largest, 1.0) * (1.0 + 1e-8)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(length=st.floats(0.5, 100.0), growth=st.floats(1.05, 3.0))
def test_one_layer_fewer_would_not_reach(length, growth):
    layers = len(graded_sizes(length, 1.0, growth, 8.0))
    longest = sum(min(growth**k, 8.0) for k in range(layers - 1))
    assert longest < length


def test_a_geometric_length_keeps_the_growth_asked_for():
    np.testing.assert_allclose(graded_sizes(15.0, 1.0, 2.0, 100.0), [1.0, 2.0, 4.0, 8.0], rtol=1e-9)


def test_the_largest_size_caps_the_growth():
    np.testing.assert_allclose(graded_sizes(9.0, 1.0, 2.0, 3.0), [1.0, 2.0, 3.0, 3.0], rtol=1e-9)


def test_levels_and_middle_nodes():
    boundaries = levels(0.5, np.array([1.0, 2.0]))
    np.testing.assert_allclose(boundaries, [0.5, 1.5, 3.5])
    np.testing.assert_allclose(subdivide(boundaries, 1), boundaries)
    np.testing.assert_allclose(subdivide(boundaries, 2), [0.5, 1.0, 1.5, 2.5, 3.5])


def test_a_tiny_first_layer_takes_as_many_layers_as_its_growth():
    assert len(graded_sizes(5e-3, 1e-12, 1.35, 1e-3)) == pytest.approx(np.log(1e9) / np.log(1.35), abs=8)


@pytest.mark.parametrize("growth", [1.0, 1.00001])
def test_endless_layers_are_refused(growth):
    with pytest.raises(MeshError, match=r"\de\+0[68] layers from 1e-11 m on, .* check its lengths"):
        graded_sizes(5e-3, 1e-11, growth, 1e-3)
