"""Property: a structure is the same in every form of file, nothing in a file is run, and bad files are named."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from fretflow.core.errors import CorruptRecordingError, FretflowError, InputError, UnsupportedRecordingError
from fretflow.recordings.readers.structure_files import read_structure
from scipy import sparse
from scipy.io import mmwrite, savemat

SIZE = 8


@pytest.fixture
def held():
    random = np.random.default_rng(3)
    root = random.standard_normal((SIZE, SIZE))
    contact = np.eye(6, SIZE)
    return {"M": np.eye(SIZE), "K": 1e6 * (root @ root.T), "contact_map": contact, "areas": np.full(2, 1e-4),
            "points": random.standard_normal((2, 3)), "preload": np.arange(SIZE) - 3.0, "modal_damping": 0.01,
            "force_map": contact.T * 1e-4}


TIP = np.eye(SIZE)[7]


def check(structure, held):
    def full(values):
        return values.toarray() if sparse.issparse(values) else values

    assert full(structure.stiffness) == pytest.approx(held["K"])
    assert full(structure.contact_map) == pytest.approx(held["contact_map"])
    assert structure.points == pytest.approx(held["points"])
    assert structure.preload == pytest.approx(held["preload"])
    assert structure.modal_damping == 0.01
    assert structure.outputs["tip"] == pytest.approx(TIP)


def test_npz(held, tmp_path):
    np.savez(tmp_path / "a.npz", **held, outputs=TIP[None], output_names=np.array(["tip"]))
    check(read_structure(tmp_path / "a.npz"), held)


def test_npz_with_sparse_matrices_and_rows_by_name(held, tmp_path):
    rows = sparse.csr_matrix(held["K"])
    parts = {"K.data": rows.data, "K.indices": rows.indices, "K.indptr": rows.indptr, "K.shape": rows.shape}
    np.savez(tmp_path / "a.npz", **{name: value for name, value in held.items() if name != "K"}, **parts,
             **{"outputs/tip": TIP})
    check(read_structure(tmp_path / "a.npz"), held)


def test_hdf5_with_units_and_sparse_groups(held, tmp_path):
    rows = sparse.csr_matrix(held["K"] * 1e-3)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, value in held.items():
            if name != "K":
                file[name] = value
        group = file.create_group("K")
        for name in ("data", "indices", "indptr"):
            group[name] = getattr(rows, name)
        group.attrs["shape"] = rows.shape
        group["data"][...] = rows.data * 1e3
        file["outputs/tip"] = TIP
        file["points"].attrs["unit"] = "mm"
    structure = read_structure(tmp_path / "a.h5")
    assert structure.points == pytest.approx(held["points"] * 1e-3)
    check(structure, {**held, "points": held["points"] * 1e-3})


def test_matlab_5_and_matrix_market(held, tmp_path):
    savemat(tmp_path / "a.mat", {**held, "K": sparse.csc_matrix(held["K"]), "outputs": {"tip": TIP}})
    check(read_structure(tmp_path / "a.mat"), held)
    folder = tmp_path / "market"
    folder.mkdir()
    for name, value in {**held, "outputs.tip": TIP}.items():
        whole = np.atleast_2d(value)
        mmwrite(folder / f"{name}.mtx", sparse.coo_matrix(whole) if name in ("M", "K") else whole)
    check(read_structure(folder), held)
    check(read_structure(folder / "M.mtx"), held)


def test_matlab_7_3(held, tmp_path):
    columns = sparse.csc_matrix(held["K"])
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, value in held.items():
            if name != "K":
                file[name] = np.atleast_2d(value).T
        group = file.create_group("K")
        group.attrs["MATLAB_sparse"] = np.uint64(SIZE)
        group["data"], group["ir"], group["jc"] = columns.data, columns.indices, columns.indptr
        file["outputs/tip"] = TIP[:, None]
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    check(read_structure(tmp_path / "a.mat"), held)


@pytest.mark.parametrize(("change", "words"), [
    ({"K": None}, "has no K; it has"),
    ({"K": np.triu(np.ones((SIZE, SIZE)))}, "K: is not symmetric"),
    ({"force_map": -np.eye(SIZE, 6)}, "force_map: is not the transposed"),
    ({"modal_damping": np.array([0.1, 0.2])}, "modal_damping: must be one ratio"),
    ({"outputs": np.ones((2, SIZE)), "output_names": np.array(["a"])}, "outputs: 2 rows but 1 names"),
    ({"outputs": np.ones((2, 3))}, "outputs: 1 has the shape"),
    ({"outputs": np.zeros((1, SIZE))}, "outputs: 1 holds only zeros"),
    ({"M": np.zeros((0, 0))}, "M: holds nothing"),
    ({"C": -np.eye(SIZE)}, "C: is not positive definite, C[0, 0] is negative"),
    ({"M": np.array([["a"] * SIZE] * SIZE)}, "M: holds no real numbers"),
    ({"M": 5.0}, "M: is no matrix, it has the shape ()"),
    ({"points": np.zeros((3, 2))}, "points: has the shape (3, 2)"),
    ({"C": None, "C.data": np.ones(2), "C.indices": np.zeros(3, int), "C.indptr": np.zeros(3, int), "C.shape": (8, 8)},
     "C: is no whole sparse matrix"),
])
def test_bad_arrays_are_named(held, tmp_path, change, words):
    held.update(change)
    np.savez(tmp_path / "a.npz", **{name: value for name, value in held.items() if value is not None})
    with pytest.raises(InputError) as caught:
        read_structure(tmp_path / "a.npz")
    assert str(caught.value).startswith(f"{tmp_path / 'a.npz'}: {words}")


def test_a_variable_that_differs_by_its_case_is_another_one(held, tmp_path):
    np.savez(tmp_path / "a.npz", **held, m=np.array(2), k=np.array(1.0), **{"outputs/tip": TIP})
    check(read_structure(tmp_path / "a.npz"), held)
    flat = {**held, "points": held["points"].ravel()}
    np.savez(tmp_path / "c.npz", **flat, **{"outputs/tip": TIP})
    check(read_structure(tmp_path / "c.npz"), held)
    lower = {name.lower(): value for name, value in held.items()}
    np.savez(tmp_path / "b.npz", **lower, **{"outputs/tip": TIP})
    check(read_structure(tmp_path / "b.npz"), held)


def test_matlab_7_3_with_a_sparse_row_of_one_entry_and_an_empty_matrix(held, tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, value in held.items():
            file[name] = np.atleast_2d(value).T
        tip, empty = file.create_group("outputs/tip"), file.create_group("C")
        tip.attrs["MATLAB_sparse"], empty.attrs["MATLAB_sparse"] = np.uint64(1), np.uint64(SIZE)
        row = sparse.csc_matrix(TIP[None])
        tip["data"], tip["ir"], tip["jc"] = row.data, row.indices, row.indptr
        empty["jc"] = np.zeros(SIZE + 1, dtype=np.uint64)
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    structure = read_structure(tmp_path / "a.mat")
    check(structure, held)
    assert structure.damping.nnz == 0


def test_modal_damping_in_per_cent_is_a_ratio(held, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, value in {**held, "modal_damping": 1.0, "outputs/tip": TIP}.items():
            file[name] = value
        file["modal_damping"].attrs["unit"] = "%"
    check(read_structure(tmp_path / "a.h5"), held)


def test_wrong_units_missing_damaged_and_pickled_files_are_refused(held, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, value in held.items():
            file[name] = value
        file["K"].attrs["unit"] = "kg"
    with pytest.raises(InputError, match="K: its unit 'kg' is none like N/m"):
        read_structure(tmp_path / "a.h5")
    with pytest.raises(CorruptRecordingError, match="no such file"):
        read_structure(tmp_path / "b.npz")
    (tmp_path / "b.npz").write_bytes(b"PK\x03\x04 cut")
    with pytest.raises(CorruptRecordingError, match="is no whole file"):
        read_structure(tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", **held, outputs=np.array([{"tip": 1}], dtype=object))
    with pytest.raises(FretflowError):
        read_structure(tmp_path / "c.npz")
    (tmp_path / "d.xyz").write_text("1")
    with pytest.raises(UnsupportedRecordingError, match="matrices are read from"):
        read_structure(tmp_path / "d.xyz")
