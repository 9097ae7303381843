"""Property: two sliders in a chain of masses, whose motion leaves the shape of its mode as they slip, are no riddle.

The recording is a decay that an integration of the test's own makes: average acceleration with Jenkins elements.
"""

from __future__ import annotations

from math import hypot, log

import numpy as np
import pytest
from fretflow.experiments.structure.experiment import StructureExperiment
from fretflow.experiments.structure.points import ROUGH, noise_of
from fretflow.experiments.structure.run import begin_baselines, diagnose_structure
from fretflow.inference.experiment import Point
from fretflow.inference.parameters import HALF
from fretflow.inference.search import FAST
from fretflow.inference.strategy import start_search
from fretflow.inference.verdict import Verdict
from fretflow.recordings.kinds.structures import read_structure_recording
from fretflow.solvers.nonlinear_modes.ring_down import instantaneous_mode
from scipy.linalg import eigh

MASS = np.array([1.0, 0.7, 1.6, 0.9])  # kg, in a row from the ground on
SPRINGS = 1e6 * np.array([1.0, 1.3, 0.8, 1.1])  # N/m, before each mass
AT, HELD, SHARES = (1, 3), 1e6 * np.array([0.25, 0.2]), np.array([0.45, 0.55])  # sliders: mass, N/m, part of the bolts
LOAD, FRICTION, DAMPING, OTHERS, MODE = 1000.0, 0.4, 2e-3, 0.05, 2  # OTHERS: damping of the other modes
RANGES = {"bolt_load": (300.0, 3000.0), "friction_coefficient": (0.15, 0.9), "modal_damping": (1e-4, 1e-2)}
TOML = """
format = "fretflow-recording/1"
[test]
kind = "structure"
[structure]
matrices = "structure.npz"
[structure.unknown]
bolt_load = ["{bolts[0]} N", "{bolts[1]} N"]
friction_coefficient = [0.15, 0.9]
modal_damping = [1e-4, 1e-2]
[backbone]
file = "backbone.csv"
amplitude_of = "modal"
mode = 3
amplitude = {{ column = "a", unit = "m*kg^0.5" }}
frequency = {{ column = "f", unit = "Hz" }}
damping = {{ column = "zeta", unit = "1" }}
"""


def chain():
    """Return the stiffness (4, 4) of the masses in a row."""
    rows = np.eye(4) - np.eye(4, k=-1)
    return rows.T @ (SPRINGS[:, None] * rows)


def decay(amplitude, periods, steps=400):
    """Return time (N,), the mode's coordinate (N,) and its frequency: struck in the mode with both sliders stuck."""
    touch = np.eye(4)[list(AT)]
    stuck = chain() + touch.T @ (HELD[:, None] * touch)
    values, shapes = eigh(stuck, np.diag(MASS))
    omega = np.sqrt(values)
    loss = np.diag(MASS) @ shapes @ np.diag(2.0 * np.where(np.arange(4) == MODE, DAMPING, OTHERS) * omega) @ (
        shapes.T @ np.diag(MASS))
    step = 2.0 * np.pi / omega[MODE] / steps
    inverse = np.linalg.inv(np.diag(MASS) * 4.0 / step**2 + loss * 2.0 / step + chain())
    x, v, a, anchored = np.zeros(4), amplitude * omega[MODE] * shapes[:, MODE], np.zeros(4), np.zeros(2)
    reach = FRICTION * LOAD * SHARES / HELD
    seen = np.zeros(periods * steps)
    for k in range(len(seen)):
        seen[k] = shapes[:, MODE] @ (MASS * x)
        free = np.diag(MASS) @ (4.0 / step**2 * x + 4.0 / step * v + a) + loss @ (2.0 / step * x + v)
        after = x
        for _ in range(20):
            stretch = np.clip(touch @ after - anchored, -reach, reach)
            after, before = inverse @ (free - touch.T @ (HELD * stretch)), after
            if np.abs(after - before).max() < 1e-12 * amplitude:
                break
        anchored = touch @ after - np.clip(touch @ after - anchored, -reach, reach)
        new = 4.0 / step**2 * (after - x) - 4.0 / step * v - a
        x, v, a = after, v + 0.5 * step * (a + new), new
    return step * np.arange(len(seen)), seen, omega[MODE] / (2.0 * np.pi)


@pytest.fixture(scope="module")
def seen():
    """Return frequency and damping of the decay over its amplitude, smallest first."""
    mode = instantaneous_mode(*decay(8e-3, 90))
    rising = np.argsort(mode.amplitude)
    rising = rising[mode.amplitude[rising] > 0.12 * mode.amplitude.max()]
    return mode.amplitude[rising], mode.frequency[rising], mode.damping[rising]


def written(folder, seen, bolts):
    amplitude, frequency, damping = seen
    n, rng = 4 + 3 * len(AT), np.random.default_rng(3)
    k, contact, preload = np.zeros((n, n)), np.zeros((3 * len(AT), n)), np.zeros(n)
    k[:4, :4] = chain()
    for j, (mass, spring, share) in enumerate(zip(AT, HELD, SHARES, strict=True)):
        x = 4 + 3 * j
        k[mass, mass] += spring
        k[x, mass] = k[mass, x] = -spring
        k[x, x] = k[x + 1, x + 1] = k[x + 2, x + 2] = spring
        contact[3 * j:3 * j + 3, x:x + 3] = np.eye(3)
        preload[x + 2] = -share
    np.savez(folder / "structure.npz", M=np.diag(np.r_[MASS, np.zeros(3 * len(AT))]), K=k, contact_map=contact,
             areas=np.full(len(AT), 1e-4), points=np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]]), preload=preload,
             **{"outputs/tip": np.eye(n)[3]})
    rows = np.c_[amplitude, frequency * (1.0 + 1e-4 * rng.standard_normal(len(frequency))),
                 damping * (1.0 + 0.04 * rng.standard_normal(len(damping)))]
    np.savetxt(folder / "backbone.csv", rows, delimiter=",", header="a,f,zeta", comments="")
    (folder / "recording.toml").write_text(TOML.format(bolts=bolts))
    return read_structure_recording(folder)


def at_truth(experiment):
    space = experiment.parameters(())
    truth = {"bolt_load": LOAD, "friction_coefficient": FRICTION, "modal_damping": DAMPING}
    return Point(space, np.array([(log(truth[one.field]) - one.middle) / one.size for one in space.coordinates]))


def test_predictions_are_those_of_the_motion_and_not_of_the_mode_that_it_leaves(seen, tmp_path):
    experiment = StructureExperiment.of(written(tmp_path, seen, (300.0, 3000.0)))
    frequency, damping = experiment.predict(at_truth(experiment)).values.reshape(2, -1)
    place = np.log(experiment.points.amplitude)
    measured = [np.interp(place, np.log(seen[0]), one) for one in seen[1:]]
    assert frequency == pytest.approx(measured[0], rel=2e-4)  # loads in the mode's own shape: 1.3e-2
    assert np.median(np.abs(damping / measured[1] - 1.0)[-6:]) < 0.04  # 0.53


def test_nothing_is_lost_where_nothing_slides_wherever_between_the_points_that_begins(seen, tmp_path):
    experiment = StructureExperiment.of(written(tmp_path, seen, (300.0, 3000.0)))
    truth = at_truth(experiment)
    at = [one.field for one in truth.parameters.coordinates].index("bolt_load")
    for more in np.linspace(-0.2, 0.05, 6):  # of a sd, which is a factor of two: points are 5 % apart
        damping = experiment.predict(Point(truth.parameters, truth.z + more * np.eye(3)[at])).values.reshape(2, -1)[1]
        assert damping[:6] == pytest.approx(np.full(6, DAMPING), rel=1e-3)


@pytest.mark.parametrize("off", [0.0, -0.015])
def test_nothing_is_missing_and_of_load_and_friction_the_product_alone_is_told(seen, tmp_path, off):
    """Also of parts that sound otherwise than their matrices, as those of a drawing do."""
    parts = seen[0], (1.0 + off) * seen[1], seen[2]
    diagnosis = diagnose_structure(written(tmp_path, parts, (300.0, 3000.0)), True, lambda share, text: None)
    assert diagnosis.verdict is Verdict.NONE
    assert any("are 1.5 % below theirs" in note for note in diagnosis.notes) == (off < 0.0)
    curve = diagnosis.curves[0]  # what is drawn has that error in it
    assert curve.before == pytest.approx(curve.measured, rel=1e-3)
    values = {one.name.removeprefix("structure."): one for one in diagnosis.parameters}
    for name, truth in (("bolt_load", LOAD), ("friction_coefficient", FRICTION)):
        assert values[name].low < truth < values[name].high
    assert values["bolt_load"].value * values["friction_coefficient"].value == pytest.approx(LOAD * FRICTION, rel=0.03)
    # normal forces do not change, so that what is known of the load is what was known of both, their product given
    known = [log(high / low) / (2.0 * HALF) for low, high in (RANGES["bolt_load"], RANGES["friction_coefficient"])]
    sd = log(values["bolt_load"].high / values["bolt_load"].low) / (2.0 * HALF)
    assert sd == pytest.approx(known[0] * known[1] / hypot(*known), rel=0.1)


def test_a_baseline_is_found_from_a_load_at_which_all_stick(seen, tmp_path):
    experiment = StructureExperiment.of(written(tmp_path, seen, (600.0, 2e5)))
    search = start_search(experiment, experiment.first_prediction(), FAST, lambda task, asked: [*map(task, asked)])
    begin_baselines(experiment, search)
    values = search.baseline.parameters.values(search.baseline.z)[""]
    assert values["bolt_load"] * values["friction_coefficient"] == pytest.approx(LOAD * FRICTION, rel=0.03)


def test_noise_that_few_points_do_not_tell_apart_counts_both_ways():
    place = np.linspace(0.0, 2.3, 18)
    values = 2e-3 + 1.2e-2 / (1.0 + np.exp(-12.0 * (place - 1.5)))
    scattered = [values * (1.0 + 0.05 * np.random.default_rng(seed).standard_normal(18)) for seed in range(40)]
    told = [noise_of(place, one, ROUGH["damping"])[-1] / values[-1] for one in scattered]
    assert np.min(told) > 0.05 / 3.0  # a seventh where all of it is told from where the values are small
