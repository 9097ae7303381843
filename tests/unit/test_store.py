"""Records on disk.

What carries the weight: a record reads back equal with its units beside it, a file under its name is whole,
and every kind of damage is refused by the file's name.
"""

import os
import resource
import signal
from collections.abc import Mapping
from enum import Enum, IntEnum

import h5py
import numpy as np
import pytest
import xarray as xr
from fretflow.core.errors import StoreError
from fretflow.core.records import quantity, record
from fretflow.core.store import read_record, write_record, write_whole
from fretflow.pipeline.run_records import ForcedResponse
from fretflow.solvers.periodic import PeriodicSolution
from numpy.typing import NDArray


class Kind(Enum):
    ROUND = "round"


class Level(IntEnum):
    HIGH = 3


@record
class Inner:
    mass: float = quantity("kg")


@record
class Sample:
    memory: Mapping[str, NDArray[np.float64]]
    field: NDArray[np.float64] = quantity("m", "(nodes, 3)")
    spectrum: NDArray[np.complex128] = quantity("N", "(harmonics,)")
    state: NDArray[np.int8] = quantity("1", "(nodes,)")
    inner: Inner
    kind: Kind
    level: Level
    name: str
    words: tuple[str, ...]
    history: tuple[float, ...]
    counts: tuple[int, ...]
    limit: float | None
    other: float | None
    steps: int
    done: bool


@record
class Labelled:
    cycles: NDArray[np.int64] = quantity("1", "(K,)", coordinate=True)
    depth: NDArray[np.float64] = quantity("m", "(K, nodes), of both faces")
    level: NDArray[np.int8] = quantity("1", "(K,)", codes=Level)
    stiffness: NDArray[np.float64] = quantity("N/m", "(nodes, nodes)")
    force: NDArray[np.float64] = quantity("N", "(nodes, 3)")
    other: NDArray[np.float64] = quantity("N", "(nodes,), of another face")


def a_sample(nodes=400):
    rng = np.random.default_rng(3)
    return Sample(
        memory={"layer_m": rng.normal(size=nodes), "made_m3": np.asarray(2e-12)},
        field=rng.normal(size=(nodes, 3)),
        spectrum=rng.normal(size=4) * (1 + 2j),
        state=np.arange(nodes, dtype=np.int8),
        inner=Inner(mass=2.5),
        kind=Kind.ROUND,
        level=Level.HIGH,
        name="µ-joint",
        words=("a", "µ"),
        history=(1.0, 1e-12),
        counts=(),
        limit=None,
        other=0.1,
        steps=7,
        done=True,
    )


def test_a_record_reads_back_equal(tmp_path):
    before = a_sample()
    after = read_record(write_record(tmp_path / "a.h5", before), Sample)
    for name in ("field", "spectrum", "state"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
        assert getattr(after, name).dtype == getattr(before, name).dtype
        assert not getattr(after, name).flags.writeable
    assert list(after.memory) == list(before.memory)
    for name, values in before.memory.items():
        np.testing.assert_array_equal(after.memory[name], values)
        assert after.memory[name].shape == values.shape
        assert not after.memory[name].flags.writeable
    for name in (
        "inner",
        "kind",
        "level",
        "name",
        "words",
        "history",
        "counts",
        "limit",
        "other",
        "steps",
        "done",
    ):
        assert getattr(after, name) == getattr(before, name), name
        assert type(getattr(after, name)) is type(getattr(before, name)), name


def test_units_and_shapes_stand_beside_the_numbers(tmp_path):
    with h5py.File(write_record(tmp_path / "a.h5", a_sample())) as file:
        assert file["field"].attrs["unit"] == "m"
        assert file["field"].attrs["shape"] == "(nodes, 3)"
        assert file["inner/mass"].attrs["unit"] == "kg"


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused_by_name(tmp_path, share):
    path = write_record(tmp_path / "a.h5", a_sample())
    os.truncate(path, int(share * path.stat().st_size))
    with pytest.raises(StoreError, match=r"a\.h5: truncated or damaged"):
        read_record(path, Sample)


def test_a_missing_file_another_record_and_another_file_are_refused(tmp_path):
    with pytest.raises(StoreError, match=r"a\.h5: no such result file"):
        read_record(tmp_path / "a.h5", Sample)
    path = write_record(tmp_path / "a.h5", a_sample())
    with pytest.raises(StoreError, match=r"a\.h5: holds no Inner"):
        read_record(path, Inner)
    with h5py.File(path, "a") as file:
        del file["name"]
    with pytest.raises(StoreError, match=r"a\.h5: incomplete Sample"):
        read_record(path, Sample)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["x"] = 1
    with pytest.raises(StoreError, match=r"b\.h5: holds no Sample"):
        read_record(tmp_path / "b.h5", Sample)


def test_a_disk_that_fills_up_leaves_the_old_file_whole(tmp_path):
    path = write_record(tmp_path / "a.h5", a_sample())
    old = path.read_bytes()
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(StoreError, match=r"a\.h5: cannot be written .*--out"):
            write_record(path, a_sample(nodes=50_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


def test_a_rewritten_file_is_put_in_place_whole(tmp_path):
    path = write_record(tmp_path / "a.h5", a_sample())
    with path.open("rb") as reader:  # someone who reads while it is written again
        old = path.read_bytes()
        write_record(path, a_sample(nodes=500))
        assert reader.read() == old
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_none_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError, match="cannot be written"):
        write_record(tmp_path / "file" / "a.h5", Inner(mass=1.0))


def test_where_no_folder_is_no_space_is_blamed(tmp_path):
    with pytest.raises(StoreError, match=r"\(No such file or directory\); choose another --out, a folder"):
        write_whole(tmp_path / "none" / "a.json", b"{}")


@pytest.mark.filterwarnings("error")
def test_a_file_opens_in_xarray_with_named_dimensions_units_and_codes(tmp_path):
    made = Labelled(cycles=np.array([0, 10, 500]), depth=np.arange(6.0).reshape(3, 2), level=np.full(3, 3, np.int8),
                    stiffness=np.eye(2), force=np.ones((2, 3)), other=np.ones(4))
    path = write_record(tmp_path / "a.h5", made)
    with xr.open_dataset(path, engine="h5netcdf") as shown:
        assert shown.depth.dims == ("cycles", "node")
        assert shown.depth.sel(cycles=10).values.tolist() == [2.0, 3.0]
        assert shown.depth.attrs["units"] == "m"
        assert np.atleast_1d(shown.level.attrs["flag_values"]).tolist() == [3]
        assert shown.level.attrs["flag_meanings"] == "high"
        assert shown.force.sel(direction="y").dims == ("node",)
        assert shown.stiffness.dims == ("node", "stiffness_1")  # no array has one dimension twice
        assert shown.other.dims == ("other_0",)  # as many nodes as the others have not
    again = read_record(path, Labelled)
    assert again.depth.tolist() == made.depth.tolist()


@pytest.mark.filterwarnings("error")
def test_a_period_opens_in_xarray_over_time_with_its_states_explained(tmp_path):
    made = PeriodicSolution(
        method="none", frequency=50.0, displacement=np.zeros((4, 2, 3)), force=np.zeros((4, 2, 3)),
        state=np.zeros((4, 2), np.int8), internal=np.zeros((4, 1)), outputs={"block": np.zeros(4)},
        friction_force=np.arange(4.0), residual_history=(0.0,), error_estimate=0.0)
    path = write_record(tmp_path / "a.h5", made)
    with xr.open_dataset(path, engine="h5netcdf") as shown:
        assert shown.friction_force.time.values.tolist() == pytest.approx([0.0, 0.005, 0.010, 0.015])
        assert shown.time.attrs["units"] == "s"
        assert shown.force.dims == ("sample", "node", "direction")
        assert shown.internal.dims == ("sample", "coordinate")
        assert "time" in shown.state.coords
        assert shown.state.attrs["flag_meanings"] == "stick slip separation"
        assert shown.state.attrs["flag_values"].tolist() == [0, 1, 2]
    assert read_record(path, PeriodicSolution).friction_force.tolist() == made.friction_force.tolist()


def test_a_forced_response_opens_in_xarray_over_its_frequencies(tmp_path):
    made = ForcedResponse(cycles=0, excitation=60.0, frequency=np.array([20.0, 40.0, 80.0]), amplitude=np.ones(3),
                          phase=np.zeros(3), checked=np.array([20.0, 80.0]), error=np.zeros(2))
    path = write_record(tmp_path / "a.h5", made)
    with xr.open_dataset(path, engine="h5netcdf") as shown:
        assert shown.amplitude.dims == ("frequency",)
        assert shown.error.dims == ("checked",)
    assert read_record(path, ForcedResponse).checked.tolist() == [20.0, 80.0]


@pytest.mark.parametrize(("digits", "spared"), [(None, False), (3, True)])
def test_numbers_that_deflate_does_not_shorten_are_written_as_they_are(tmp_path, digits, spared):
    """Random numbers have nothing to spare; of numbers of a few digits' sizes most bytes are alike."""
    depth = np.random.default_rng(0).random((300, 1000))
    depth = depth if digits is None else np.round(depth * 10**digits)
    path = write_record(tmp_path / "labelled.h5", Labelled(
        cycles=np.arange(300), depth=depth, level=np.full(300, 3, np.int8), stiffness=np.eye(2),
        force=np.ones((2, 3)), other=np.ones(4)))
    with h5py.File(path) as file:
        assert (file["depth"].compression == "gzip") is spared
    assert np.array_equal(read_record(path, Labelled).depth, depth)
