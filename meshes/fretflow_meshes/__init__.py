"""Parametric specimen meshes, written and read by gmsh."""

from fretflow_meshes.stage import run_mesh

__all__ = ["run_mesh"]
