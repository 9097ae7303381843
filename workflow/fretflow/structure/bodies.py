"""What is said of meshed bodies that friction and bolts hold together: material, interfaces, bolts."""

from __future__ import annotations

import numpy as np

from fretflow.core.errors import InputError
from fretflow.core.records import quantity, record

SHEAR_SHAPE = 0.9  # of a round section: G. R. Cowper, J. Appl. Mech. 33 (1966) 335
LIGHTEST = 0.1  # kg/m^3, aerogels
SOFTEST = 1e6  # Pa


@record
class Material:
    """Isotropic elasticity.

    Examples
    --------
    >>> import fretflow as ff
    >>> steel = ff.Material(youngs_modulus=205e9, poissons_ratio=0.29, density=7850.0)  # Pa, 1, kg/m^3
    """

    youngs_modulus: float = quantity("Pa")
    poissons_ratio: float = quantity("1")
    density: float = quantity("kg/m^3")

    def check(self) -> None:
        """Check that it is elastic and has mass.

        Raises
        ------
        InputError
            Naming the value that cannot be.
        """
        for name in ("youngs_modulus", "density"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name}: must be positive, got {getattr(self, name)}")
        for name, least, what in (("density", LIGHTEST, "kg/m^3 is below that of any solid"),
                                  ("youngs_modulus", SOFTEST, "Pa is below that of soft rubber")):
            if getattr(self, name) < least:
                raise InputError(f"{name}: {getattr(self, name):g} {what}; all is in SI, also where a mesh counts in "
                                 "millimetres")
        if not -1.0 < self.poissons_ratio < 0.5:
            raise InputError(f"poissons_ratio: must lie between -1 and 0.5, got {self.poissons_ratio}")


@record
class Bolt:
    """A bolt between two named faces, under its head and its nut: an elastic beam, half its mass at each end.

    The load of a bolt is a uniform pressure on both faces; the beam carries what the bolt is strained by beyond that.

    Examples
    --------
    An M8 bolt that clamps 20 mm of steel, with 40 g of its own:

    >>> import fretflow as ff
    >>> bolt = ff.Bolt.round("head 1", "nut 1", diameter=8e-3, grip=20e-3, mass=0.04)  # m, m, kg
    >>> round(bolt.stiffness / 1e6)  # N/um
    515
    """

    head: str
    nut: str
    stiffness: float = quantity("N/m", "along the bolt", default=0.0)
    shear_stiffness: float = quantity("N/m", "across it", default=0.0)
    bending_stiffness: float = quantity("N*m", "between the slopes of both faces", default=0.0)
    mass: float = quantity("kg", default=0.0)

    def check(self) -> None:
        """Check that nothing is negative.

        Raises
        ------
        InputError
            Naming the value that cannot be.
        """
        for name in ("stiffness", "shear_stiffness", "bending_stiffness", "mass"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"bolt {self.head!r}: {name} must not be negative, got {getattr(self, name)}")

    @classmethod
    def round(cls, head: str, nut: str, *, diameter: float, grip: float, youngs_modulus: float = 2.05e11,
              poissons_ratio: float = 0.29, mass: float = 0.0) -> Bolt:
        """Return a bolt with a round shank (m) between head and nut; across it, a beam clamped in both (Timoshenko).

        Raises
        ------
        InputError
            If a length is not positive.
        """
        if not (diameter > 0.0 and grip > 0.0):
            raise InputError(f"bolt {head!r}: diameter and grip must be positive, got {diameter} and {grip} m")
        area, bending = 0.25 * np.pi * diameter**2, np.pi / 64.0 * diameter**4
        bent = grip**3 / (12.0 * youngs_modulus * bending)
        sheared = 2.0 * (1.0 + poissons_ratio) * grip / (SHEAR_SHAPE * youngs_modulus * area)
        return cls(head=head, nut=nut, stiffness=float(youngs_modulus * area / grip),
                   shear_stiffness=float(1.0 / (bent + sheared)),
                   bending_stiffness=float(youngs_modulus * bending / grip), mass=mass)
