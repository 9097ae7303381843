"""The launcher: it sets up exactly what is missing, heals what was cut short, and says what it cannot do.

What carries the weight: a copy of the real script runs in a folder of its own, whose name has a space, with
stand-ins for Debian's commands that note each call in a journal. So each test sees which commands a state of
the machine leads to, without network and root; the exit codes and messages are the script's own.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
TOOLS = ("sh", "env", "dirname", "readlink", "cat", "cp", "mkdir", "rm", "sha256sum", "flock", "grep", "sed",
         "head", "chmod", "sleep", "touch", "true", "uname")

# Only gcc is installed until the file "installed" is there.
DPKG_QUERY = """#!/bin/sh
shift 3
for package in "$@"; do
    if [ -e "$WORLD/installed" ] || [ "$package" = gcc ]; then printf '<%s installed>' "$package"; fi
done
"""
APT_GET = """#!/bin/sh
echo "apt-get $*" >>"$WORLD/journal"
case "$1 $APT_SAYS" in
    'update '*resolving*) echo "Err:1 http://deb.debian.org/debian trixie InRelease $APT_SAYS"; exit 0 ;;
    'update '*) echo 'Hit:1 http://deb.debian.org/debian trixie InRelease'; exit 0 ;;
esac
[ -z "$APT_SAYS" ] || { echo "$APT_SAYS"; exit 100; }
touch "$WORLD/installed"
"""
# Python as the launcher uses it: -m venv copies it, -m pip makes the program, slowly if told so by a file.
PYTHON = """#!/bin/sh
echo "python $*" | head -n 1 >>"$WORLD/journal"
case "$1 $2" in
    '-m venv') mkdir -p "$4/bin" && cp "$0" "$4/bin/python" ;;
    '-m pip')
        [ -z "$PIP_SAYS" ] || { echo "$PIP_SAYS"; exit 1; }
        [ ! -e "$WORLD/slow" ] || { touch "$WORLD/started"; sleep 2; }
        cp "$WORLD/program" "$(dirname "$0")/fretflow" ;;
    '-m pytest') echo "pytest in $(pwd)" ;;
    '-m sphinx') flock -n .setup.log true && echo "others may set up" ;;
    '-c from'*) echo 'numpy==1.24.2' ;;
esac
"""
PROGRAM = """#!/bin/sh
echo "fretflow in $(pwd)"
printf '%s\\n' "$@"
"""
SUDO = """#!/bin/sh
[ "$1" != -n ] || shift
echo "sudo $*" | head -n 1 >>"$WORLD/journal"
exec "$@"
"""


class World:
    """A machine of stand-ins with a clone of the launcher on it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.clone = root / "a clone"
        self.bin = root / "bin"
        for folder in (self.clone, self.bin, root / "elsewhere"):
            folder.mkdir()
        for name in TOOLS:
            (self.bin / name).symlink_to(Path("/usr/bin") / name)
        for name, text in {"dpkg-query": DPKG_QUERY, "apt-get": APT_GET, "python3": PYTHON,
                           "dpkg": "#!/bin/sh\n", "id": "#!/bin/sh\necho ${WHO:-0}\n"}.items():
            self.command(name, text)
        (root / "program").write_text(PROGRAM)
        (root / "program").chmod(0o755)
        self.system("debian", "13")
        script = (PROJECT / "fretflow").read_text()
        for line, stand_in in {"PYTHON=/usr/bin/python3\n": f"PYTHON={self.bin}/python3\n",
                               "OS_RELEASE=/etc/os-release\n": f"OS_RELEASE={root}/os-release\n"}.items():
            assert script.count(line) == 1
            script = script.replace(line, stand_in)
        (self.clone / "fretflow").write_text(script)
        (self.clone / "fretflow").chmod(0o755)
        (self.clone / "pyproject.toml").write_text("[project]\n")
        (self.clone / "constraints.txt").write_text("rich==15\n")
        commands = self.clone / "workflow" / "fretflow" / "cli"
        commands.mkdir(parents=True)
        for file in (PROJECT / "workflow" / "fretflow" / "cli").glob("*.py"):
            (commands / file.name).write_text(file.read_text())

    def system(self, name: str, version: str) -> None:
        (self.root / "os-release").write_text(f'ID={name}\nVERSION_ID="{version}"\n')

    def command(self, name: str, text: str) -> None:
        (self.bin / name).write_text(text)
        (self.bin / name).chmod(0o755)

    def start(self, *arguments: str, program: Path | None = None, **environment: str):
        # Where the tests themselves run in the background of a script, SIGINT would be ignored.
        return subprocess.Popen(
            ["/usr/bin/env", "--default-signal=INT", str(program or self.clone / "fretflow"), *arguments],
            cwd=self.root / "elsewhere",
            env={"PATH": str(self.bin), "WORLD": str(self.root), **environment},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)

    def run(self, *arguments: str, program: Path | None = None, **environment: str) -> tuple[int, str, str]:
        process = self.start(*arguments, program=program, **environment)
        out, err = process.communicate(timeout=60)
        return process.returncode, out, err

    def journal(self) -> list[str]:
        """Return the calls since the last look."""
        path = self.root / "journal"
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return lines


@pytest.fixture
def world(tmp_path) -> World:
    return World(tmp_path)


def kinds(journal: list[str]) -> list[str]:
    """Shorten a journal to what was done."""
    names = {"update": "update", "install": "install", "-m venv": "venv", "-m pip": "pip"}
    return [name for line in journal for key, name in names.items() if line.split(" ", 1)[1].startswith(key)]


def test_first_call_sets_up_and_hands_over(world):
    (world.root / "elsewhere" / "my case.toml").touch()
    code, out, err = world.run("run", "my case.toml")
    assert code == 0
    assert out.splitlines() == [f"fretflow in {world.root}/elsewhere", "run", "my case.toml"]
    assert err.count("\n") == 6
    journal = world.journal()
    assert kinds(journal) == ["update", "install", "venv", "pip", "pip"]
    install = next(line for line in journal if line.startswith("apt-get install"))
    assert " python3-dolfinx-real" in install
    assert " gcc" not in install, "it is installed already"
    assert " chromium" not in install, "only the tests need it"
    constraints = (world.clone / ".venv" / "constraints.txt").read_text()
    assert constraints.splitlines() == ["rich==15", "numpy==1.24.2"]


@pytest.mark.parametrize(("arguments", "words"), [
    (("run", "--help"), "until\n    last stage to run: mesh, reduce"),
    (("init", "-h"), "recording\n    file of loops, CSV"),
    (("response", "runs/test1", "--help"), "highest frequency"),
    (("test", "--help"), "ARGS go to pytest"), (("docs", "-h"), "ARGS go to sphinx-build")])
def test_help_on_a_command_sets_nothing_up(world, arguments, words):
    world.system("slackware", "15")  # none that the program runs on
    code, out, err = world.run(*arguments)
    assert (code, err, world.journal()) == (0, "", [])
    assert out.startswith(f"Usage: fretflow {arguments[0]} ")
    assert words in out
    assert '"""' not in out
    assert not (world.clone / ".venv").exists()


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_help_alone_sets_nothing_up(world, arguments):
    world.system("slackware", "15")  # none that the program runs on
    code, out, err = world.run(*arguments)
    assert (code, err, world.journal()) == (0, "", [])
    for name in ("calibrate", "diagnose", "effects", "init and show", "loops", "modes", "run", "trial", "verify"):
        assert f"\n  {name}: " in out
    assert not (world.clone / ".venv").exists()


def test_the_version_sets_nothing_up(world):
    (world.clone / "pyproject.toml").write_text('[project]\nname = "fretflow"\nversion = "1.2.3"\n')
    assert world.run("--version") == (0, "1.2.3\n", "")
    assert world.journal() == []


@pytest.mark.parametrize("arguments", [("diagnoze", "--help"), ("runs/test1",)])
def test_an_unknown_command_sets_nothing_up(world, arguments):
    code, out, err = world.run(*arguments)
    assert (code, out, world.journal()) == (2, "", [])
    assert err == f'fretflow: Unknown command "{arguments[0]}"; `fretflow --help` tells what there is\n'
    assert not (world.clone / ".venv").exists()


def test_a_file_that_is_not_there_sets_nothing_up(world):
    code, out, err = world.run("run", "examples/quick.tom.toml")
    assert (code, out, world.journal()) == (2, "", [])
    assert err == "fretflow: examples/quick.tom.toml: there is no such file\n"


def test_a_case_that_is_to_be_written_need_not_be_there(world):
    code, out, _ = world.run("init", "mine.toml")
    assert (code, out.splitlines()[1:]) == (0, ["init", "mine.toml"])


def test_help_on_the_site_makes_none(world):
    world.run("docs")
    code, out, err = world.run("docs", "--help")
    assert (code, out, err) == (0, "others may set up\n", "")  # what the stand-in for sphinx says


def test_later_calls_do_nothing_but_hand_over(world):
    world.run("modes")
    world.journal()
    assert world.run("modes")[0::2] == (0, "")
    assert world.journal() == []


@pytest.mark.parametrize("file", ["pyproject.toml", "constraints.txt", "fretflow"])
def test_an_update_of_the_clone_is_installed_into_the_same_environment(world, file):
    world.run("modes")
    world.journal()
    with (world.clone / file).open("a") as handle:
        handle.write("# newer\n")
    assert world.run("modes")[0] == 0
    assert kinds(world.journal()) == ["pip", "pip"]


def test_a_moved_clone_gets_a_new_environment(world):
    world.run("modes")
    world.journal()
    world.clone = world.clone.rename(world.root / "moved")
    assert world.run("modes")[0] == 0
    assert kinds(world.journal()) == ["venv", "pip", "pip"]


def test_through_a_symlink(world):
    link = world.root / "elsewhere" / "ff"
    link.symlink_to(world.clone / "fretflow")
    assert world.run("modes", program=link)[0] == 0
    assert (world.clone / ".venv" / "base.stamp").is_file()


def test_the_test_command_adds_the_development_parts_once(world):
    world.run("modes")
    world.journal()
    code, out, _ = world.run("test", "-k", "wear")
    assert (code, out) == (0, f"pytest in {world.clone}\n")
    journal = world.journal()
    assert kinds(journal) == ["pip", "pip"]
    assert journal[-3].endswith("-e .[dev]")
    assert journal[-1].endswith("-k wear")
    assert kinds((world.run("modes"), world.journal())[1]) == []


def test_a_site_that_is_built_keeps_nobody_from_setting_up(world):
    assert world.run("docs")[:2] == (0, "others may set up\n")


def test_the_test_command_installs_what_only_tests_need(world):
    world.run("test")
    install = next(line for line in world.journal() if line.startswith("apt-get install"))
    assert " python3-dolfinx-real" in install
    assert " chromium" in install


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_set_up_heals(world, how):
    (world.root / "installed").touch()
    (world.root / "slow").touch()
    process = world.start("modes")
    deadline = time.monotonic() + 30
    while not (world.root / "started").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, how)
    _, err = process.communicate(timeout=30)
    assert process.returncode == (130 if how is signal.SIGINT else -how)
    assert ("interrupted; the next call" in err) == (how is signal.SIGINT)
    (world.root / "slow").unlink()
    world.journal()
    assert world.run("modes")[0] == 0
    assert kinds(world.journal()) == ["venv", "pip", "pip"]


def test_two_at_once_set_up_once(world):
    (world.root / "installed").touch()
    (world.root / "slow").touch()
    first = world.start("modes")
    while not (world.root / "started").exists():
        time.sleep(0.01)
    second = world.start("modes")
    errors = [p.communicate(timeout=60)[1] for p in (first, second)]
    assert (first.returncode, second.returncode) == (0, 0)
    assert "another set-up is at work here" in errors[1]
    assert kinds(world.journal()) == ["venv", "pip", "pip"]


@pytest.mark.parametrize(("name", "version"), [("ubuntu", "24.04"), ("debian", "11"), ("debian", "")])
def test_another_system(world, name, version):
    world.system(name, version)
    code, out, err = world.run("modes")
    assert (code, out) == (2, "")
    assert err.startswith(f"fretflow: needs Debian 12 or 13 and this is {name} {version}".rstrip())
    assert err.count("\n") == 1
    assert world.journal() == []


@pytest.mark.parametrize("sudo", ["", "refuses"])
def test_neither_root_nor_sudo(world, sudo):
    if sudo:
        world.command("sudo", "#!/bin/sh\nexit 1\n")
    code, _, err = world.run("modes", WHO="1000")
    assert code == 2
    last = err.splitlines()[-1]
    assert "neither root nor allowed to use sudo" in last
    assert "run: apt-get update && apt-get install --no-install-recommends ca-certificates" in last
    assert world.journal() == []


def test_sudo_is_used_where_it_is_needed(world):
    world.command("sudo", SUDO)
    assert world.run("modes", WHO="1000")[0] == 0
    journal = world.journal()
    assert any(line.startswith("sudo env DEBIAN_FRONTEND=noninteractive") for line in journal)
    assert kinds(journal) == ["update", "install", "venv", "pip", "pip"]


@pytest.mark.parametrize(("tool", "says", "advice"), [
    ("APT_SAYS", "Temporary failure resolving 'deb.debian.org'", "no network"),
    ("APT_SAYS", "E: No space left on device", "the disk is full"),
    ("PIP_SAYS", "Failed to establish a new connection: [Errno 101]", "no network"),
    ("PIP_SAYS", "the dependency resolver found ResolutionImpossible", "the log says why"),
])
def test_a_failed_step_says_what_to_do_and_heals(world, tool, says, advice):
    code, _, err = world.run("modes", **{tool: says})
    assert code == 2
    last = err.splitlines()[-1]
    assert advice in last
    assert f"(log: {world.clone}/.setup.log)" in last
    assert says in (world.clone / ".setup.log").read_text()
    assert world.run("modes")[0] == 0


def test_without_a_mirror_no_package_is_tried(world):
    world.run("modes", APT_SAYS="Temporary failure resolving 'deb.debian.org'")
    assert kinds(world.journal()) == ["update"]


def test_a_folder_that_cannot_be_written(world):
    (world.clone / ".setup.log").mkdir()
    code, _, err = world.run("modes")
    assert code == 2
    assert err.startswith(f"fretflow: cannot write in {world.clone}")
    assert world.journal() == []


def test_other_pythons_do_not_mix_in(world):
    (world.root / "installed").touch()
    world.run("modes")
    program = world.clone / ".venv" / "bin" / "fretflow"
    program.write_text('#!/bin/sh\necho ${PYTHONPATH-none} ${PYTHONHOME-none} $PYTHONNOUSERSITE $PETSC_DIR\n')
    _, out, _ = world.run("modes", PYTHONPATH="/opt/x", PYTHONHOME="/opt/y", PETSC_DIR="/opt/petsc")
    assert out == "none none 1 /usr/lib/petscdir/petsc-real\n"


def test_no_module_is_taken_from_the_folder_of_the_call(world):
    (world.root / "program").write_text('#!/bin/sh\necho "safe path $PYTHONSAFEPATH"\n')
    assert world.run("modes")[1] == "safe path 1\n"
