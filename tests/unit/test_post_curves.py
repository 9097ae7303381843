"""Curves: the CSV holds the records' numbers to the bit, and loops are as found by hand."""

import csv

import numpy as np
import pytest
from fretflow.core.errors import StoreError
from fretflow.core.store import write_csv
from fretflow.pipeline.run_records import ForcedResponse
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen
from fretflow.wear.history import WearHistory
from fretflow_post import curves
from matplotlib.image import imread

RANDOM = np.random.default_rng(7)


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(column):
    return np.array([float(text) for text in column])


def assert_drawn(path):
    image = imread(path)
    assert image.shape[0] >= 800
    assert image.shape[1] == 1600
    inked = np.mean(image[..., :3].min(axis=2) < 0.9)
    assert 0.005 < inked < 0.6


def test_csv_reads_back_to_the_bit(tmp_path):
    values = RANDOM.standard_normal(50) * 10.0 ** RANDOM.integers(-300, 300, 50)
    columns = {"n": np.arange(50), "value_m": values, "word": ["a,b"] * 50}
    path = write_csv(tmp_path / "a.csv", columns)
    back = read(path)
    assert np.array_equal(numbers(back["value_m"]), values)
    assert back["n"][-1] == "49"
    assert set(back["word"]) == {"a,b"}


def test_columns_of_unequal_length_are_refused(tmp_path):
    with pytest.raises(ValueError, match="shorter"):
        write_csv(tmp_path / "a.csv", {"a": [1, 2], "b": [1]})


def test_unwritable_place_is_one_clear_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="choose another --out"):
        write_csv(tmp_path / "file" / "a.csv", {"a": [1]})


def two_node_period():
    motion = np.zeros((4, 2, 3))
    motion[:, 0, 0], motion[:, 1, 0] = [0.0, 1.0, 0.0, -1.0], [0.0, 4.0, 0.0, -4.0]
    motion[:, :, 1:] = 9.0  # other directions must not enter
    observed = np.full((4, 3), 9.0)
    observed[:, 0] = [1.0, 2.0, 3.0, 4.0]
    return PeriodicSolution(
        method="test", frequency=100.0, displacement=motion, force=np.zeros((4, 2, 3)),
        state=np.zeros((4, 2), dtype=np.int8), internal=np.zeros((4, 2)),
        outputs={"upper": observed, "lower": np.full((4, 3), 0.5)}, friction_force=np.array([5.0, 6.0, -5.0, -6.0]),
        residual_history=(0.0,), error_estimate=0.0)


def test_loop_is_upper_minus_lower_and_area_mean():
    loop = curves.loop_of(two_node_period(), np.array([3.0, 1.0]), 12)
    assert loop.observed == pytest.approx([0.5, 1.5, 2.5, 3.5])
    assert loop.faces == pytest.approx([0.0, 1.75, 0.0, -1.75])
    assert loop.force == pytest.approx([5.0, 6.0, -5.0, -6.0])


def test_loops_are_written_as_they_are(tmp_path):
    loops = [curves.LoopCurve(cycles, *RANDOM.standard_normal((3, 16))) for cycles in (0, 190000)]
    png, table = curves.plot_loops(tmp_path / "loops.png", loops)
    assert_drawn(png)
    back = read(table)
    assert back["cycles"] == ["0"] * 16 + ["190000"] * 16
    for name, part in (("observed_displacement_m", "observed"), ("faces_displacement_m", "faces"),
                       ("friction_force_N", "force")):
        assert np.array_equal(numbers(back[name]), np.concatenate([getattr(loop, part) for loop in loops]))


def test_responses_are_written_as_they_are(tmp_path):
    responses = [ForcedResponse(
        cycles=cycles, excitation=53.0, frequency=np.array([20.0, 50.0, 110.0, 400.0]),
        amplitude=RANDOM.uniform(1e-7, 1e-5, 4), phase=RANDOM.uniform(0.0, 3.1, 4)) for cycles in (0, 190000)]
    png, table = curves.plot_responses(tmp_path / "frf.png", responses)
    assert_drawn(png)
    back = read(table)
    assert back["cycles"] == ["0"] * 4 + ["190000"] * 4
    for name, part in (("frequency_Hz", "frequency"), ("amplitude_m", "amplitude"), ("phase_rad", "phase")):
        assert np.array_equal(numbers(back[name]), np.concatenate([getattr(r, part) for r in responses]))


@pytest.mark.parametrize("end", [90, 52_000, 1_900_000])
def test_wear_volume_csv(tmp_path, end):
    cycles = np.array([0, end // 3, end])
    depth = np.outer([0.0, 1e-7, 2.5e-7], [1.0, 0.5])
    history = WearHistory(
        cycles=cycles, depth=depth, rate=np.zeros((3, 2)), volume=np.array([0.0, 1.1e-13, 2.3e-13]),
        dissipated_energy=np.array([1e-3, 2e-3, 3e-3]), sliding_distance=np.array([1e-5, 1.1e-5, 1.3e-5]),
        energy=1.5e-3 * cycles, approach=depth.max(axis=1), upper_share=0.5, solves=3, stopped_by="cycles")
    png, table = curves.plot_wear_volume(tmp_path / "volume.png", history)
    assert_drawn(png)
    back = read(table)
    assert np.array_equal(numbers(back["cycles"]), cycles)
    assert np.array_equal(numbers(back["worn_volume_m3"]), history.volume)
    assert np.array_equal(numbers(back["deepest_m"]), [0.0, 1e-7, 2.5e-7])
    assert np.array_equal(numbers(back["sliding_distance_m"]), history.sliding_distance)


def test_modes_csv_states_the_error_of_each_mode(tmp_path):
    upper, lower = (specimen(np.array([1e5, 2e5, 4e5]), error) for error in ([1e-4, 0.0, 5e-4], [2e-4] * 3))
    png, table = curves.plot_modes(tmp_path / "modes.png", upper, lower)
    assert_drawn(png)
    back = read(table)
    assert back["specimen"] == ["upper"] * 3 + ["lower"] * 3
    assert back["mode"] == ["1", "2", "3"] * 2
    assert np.array_equal(numbers(back["craig_bampton_Hz"])[:3], upper.reduced_frequencies)
    assert numbers(back["error_percent"]) == pytest.approx([0.01, 0.0, 0.05, 0.02, 0.02, 0.02], abs=1e-12)


def specimen(full, error):
    return ReducedSpecimen(
        stiffness=np.eye(24), mass=np.eye(24), contact_nodes=np.zeros((4, 3)), contact_areas=np.ones(4),
        profile=np.zeros(4), observation_point=np.zeros(3), fixed_interface_frequencies=full,
        full_frequencies=full, reduced_frequencies=full * (1.0 + np.array(error)), rayleigh_mass=0.0,
        rayleigh_stiffness=0.0, full_dofs=20655)
