"""What lies beside the input is not run, loaded or overwritten, and a single process listens to nobody.

What carries the weight: each of these once ran a stranger's code, wrote into a file that nobody had named, or opened
a port on every network.
"""

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from fretflow.case.config import Mesh, Specimen
from fretflow.cli import execute
from fretflow.core.errors import InputError, MeshError
from fretflow.core.isolated import call_isolated
from fretflow.core.records import quantity, record
from fretflow.core.store import open_hdf5, read_record, write_record
from fretflow.pipeline import ranks
from fretflow.pipeline.ensemble import LocalPool
from fretflow.recordings.readers.structure_files import read_structure
from fretflow.recordings.readers.tables import read_table
from fretflow_meshes.gmsh_files import read_mesh
from fretflow_meshes.specimen import Side, build_specimen, read_specimen

TRAP = "open({!r}, 'w').close()\nraise SystemExit('a module of the working folder was imported')\n"
SHADOWED = ("multiprocessing", "psutil", "vtkmodules", "numba", "pickle")
COMMAND_LINE = """
import sys
sys.argv[1:] = ["--version"]
from fretflow.cli import main
try:
    main()
except SystemExit:
    pass
"""
LISTENING = """
import os
import gmsh
gmsh.initialize()
import fretflow.structure.fem
from mpi4py import MPI
assert MPI.COMM_WORLD.size == 1
children = open(f"/proc/self/task/{os.getpid()}/children").read().split()
mine = set()
for process in ["self", *children]:
    folder = f"/proc/{process}/fd"
    mine |= {os.readlink(f"{folder}/{name}") for name in os.listdir(folder) if os.path.islink(f"{folder}/{name}")}
for table in ("tcp", "tcp6"):
    for row in open(f"/proc/net/{table}").read().splitlines()[1:]:
        cells = row.split()
        if cells[3] == "0A" and f"socket:[{cells[9]}]" in mine:
            print("listens", cells[1])
print("children", *children)
"""


@pytest.fixture
def mesh(tmp_path):
    """Return a mesh beside which lie the commands that gmsh would run when it merges the file."""
    path = tmp_path / "upper.msh"
    build_specimen(Specimen(), Mesh(contact_elements=2), Side.UPPER, path)
    Path(f"{path}.opt").write_text(f'SystemCall "touch {tmp_path}/ran";\n')
    return path


def test_gmsh_runs_no_commands_that_lie_beside_a_mesh(mesh):
    read_mesh(mesh)
    assert not (mesh.parent / "ran").exists()


@pytest.mark.fem
def test_nor_does_it_when_the_mesh_is_read_for_assembly(mesh):
    from fretflow.structure.fem.mesh_file import read_mesh as read
    from mpi4py import MPI

    read(mesh, MPI.COMM_SELF)
    assert not (mesh.parent / "ran").exists()


@pytest.mark.fem
def test_a_mesh_on_which_gmsh_crashes_is_refused(mesh):
    """A node of a number far below zero ends gmsh by a signal, or reads what lies in memory: refused by name."""
    content = bytearray(mesh.read_bytes())
    first_node = content.index(b"$Elements\n") + 70
    content[first_node:first_node + 8] = (-2**20).to_bytes(8, "little", signed=True)
    mesh.write_bytes(content)
    with pytest.raises(MeshError, match=r"upper\.msh: "):
        read_specimen(mesh, Specimen(), Mesh(contact_elements=2), Side.UPPER, mesh.with_name("own.msh"))


def test_a_mesh_whose_elements_have_nodes_that_are_not_there_is_refused(mesh, monkeypatch):
    """What gmsh makes of a damaged number, where memory lets it live on."""
    import gmsh

    every = gmsh.model.mesh.getNodes
    monkeypatch.setattr(gmsh.model.mesh, "getNodes",
                        lambda: (every()[0][1:], every()[1][3:], every()[2]))
    with pytest.raises(MeshError, match=r"upper\.msh: is damaged: its elements name 1 nodes that are not there"):
        read_mesh(mesh)


def test_a_script_that_is_called_a_mesh_is_not_run(tmp_path):
    from fretflow.structure.fem.mesh_file import read_mesh as read
    from mpi4py import MPI

    path = tmp_path / "script.msh"
    path.write_text(f'SystemCall "touch {tmp_path}/ran";\n')
    for reader in (read_mesh, lambda path: read(path, MPI.COMM_SELF)):
        with pytest.raises(MeshError, match=r"script\.msh: is no \.msh file"):
            reader(path)
    assert not (tmp_path / "ran").exists()


def test_a_pipe_in_place_of_a_mesh_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.msh")
    with pytest.raises(MeshError, match=r"pipe\.msh: is no file"):
        read_mesh(tmp_path / "pipe.msh")


@pytest.fixture
def trapped(tmp_path, monkeypatch):
    """Work in a folder whose modules are traps, and return the file that the traps leave."""
    for name in SHADOWED:
        (tmp_path / f"{name}.py").write_text(TRAP.format(str(tmp_path / "caught")))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return tmp_path / "caught"


def test_workers_import_nothing_from_the_working_folder(trapped):
    with LocalPool(2) as pool:
        assert pool(abs, [-1, -2]) == [1, 2]
    assert call_isolated(abs, -3) == 3
    assert not trapped.exists()


@pytest.mark.render
def test_nor_does_the_process_that_looks_for_opengl(trapped):
    from fretflow_post.offscreen import _working_window

    _working_window.cache_clear()
    _working_window()
    assert not trapped.exists()


def test_the_command_line_closes_its_own_path_and_that_of_what_it_starts(monkeypatch):
    for name in (*ranks.CLOSED, *ranks.RANK_VARIABLES, *ranks.SIZE_VARIABLES, "OMPI_MCA_btl", "OMPI_MCA_pml"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    ranks.close_process()
    assert "" not in sys.path
    assert os.environ["PYTHONSAFEPATH"] == "1"
    assert os.environ["OMPI_MCA_btl"] == "self"
    monkeypatch.delenv("OMPI_MCA_btl")
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "0")  # started by mpirun, whose ranks have to reach each other
    ranks.close_process()
    assert "OMPI_MCA_btl" not in os.environ


@pytest.mark.fem
@pytest.mark.parametrize("before", ["", COMMAND_LINE], ids=["from Python", "command line"])
def test_a_single_process_listens_to_nobody_and_starts_no_daemon(tmp_path, before):
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI", "PMI", "PRTE"))}
    done = subprocess.run([sys.executable, "-c", before + LISTENING], capture_output=True, text=True, timeout=120,
                          env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "children", done.stdout
    assert "listens" not in done.stdout


@pytest.mark.fem
def test_options_of_petsc_in_the_working_folder_are_left_alone(tmp_path):
    (tmp_path / ".petscrc").write_text("-fretflow_test 1\n")
    program = ("import fretflow.structure.fem\nfrom petsc4py import PETSc\n"
               "print(PETSc.Options().hasName('fretflow_test'))")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.stdout.split() == ["False"], done.stderr


@pytest.mark.fem
def test_a_reader_of_the_output_that_leaves_is_no_crash(tmp_path):
    """``fretflow run case.toml | head`` ended in PETSc's words about signal 13 and in MPI_ABORT."""
    program = ("import os, fretflow.structure.fem\nread, write = os.pipe()\nos.close(read)\n"
               "try:\n    os.write(write, b'x')\nexcept BrokenPipeError:\n    print('left')")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert (done.stdout.split(), done.stderr) == (["left"], "")


@record
class Secret:
    """One number of a file that nobody named."""

    value: float = quantity("1")


def elsewhere(kind, file, folder):
    """Put an item ``data`` into `file` that is read from elsewhere."""
    other = folder / "other.h5"
    with h5py.File(other, "w") as there:
        there["data"] = np.arange(64.0)
    if kind == "external storage":
        (folder / "secret").write_bytes(np.arange(64.0).tobytes())
        file.create_dataset("data", shape=(64,), dtype=float, external=[(str(folder / "secret"), 0, 512)])
    elif kind == "virtual":
        layout = h5py.VirtualLayout(shape=(64,), dtype=float)
        layout[:] = h5py.VirtualSource(str(other), "data", shape=(64,))
        file.create_virtual_dataset("data", layout)
    else:
        file["own"] = np.arange(64.0)
        file["data"] = h5py.ExternalLink(str(other), "data") if kind == "external link" else h5py.SoftLink("/own")


@pytest.mark.parametrize("kind", ["external storage", "virtual", "external link", "soft link"])
def test_hdf5_is_read_from_the_named_file_alone(tmp_path, kind):
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    for name in ("a.h5", "a.mat"):
        with h5py.File(tmp_path / name, "w", userblock_size=512) as file:
            elsewhere(kind, file, tmp_path)
        content = (tmp_path / name).read_bytes()
        if name == "a.mat":
            (tmp_path / name).write_bytes(head.ljust(512, b"\0") + content[512:])
        for reader in (read_table, read_structure):
            with pytest.raises(InputError, match=rf"{name}: /data is a link or lies in another file"):
                reader(tmp_path / name)
    path = write_record(tmp_path / "record.h5", Secret(value=1.0))
    with h5py.File(path, "a") as file:
        group = file.create_group("below")
        elsewhere(kind, group, tmp_path)
    with pytest.raises(InputError, match=r"record\.h5: /below/data is a link"):
        read_record(path, Secret)


def test_groups_that_run_in_a_circle_are_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        twice = file.create_group("one")
        file["two"] = twice  # the same under another name leads nowhere
        twice["data"] = np.arange(64.0)
    with open_hdf5(tmp_path / "a.h5") as file:
        assert file["two/data"][3] == 3.0
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["one/up"] = file["/"]
    with pytest.raises(InputError, match=r"a\.h5: /one/up is a link"):
        read_structure(tmp_path / "a.h5")


STEERING = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e"


def test_text_of_files_and_paths_does_not_steer_the_terminal(tmp_path, capsys):
    case = tmp_path / f"ca{STEERING}se.toml"
    assert execute(["init", str(case)]) == 0
    title = 'title = "a\\u001b]0;owned\\u0007\\u001b[2J title"'
    lines = [line for line in case.read_text().splitlines() if not line.startswith("title")]
    case.write_text("\n".join([title, *lines]))
    assert execute(["show", str(case)]) == 0
    case.write_text("x")
    assert execute(["show", str(case)]) == 2
    assert execute(["loops", str(case)]) == 2
    seen = capsys.readouterr()
    for text in (seen.out, seen.err):
        assert "owned" in text
        assert not set(text) & set(STEERING) - set("owned]0;[2J31m")


def test_tables_and_lines_keep_rich_text_but_no_codes_of_the_user(capsys):
    from fretflow.cli.terminal import Terminal, new_table

    view = new_table(f"title {STEERING}", f"heading {STEERING}")
    view.add_row(f"cell {STEERING}")
    terminal = Terminal(force_terminal=True, color_system="truecolor", width=60)
    terminal.print(view)
    terminal.print(f"[bold]line[/bold] {STEERING}")
    seen = capsys.readouterr().out
    assert "\x1b[1mline\x1b[0m" in seen
    assert not any(code in seen for code in ("\x1b]", "\x1b[2J", "\x9b", "\x07", "\u202e"))


def test_good_files_damaged_at_random_are_taken_or_refused_in_a_line(tmp_path):
    script = Path(__file__).with_name("damaged_inputs.py")
    done = subprocess.run([sys.executable, script, "14", "1"], env={**os.environ, "TMPDIR": str(tmp_path)},
                          capture_output=True, text=True, timeout=300, check=True)
    assert done.stderr == ""
    rows = [row.split() for row in done.stdout.splitlines()]
    assert sum(int(count) for _, count, _ in rows) == 14
    assert {result for _, _, result in rows} == {"taken", "refused"}
