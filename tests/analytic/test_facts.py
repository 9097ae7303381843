"""Facts of the rig's tests under the engine.

What carries the weight: the sliding distances are those of an independent solution in time (README of the references),
the resonance of a stuck joint is that of two masses on springs, and facts that the model itself made are explained by
what made them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fretflow.contact.interface import Interface
from fretflow.core.errors import NonConvergenceError
from fretflow.effects.catalogue import catalogue
from fretflow.experiments.facts import experiment as facts_experiment
from fretflow.experiments.facts.experiment import FactsExperiment, shown
from fretflow.experiments.facts.run import case_of as case_of_facts
from fretflow.experiments.facts.run import detect, model_of, refitted, told
from fretflow.experiments.independent import in_turn
from fretflow.experiments.rig.simulation import Hypothesis
from fretflow.inference.decision import decide, detected
from fretflow.inference.experiment import Point
from fretflow.inference.strategy import run_search
from fretflow.inference.verdict import Verdict
from fretflow.pipeline.problem import rig_problem
from fretflow.recordings.kinds.facts import FactsFile, FactsRecording
from fretflow.structure.two_mass_rig.joint import QuasiStaticJoint
from fretflow.structure.two_mass_rig.lumped import LumpedRig
from scipy.linalg import eigh

PERIODIC = Path(__file__).parents[1] / "data" / "periodic"
DATA = np.load(PERIODIC / "krel_49.npz")
EVERY = np.arange(49)
MORE, FEW = (np.flatnonzero((EVERY // 7 % step == 0) & (EVERY % 7 % step == 0)) for step in (2, 3))  # 16 and 9 nodes
RIG = LumpedRig.from_modes(10.0, 0.5, 40.0, 2500.0, 0.01)
CYCLES = 20_000
HIDDEN = {"wear-coefficient-evolution", "normal-load-drift", "friction-run-in", "wear-threshold"}


def stiffness(nodes):
    dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
    return np.linalg.inv(np.linalg.inv(1e3 * DATA["K"])[np.ix_(dofs, dofs)])


def model(file, nodes):
    own = stiffness(nodes)
    areas = np.ones(7)
    areas[[0, -1]] = 0.5
    shares = np.outer(areas, areas).ravel()[EVERY] if len(nodes) == 49 else np.ones(len(nodes))
    problem = rig_problem(
        joint=QuasiStaticJoint.from_stiffness(0.5 * (own + own.T), RIG),
        interface=Interface(nodes=1e-3 * DATA["x"][nodes, :2], areas=1e-6 * shares / shares.sum(),
                            gap=np.zeros(len(nodes))),
        friction_coefficient=0.88, frequency=100.0, excitation=75.0, normal_load=60.0)
    return model_of(file, problem)


def file_of(*facts, **unknown):
    return FactsFile.model_validate({
        "format": "fretflow-recording/1", "unknown": unknown, "facts": list(facts),
        "test": {"kind": "facts", "excitation_frequency": "100 Hz", "excitation_amplitude": "75 N",
                 "normal_load": "60 N", "cycles": CYCLES}})


def fact(quantity, value="1 m", sd="1 m", **more):
    return {"quantity": quantity, "value": value, "sd": sd, **more}


def predicted(file, nodes=FEW, effects=()):
    own = FactsExperiment.of(file, model(file, nodes))
    space = own.parameters(effects)
    return shown(own.predict(Point(space, np.zeros(space.size)))).quantities


def test_sliding_distances_are_those_of_an_independent_solution():
    """The references hold periods of the same joint with rigid contact; 53 N lie on the friction limit."""
    forces = (53, 60, 75)
    wanted = [np.ptp(np.genfromtxt(PERIODIC / f"rigid_{force}N.csv", delimiter=",", names=True)[
        "relative_displacement_um"]) for force in forces]
    file = file_of(*(fact("sliding-distance", cycles=0, excitation_amplitude=f"{force} N") for force in forces))
    distances = 1e6 * predicted(file, EVERY)
    np.testing.assert_allclose(distances, wanted, rtol=0.02)


def test_the_resonance_of_a_stuck_joint_is_that_of_two_masses_on_springs():
    """Its faces move as one, the load's direction free: ``k = k_xx - k_xz^2 / k_zz`` of the summed stiffness."""
    file = file_of(fact("resonance", "1 Hz", "1 Hz", cycles=0, excitation_amplitude="0.5 N"))
    own = stiffness(FEW)
    sums = own.reshape(9, 3, 9, 3).sum(axis=(0, 2))
    contact = sums[0, 0] - sums[0, 2]**2 / sums[2, 2]
    springs = np.array([[RIG.ground_stiffness + RIG.hinge_stiffness, -RIG.hinge_stiffness],
                        [-RIG.hinge_stiffness, RIG.hinge_stiffness + contact]])
    lowest = np.sqrt(eigh(springs, np.diag([RIG.moving_mass, RIG.arm_mass]), eigvals_only=True)[0]) / (2.0 * np.pi)
    assert predicted(file)[0] == pytest.approx(lowest, rel=2e-3)


def test_wear_in_gross_slip_reads_back_the_coefficient_that_made_it():
    """Archard: all of the load slides the faces' path, but for what the last of them to slip hold back."""
    file = file_of(fact("wear-coefficient", "1 m^2/N", "1 m^2/N"), fact("wear-volume", "1 m^3", "1 m^3"),
                   fact("sliding-distance"))
    coefficient, volume, sliding = predicted(file)
    np.testing.assert_allclose([coefficient, volume], [1.1e-14, 1.1e-14 * 60.0 * 2.0 * sliding * CYCLES], rtol=0.03)


def test_a_hypothesis_is_in_the_units_of_the_file():
    """Parameters at the middle of their ranges, as factors on what the model was built with."""
    file = file_of(fact("sliding-distance"), moving_mass=["5 kg", "80 kg"], compliance=[0.5, 2.0])
    own = FactsExperiment.of(file, model(file, FEW))
    space = own.parameters(())
    assert own.hypothesis(Point(space, np.zeros(2))) == Hypothesis(mass=pytest.approx(2.0),
                                                                   compliance=pytest.approx(1.0))


def test_what_a_test_does_not_show_is_no_prediction():
    """At 1 N nothing slides, so that no rate settles."""
    file = file_of(fact("settling-cycles", 1, 1, excitation_amplitude="1 N"))
    with pytest.raises(NonConvergenceError, match="settling-cycles"):
        predicted(file)


def made_facts(effects, monkeypatch):
    """Return facts of sliding and worn volumes as a model of more nodes with some effects shows them, each to 2 %."""
    monkeypatch.setattr(facts_experiment, "rig_effects", lambda: tuple(sorted(HIDDEN)))
    asked = [fact("sliding-distance", excitation_amplitude=f"{force} N", cycles=1) for force in (65, 75, 90)]
    asked += [fact("wear-volume", "1 m^3", "1 m^3", cycles=count) for count in (1000, 3000, 10_000, CYCLES)]
    blank = file_of(*asked)
    own = FactsExperiment.of(blank, model(blank, MORE))
    space = own.parameters([one.id for one in effects])
    point = Point(space, np.array([coordinate.place(getattr(one, coordinate.field)) for one in effects
                                   for coordinate in space.coordinates if coordinate.effect == one.id]))
    values = shown(own.predict(point)).quantities
    units = ["m"] * 3 + ["m^3"] * 4
    return file_of(*({**one, "value": f"{value!r} {unit}", "sd": f"{0.02 * value!r} {unit}"}
                     for one, value, unit in zip(asked, map(float, values), units, strict=True)),
                   moving_mass=["8 kg", "14 kg"], wear_coefficient=["2e-15 m^2/N", "5e-14 m^2/N"])


def diagnosed(effects, monkeypatch):
    file = made_facts(effects, monkeypatch)
    search = refitted(FactsExperiment.of(file, model(file, FEW)), model(file, MORE), True, in_turn)
    run_search(search, lambda share, text: None)
    detection = detect(search)
    decision = detected(decide(search), detection)
    recording = FactsRecording(path=Path("facts.toml"), title="made", file=file)
    return told(recording, case_of_facts(file), search, decision, detection)


def test_facts_that_a_change_made_are_explained_by_it(monkeypatch, tmp_path):
    """A wear coefficient that falls to a fifth over ten thousand cycles shows in the volumes alone."""
    hidden = catalogue()["wear-coefficient-evolution"]().changed(final_share=0.2, settling=10_000.0)
    diagnosis = diagnosed((hidden,), monkeypatch)
    assert diagnosis.verdict is Verdict.NAMED
    assert diagnosis.effects == ("wear-coefficient-evolution",)
    assert "wear volume" in diagnosis.location.text
    assert "[effects.wear-coefficient-evolution]" in diagnosis.case_file
    assert "wear volume" in diagnosis.to_html(tmp_path / "report.html").read_text(encoding="utf-8")
    assert diagnosis.to_json()["effects"] == ["wear-coefficient-evolution"]


def test_facts_of_the_plain_rig_miss_nothing(monkeypatch):
    diagnosis = diagnosed((), monkeypatch)
    assert diagnosis.verdict is Verdict.NONE
    assert diagnosis.location.text == ""
    mass = next(one for one in diagnosis.parameters if one.name == "rig.moving_mass")
    assert mass.low < 10.0 < mass.high
