"""What holds for every test: no display, one BLAS thread, quiet MPI, and no silent skips where CI is set."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

RECORDINGS_VARIABLE = "FRETFLOW_RECORDINGS"
# Tests that CI must run: a skip of one of them is a failure there.
ESSENTIAL = ("fem", "mpi", "render", "real_data")

# Set before NumPy is imported, and inherited by the ranks that mpirun starts.
os.environ.update({"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"})
os.environ.pop("DISPLAY", None)
# Two ranks on any machine, as root in a container too, without warnings on its network.
os.environ.update({
    "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_btl": "^tcp,openib", "OMPI_MCA_btl_base_warn_component_unused": "0",
    "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
    "OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_hwloc_base_binding_policy": "none", "PRTE_MCA_hwloc_default_binding_policy": "none",
})
# No test is timed: a busy machine may be slow in drawing examples, too.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")
# Also where a test imports dolfinx 0.5: keep its libraries out of the global scope, see fretflow.assembly.
sys.setdlopenflags = lambda flags: None


def recordings_folder() -> Path:
    """Return the folder that FRETFLOW_RECORDINGS names, or shared/recordings beside the project."""
    beside = Path(__file__).parents[2] / "shared" / "recordings"
    return Path(os.environ.get(RECORDINGS_VARIABLE) or beside)


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Return the folder of measured recordings, which only tests marked real_data may use."""
    return recordings_folder()


def in_ci() -> bool:
    """Return whether the CI variable is set, so that nothing may be skipped for want of something."""
    return os.environ.get("CI", "").lower() not in ("", "0", "false")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("real_data") and not recordings_folder().is_dir():
        pytest.skip(f"no recordings in {recordings_folder()}; {RECORDINGS_VARIABLE} names another folder")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    essential = [m for m in ESSENTIAL if item.get_closest_marker(m)]
    if report.skipped and not hasattr(report, "wasxfail") and essential and in_ci():
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid} is marked {', '.join(essential)} and was skipped; CI forbids that"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    if report.skipped and in_ci():
        report.outcome = "failed"
        report.longrepr = f"{report.nodeid} was skipped as a whole; CI forbids that"
    return report


@pytest.fixture(scope="session")
def structures():
    """Return small structures with friction joints: parallel sliders, and a lap of two beams."""
    file = Path(__file__).parent / "analytic" / "lap_structures.py"
    spec = importlib.util.spec_from_file_location("lap_structures", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
