"""Elasticity in three dimensions: stiffness, mass and the static preload."""

import sys
from unittest import mock

# dolfinx 0.5 asks the loader to make its libraries, and all loaded after them, visible to every other one.
# Its HDF5 and C++ templates then replace those inside the wheels of h5py and VTK, which fail or crash.
with mock.patch.object(sys, "setdlopenflags"):
    import dolfinx as _dolfinx  # noqa: F401
