"""Parametric meshes of specimens and of bolted beams, written and read by gmsh."""

from fretflow_meshes.lap_beam import LapBeam
from fretflow_meshes.specimen import run_mesh
from fretflow_meshes.surfaces import read_surfaces

__all__ = ["LapBeam", "read_surfaces", "run_mesh"]
