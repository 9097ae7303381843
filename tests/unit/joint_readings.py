"""Readings of a joint's loops, compared with the closed form of a spring and slider."""

import numpy as np
import pytest
from fretflow.recordings.readings import read_recorded_loops


def readings(loops):
    return read_recorded_loops(loops, np.full(len(loops.cycles), 60.0))


def assert_readings(loops, exact, mu=1e-3, stiffness=5e-3, lengths=1e-3):
    """Compare the readings at every cycle count with the closed form, within relative tolerances."""
    seen = readings(loops)
    for name, tolerance in (("friction_coefficient", mu), ("tangential_stiffness", stiffness),
                            ("sliding_distance", lengths), ("dissipated_energy", lengths), ("peak_to_peak", lengths)):
        if tolerance is not None:
            assert getattr(seen, name).value == pytest.approx(exact()[name], rel=tolerance, abs=0.0), name


def notes_about(recording, words):
    return [note for note in recording.notes if words in note.text]
