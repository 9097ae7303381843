"""What is asked of a bolted structure: preload, backbone, forced responses, wear; from a case file or from Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fretflow.case.bolted import BoltedCase
from fretflow.contact.coulomb import Coulomb
from fretflow.contact.kernels.static import SEPARATION, SLIP
from fretflow.core.errors import ConfigError, InputError
from fretflow.core.plugins import FIGURES, MESHES, provided
from fretflow.core.progress import Progress
from fretflow.core.records import Array
from fretflow.core.store import write_csv
from fretflow.effects.bolted_cycle import BoltedCycle, numbered_mode
from fretflow.effects.cycle import march_wear
from fretflow.pipeline.run_folder import holding
from fretflow.pipeline.stage import SUMMARY_FILE, write_json
from fretflow.solvers.nonlinear_modes.joint import BoltedJoint, LinearMode, StaticHistory
from fretflow.solvers.nonlinear_modes.periodic_mode import PeriodicMode, follow_mode
from fretflow.solvers.nonlinear_modes.quasi_static import ModalBackbone, quasi_static_backbone
from fretflow.solvers.nonlinear_modes.response import ModalResponse, driven_shape, respond_to_force
from fretflow.structure.bodies import Bolt
from fretflow.structure.meshed import assembled_bodies, round_bolts
from fretflow.structure.reduction.contact_modes import reduce_structure
from fretflow.wear.archard import Archard
from fretflow.wear.history import WearHistory

SLIDES = 1e-3  # of the largest energy of a cycle, from which on its slope is taken: below, few points slide
MEASURED = ("amplitude_m", "frequency_Hz", "damping_ratio")


@dataclass(frozen=True)
class JointStudy:
    """What a bolted joint does, small amplitudes to large ones; amplitudes of `curve` rise.

    Examples
    --------
    >>> import fretflow as ff
    >>> study = ff.study_joint(joint, np.geomspace(1e-5, 1e-3, 13))  # m kg^0.5  # doctest: +SKIP
    >>> study.slope, study.curve.frequency  # of the energy; Hz  # doctest: +SKIP
    >>> study.draw("pictures")  # doctest: +SKIP
    """

    joint: BoltedJoint
    mode: LinearMode
    mode_number: int
    curve: ModalBackbone
    motions: tuple[PeriodicMode, ...] = ()
    responses: tuple[ModalResponse, ...] = ()
    worn: WearHistory | None = None
    measured: Array | None = None  # (3, P): amplitude of the first output in m, Hz, damping ratio
    mesh: Path | None = None
    mesh_unit: float = 1.0  # m
    bolts: tuple[Bolt, ...] = ()
    title: str = "Bolted joint"

    @property
    def slope(self) -> float:
        """Return the power of the amplitude with which the energy of a cycle goes, where enough slides; nan if none."""
        work = self.curve.dissipated
        slides = work > SLIDES * float(work.max(initial=0.0))
        if slides.sum() < 2:
            return float("nan")
        return float(np.polyfit(np.log(self.curve.amplitude[slides]), np.log(work[slides]), 1)[0])

    @cached_property
    def largest_cycle(self) -> StaticHistory:
        """Return the contact over a cycle of load at the largest amplitude."""
        return BoltedCycle(self.joint, float(self.curve.amplitude[-1]), self.mode_number).swing(self.joint)

    @property
    def states(self) -> NDArray[np.int8]:
        """Return of each point what the largest cycle does: 0 sticks, 1 slides, 2 opens at times, 3 stays open."""
        state = self.largest_cycle.state
        opens = state == SEPARATION
        return np.select([opens.all(axis=0), opens.any(axis=0), (state == SLIP).any(axis=0)], [3, 2, 1], 0).astype(
            np.int8)

    @cached_property
    def worn_preload(self) -> StaticHistory | None:
        """Return the contact of the worn faces, tightened anew; None without wear."""
        if self.worn is None:
            return None
        return replace(self.joint, gap=self.joint.clearance + self.worn.depth[-1]).preloaded

    @cached_property
    def surfaces(self) -> tuple[Array, dict[str, NDArray[np.int64]], dict[str, NDArray[np.int64]]] | None:
        """Return points (n, 3) in m and the corners (k, 4) of bodies and of named faces; None without a mesh."""
        if self.mesh is None:
            return None
        points, bodies, faces = provided(MESHES, "surfaces")(self.mesh)
        return self.mesh_unit * points, bodies, faces

    @property
    def figures(self) -> dict[str, float]:
        """Return the numbers that sum it up, in SI."""
        pressure = self.joint.preloaded.force[0, 2::3] / self.joint.structure.areas
        figures = {"points": self.joint.structure.contacts, "points_closed": int(self.joint.closed.sum()),
                   "largest_pressure_Pa": float(pressure.max()), "linear_frequency_Hz": self.mode.frequency,
                   "smallest_frequency_Hz": float(self.curve.frequency.min()),
                   "largest_damping_ratio": float(self.curve.damping.max()), "energy_power": self.slope}
        return figures if self.worn is None else figures | {"worn_volume_m3": float(self.worn.volume[-1])}

    def write(self, folder: Path | str) -> list[Path]:
        """Write figures, backbone, responses and pictures into a folder, which is made, and return the files."""
        curve, folder = self.curve, Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / SUMMARY_FILE, self.figures)
        outputs = {f"{name}_m": np.abs(curve.outputs[:, k]) for k, name in enumerate(curve.output_names)}
        files = [folder / SUMMARY_FILE, write_csv(folder / "backbone.csv", {
            "amplitude_m_kg05": curve.amplitude, **outputs, "frequency_Hz": curve.frequency,
            "damping_ratio": curve.damping, "energy_J": curve.dissipated, "sliding_points": curve.sliding,
            "open_points": curve.open})]
        if self.responses:
            columns = {"force_N": [one.force for one in self.responses],
                       "frequency_Hz": [one.frequency for one in self.responses],
                       f"{curve.output_names[0]}_m": [one.outputs[:, 0] for one in self.responses]}
            files.append(write_csv(folder / "responses.csv", {
                name: np.concatenate(values) for name, values in columns.items()}))
        return [*files, *self.draw(folder)]

    def draw(self, folder: Path | str) -> list[Path]:
        """Draw mesh, contact, curves and wear into a folder and return the files."""
        files: list[Path] = provided(FIGURES, "bolted")(self, Path(folder))
        return files


def study_joint(joint: BoltedJoint, amplitudes: Array, *, mode: int = 1, periodic: int = 2,
                forces: Sequence[float] = (), drive: str = "", wear: tuple[Archard, float, int] | None = None,
                measured: Array | None = None, mesh: Path | None = None, mesh_unit: float = 1.0,
                bolts: Sequence[Bolt] = (), title: str = "Bolted joint",
                progress: Progress | None = None) -> JointStudy:
    """Find backbone, periodic motions, forced responses and wear of one mode of a bolted joint.

    Parameters
    ----------
    joint : BoltedJoint
        The structure with its preload.
    amplitudes : (A,)
        Modal amplitudes, m kg^0.5.
    mode : int
        Number of the mode about the preload, from 1.
    periodic : int
        At so many of the amplitudes the motion is also found as a periodic one.
    forces, drive
        Held forces in N at the named input, each for a response.
    wear : (Archard, float, int)
        Law, modal amplitude (m kg^0.5) and number of cycles.
    measured : (3, P)
        Amplitude of the first output (m), frequency (Hz) and damping ratio to show beside.
    mesh, mesh_unit, bolts, title
        For pictures.
    progress : callable, optional
        Takes the share that is done, and what is being done.

    Returns
    -------
    JointStudy
        In SI; ``draw(folder)`` makes its pictures.

    Raises
    ------
    InputError
        If an amplitude or a force is out of range, or nothing presses the joint.
    NonConvergenceError
        If the joint slides as a whole.

    Examples
    --------
    >>> import fretflow as ff
    >>> study = ff.study_joint(joint, np.geomspace(1e-5, 1e-3, 13), forces=[1.0], drive="tip")  # doctest: +SKIP
    """
    told = progress or _untold
    told(0.1, "preload")
    shape = numbered_mode(joint, mode)
    told(0.2, "backbone")
    curve = quasi_static_backbone(joint, shape, np.sort(amplitudes))
    told(0.4, "periodic motions")
    some = np.unique(np.linspace(0.3, 0.7, periodic) * (len(curve.amplitude) - 1)).round().astype(int)
    motions = follow_mode(joint, shape, curve.amplitude[some]) if len(some) else ()
    responses = tuple(respond_to_force(curve, driven_shape(joint, shape, drive), force) for force in forces)
    worn = None
    if wear is not None:
        law, amplitude, cycles = wear
        worn = march_wear(BoltedCycle(joint, amplitude, mode), law, cycles,
                          progress=lambda done, asked: told(0.6 + 0.4 * done / asked, "wear"))
    return JointStudy(joint=joint, mode=shape, mode_number=mode, curve=curve, motions=motions, responses=responses,
                      worn=worn, measured=measured, mesh=mesh, mesh_unit=mesh_unit, bolts=tuple(bolts),
                      title=title)


def _untold(share: float, text: str) -> None:
    """Tell nobody of the progress."""


def run_bolted(case: BoltedCase, out: Path, progress: Progress | None = None) -> JointStudy:
    """Run a case of a bolted structure and keep its figures, curves and pictures in ``out/<name>``.

    Raises
    ------
    ConfigError
        If a named sensor or face is not there.
    StoreError
        If the folder cannot be written.
    """
    home = out / case.name
    with holding(home):
        study = _study_case(case, home, progress)
        study.write(home)
    return study


def _study_case(case: BoltedCase, home: Path, progress: Progress | None) -> JointStudy:
    """Return the study of a case, the mesh of a lap beam made in `home`."""
    from fretflow.recordings.readers.tables import read_table

    own = case.structure
    mesh = own.mesh or home / "mesh.msh"
    tables = list(own.bolts)
    if own.lap_beam is not None:
        tables = [own.bolts[0].model_copy(update={"head": head, "nut": nut})
                  for head, nut in provided(MESHES, "lap-beam")(own.lap_beam, mesh)]
    bolts = round_bolts(tables)
    if case.response is not None and case.response.at not in own.sensors:
        raise ConfigError(f"response.at: {case.response.at!r} is no sensor; there are {', '.join(own.sensors)}")
    matrices = assembled_bodies(mesh, own, own.material, bolts)
    asked = case.joint
    joint = BoltedJoint(structure=reduce_structure(matrices, own.modes), law=Coulomb(asked.friction_coefficient),
                        bolt_load=asked.bolt_load, modal_damping=asked.modal_damping)
    line = case.backbone
    shape = output_shape(joint, line.mode)
    wear = None if case.wear is None else (
        Archard(case.wear.coefficient), case.wear.amplitude / shape, case.wear.cycles)
    measured = None
    if line.measured is not None:
        table = read_table(line.measured, MEASURED)
        measured = np.array([table.column(name)[1] for name in MEASURED])
    return study_joint(
        joint, np.geomspace(line.smallest, line.largest, line.points) / shape, mode=line.mode, periodic=line.periodic,
        forces=case.response.forces if case.response else (), drive=case.response.at if case.response else "",
        wear=wear, measured=measured, mesh=mesh, mesh_unit=own.mesh_unit, bolts=bolts, title=case.title or case.name,
        progress=progress)


def output_shape(joint: BoltedJoint, mode: int = 1) -> float:
    """Return the amplitude of the first output over the modal one where nothing slides, 1/kg^0.5.

    Raises
    ------
    InputError
        If the structure has no output, or it stands still.
    """
    if not joint.structure.outputs:
        raise InputError("outputs: the structure has none; name at least one point that is observed")
    name, (on_contact, on_modes) = next(iter(joint.structure.outputs.items()))
    linear = numbered_mode(joint, mode)
    moved = abs(float(on_contact @ linear.contact + on_modes @ linear.modes))
    if not moved > 0.0:
        raise InputError(f"{name!r} stands still in mode {mode}; name another point first")
    return moved
