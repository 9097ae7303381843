"""Parametric meshes of specimens and of bolted beams, written and read by gmsh."""

from fretflow_meshes.lap_beam import LapBeam
from fretflow_meshes.specimen import run_mesh

__all__ = ["LapBeam", "run_mesh"]
