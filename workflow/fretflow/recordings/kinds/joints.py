"""What friction joints are recorded on, as effects know it: a rig, a measured motion, a lumped system, a structure."""

from __future__ import annotations

from fretflow.recordings.kinds import RecordingKind

FRETTING_RIG = RecordingKind(
    "fretting-rig", "fretting rig: the full model predicts motion, friction force and wear",
    "fretflow.experiments.rig.run:diagnose_rig", displacement_range=(1e-9, 5e-3), full_model=True)
IMPOSED_DISPLACEMENT = RecordingKind(
    "imposed-displacement",
    "imposed displacement: the measured motion drives the contact model, which predicts the force",
    "fretflow.experiments.driven.run:diagnose_driven")
LUMPED = RecordingKind(
    "lumped", "lumped system: mass, spring and friction predict the motion or the force",
    "fretflow.experiments.driven.run:diagnose_driven", displacement_range=(1e-9, 20.0), friction_alone=False)
STRUCTURE = RecordingKind(
    "structure", "structure: matrices, bolt load, friction and damping predict backbones, responses and decays",
    "fretflow.experiments.structure.run:diagnose_structure",
    "fretflow.recordings.kinds.structures:read_structure_recording")
KINDS = (FRETTING_RIG, IMPOSED_DISPLACEMENT, LUMPED, STRUCTURE)
