"""Crowned and cylindrical faces through the command line, from meshes to pictures, on a small mesh.

What carries the weight: the first contact against Hertz, growth of its area to the whole square, volume against
dissipated energy; that crossed cylinders are the crown they must be, and one cylinder a line; and that the summary
does not judge a curved face by the paper's flat ones.
"""

import json

import numpy as np
import pytest
from fretflow import cli
from fretflow.core.store import read_record
from fretflow.pipeline.stages import complete_stages
from fretflow.solvers.periodic import PeriodicSolution
from fretflow.structure.fem.preload import Preload
from fretflow.structure.reduction.reduced_specimen import ReducedSpecimen
from fretflow.wear.history import WearHistory

pytestmark = [pytest.mark.fem, pytest.mark.render]

CASE = """
format = "fretflow-case/1"
name = "{name}"
{faces}

[test]
excitation_amplitude = "75 N"
cycles = 60_000

[mesh]
contact_elements = 6

[solver]
harmonics = 9
samples = 64

[wear]
coefficient = "1.1e-14 m^2/N"
tolerance = 0.05

[output.frequency_response]
start = "90 Hz"
stop = "200 Hz"
points = 2
"""
CROWN = '[specimen.upper]\nface = "crowned"\nface_radius = "100 mm"'
LINE = '[specimen.lower]\nface = "cylindrical"\nface_radius = "100 mm"'
CROSSED = LINE.replace(".lower", "")
MODULUS = 193e9 / (2 * (1 - 0.29**2))
HERTZ = (3 * 60 * 0.1 / (4 * MODULUS))**(1 / 3)


def run(folder, name, faces, *until):
    case = folder / f"{name}.toml"
    case.write_text(CASE.format(name=name, faces=faces))
    assert cli.execute(["run", str(case), "--out", str(folder), *until]) == 0
    return folder / name


def pressed(home):
    """Return the places (n, 2), the areas and the preload."""
    stages = complete_stages(home)
    upper = read_record(stages["reduce"] / "upper.h5", ReducedSpecimen)
    return upper.contact_nodes[:, :2], upper.contact_areas, read_record(stages["preload"] / "preload.h5", Preload)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def crowned(folder):
    return run(folder, "crowned", CROWN)


def test_the_first_contact_is_near_that_of_hertz(crowned):
    """Off by what a ridge as wide as three contact radii gives way beyond a half-space."""
    place, _, contact = pressed(crowned)
    radius = np.sqrt(2.5 * contact.force @ np.sum(place**2, axis=1) / 60.0)
    assert radius == pytest.approx(HERTZ, rel=0.05)
    assert contact.pressure.max() == pytest.approx(1.5 * 60.0 / (np.pi * HERTZ**2), rel=0.1)


def test_the_contact_grows_to_the_square_by_the_dissipated_energy(crowned):
    history = read_record(complete_stages(crowned)["wear"] / "history.h5", WearHistory)
    worn = (history.rate > 0.0).sum(axis=1)
    assert np.all(np.diff(worn) >= 0)
    assert worn[0] < 30
    assert worn[-1] == 49
    energy = history.dissipated_energy
    total = np.sum(0.5 * (energy[1:] + energy[:-1]) * np.diff(history.cycles))
    assert history.volume[-1] == pytest.approx(1.1e-14 / 0.88 * total, rel=2e-3, abs=0.0)


def test_curved_faces_are_not_judged_by_flat_ones(crowned):
    summary = json.loads((crowned / "summary.json").read_text())
    assert summary["trends"] == []  # the paper's claims are of its own bodies
    _, areas, contact = pressed(crowned)
    mean = 60.0 / areas[contact.force > 0.0].sum()
    load = next(figure["text"] for figure in summary["figures"] if figure["name"] == "static load")
    assert f"mean {mean / 1e6:.4g} MPa over" in load


def test_the_pictures_are_drawn(crowned):
    names = {path.name for path in complete_stages(crowned)["render"].iterdir()}
    assert {"pressure.png", "wear_depth.png", "wear_shape.png", "stick_slip_unworn.png", "loops.png"} <= names


def test_crossed_cylinders_are_a_crown(crowned, folder):
    """Both gaps are (x^2 + y^2) / (2 R), so that the period must be the same."""
    crossed = run(folder, "crossed", CROSSED, "--until", "solve")
    a, b = (read_record(complete_stages(home)["solve"] / "solution.h5", PeriodicSolution)
            for home in (crowned, crossed))
    assert a.force == pytest.approx(b.force, rel=0.0, abs=1e-6)
    assert a.displacement == pytest.approx(b.displacement, rel=0.0, abs=1e-12)


def test_one_cylinder_makes_a_line_across_the_sliding(folder):
    place, _, contact = pressed(run(folder, "line", LINE, "--until", "preload"))
    closed = contact.force > 0.0
    assert np.array_equal(np.unique(place[closed, 1].round(9)), np.unique(place[:, 1].round(9)))
    assert np.abs(place[closed, 0]).max() < 0.4e-3
    half_width = 2.0 * np.sqrt(contact.force @ place[:, 0]**2 / 60.0)  # mean x^2 is b^2 / 4
    assert half_width == pytest.approx(np.sqrt(4 * 60e3 * 0.1 / (np.pi * MODULUS)), rel=0.1)
