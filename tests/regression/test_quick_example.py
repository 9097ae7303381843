"""The quick example through the command line, from meshes to pictures.

What carries the weight: the load that went in comes out of the contact, the reduced models meet the full ones, wear
volume follows dissipated energy, and a second call computes nothing.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from fretflow import cli
from fretflow.cli_pipeline import complete_stages
from fretflow.core.config import load_case
from fretflow.core.store import read_record
from fretflow.wear.history import WearHistory

pytestmark = [pytest.mark.fem, pytest.mark.render]

QUICK = Path(__file__).parents[2] / "examples" / "quick.toml"


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs")
    assert cli.execute(["run", str(QUICK), "--out", str(out)]) == 0
    return out / "quick"


def test_the_summary_holds_what_went_in_and_what_must_follow(home):
    summary = json.loads((home / "summary.json").read_text())
    found = {figure["name"]: figure["value"] for figure in summary["figures"]}
    assert found["static load"] == pytest.approx(60.0, rel=1e-10)
    assert 0.0 < found["Craig-Bampton error"] < 1e-3
    assert found["friction coefficient off the loop"] == pytest.approx(0.88, rel=0.01)
    assert 0.0 < found["mean wear depth"] <= found["largest wear depth"]
    assert found["wear volume"] == pytest.approx(found["mean wear depth"] * 1e-6, rel=1e-6)  # over 1 mm^2
    assert len(summary["trends"]) == 5


def test_in_gross_slip_wear_volume_follows_dissipated_energy(home):
    case = load_case(QUICK)
    history = read_record(complete_stages(home)["wear"] / "history.h5", WearHistory)
    energy = np.sum(history.dissipated_energy[:-1] * np.diff(history.cycles))
    expected = case.wear.coefficient / case.contact.friction_coefficient * energy
    assert history.volume[-1] == pytest.approx(expected, rel=1e-6)


def test_pictures_and_curves_are_there_and_render_draws_them_again(home, capsys):
    folder = complete_stages(home)["render"]
    names = {path.name for path in folder.iterdir()}
    assert {"pressure.png", "wear_depth.png", "loops.csv", "response.csv", "modes.csv", "wear_volume.csv"} <= names
    assert cli.execute(["render", str(home)]) == 0
    assert {path.name for path in (home / "pictures").iterdir()} == names - {"manifest.json"}
    assert str(home / "pictures" / "pressure.png") in capsys.readouterr().out


def test_a_second_call_computes_nothing_and_modes_reuses_the_meshes(home, capsys):
    assert cli.execute(["run", str(QUICK), "--out", str(home.parent)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if re.match(r"\w+ +\S+ +/", line)]
    assert len(lines) == 7
    assert all(" reused " in line for line in lines)
    assert cli.execute(["modes", str(QUICK), "--out", str(home.parent)]) == 0
    assert "Craig-Bampton" in capsys.readouterr().out
    assert (home / "modes.csv").is_file()
    assert (home / "modes.png").is_file()
