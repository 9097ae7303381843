"""Elasticity in three dimensions: stiffness, mass and the static preload."""

import os
import sys
from unittest import mock

import h5py  # noqa: F401 - its HDF5 2.0 has to be loaded before the HDF5 1.14 that dolfinx 0.9 brings
import petsc4py

from fretflow.core.provenance import PETSC_ARGUMENTS, alone

# dolfinx 0.5 asks the loader to make its libraries, and all loaded after them, visible to every other one.
# Its HDF5 and C++ templates then replace those inside the wheels of h5py and VTK, which fail or crash.
with mock.patch.object(sys, "setdlopenflags"):
    if "petsc4py.PETSc" not in sys.modules:  # nobody has started PETSc yet
        with mock.patch.dict(os.environ, alone()):  # also starts MPI
            petsc4py.init(PETSC_ARGUMENTS)
    import dolfinx as _dolfinx  # noqa: F401
