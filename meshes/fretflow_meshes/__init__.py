"""Parametric specimen meshes, written and read by gmsh."""

from fretflow_meshes.specimen import run_mesh

__all__ = ["run_mesh"]
