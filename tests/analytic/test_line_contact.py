"""Wear of a cylinder on a flat in gross slip, plane strain.

What carries the weight: Hertz before wear; Archard's volume, which in gross slip no shape changes; and the profile that
a long test tends to. There the pressure is uniform, p = P / 2a, and the parabola cut off by the plane, less what the
faces give way in the middle (Johnson, Contact Mechanics, section 2.5), has the area
``A = 2 a^3 / (3 R) - 2 P a / (pi E*)``.
"""

import numpy as np
import pytest
from fretflow.core.errors import FretflowError
from fretflow.effects.catalogue import catalogue
from fretflow.effects.line_cycle import LineContact, LineCycle
from fretflow.effects.oxygen_limited_wear import OxygenLimitedWear, oxygen_share
from scipy.integrate import solve_bvp

LOAD, RADIUS, MODULUS, AMPLITUDE, K_W = 1e6, 80e-3, 6.5e10, 75e-6, 2e-13


def contact(**other):
    own = {"radius": RADIUS, "modulus": MODULUS, "load": LOAD, "amplitude": AMPLITUDE, "frequency": 1.0,
           "friction": 0.8, "half_width": 5e-3, "strips": 201}
    return LineContact(**(own | other))


def test_hertz_before_wear():
    own = contact(half_width=2e-3)
    unworn = LineCycle(own).wear(K_W, 0.0, 1)
    half = np.sqrt(4.0 * LOAD * RADIUS / (np.pi * MODULUS))
    assert unworn.pressure.max() == pytest.approx(2.0 * LOAD / (np.pi * half), rel=1e-3)
    assert 0.5 * np.ptp(own.interface.nodes[unworn.pressure > 0.0, 0]) == pytest.approx(half, abs=0.04e-3)


def test_worn_area_and_late_shape():
    own = contact()
    late = LineCycle(own).wear(K_W, 5000.0, 60)
    area = float(own.interface.areas @ late.slow.depth)
    assert area == pytest.approx(K_W * LOAD * 4.0 * AMPLITUDE * 5000.0, rel=1e-9)
    half = 0.5 * float(own.interface.areas @ (late.pressure > 0.0))
    assert area == pytest.approx(2.0 * half**3 / (3.0 * RADIUS) - 2.0 * LOAD * half / (np.pi * MODULUS), rel=0.05)
    inside = np.abs(own.interface.nodes[:, 0]) < 0.7 * half
    assert late.pressure[inside] == pytest.approx(LOAD / (2.0 * half), rel=0.05)


def test_jumps_converge_in_first_order():
    own = LineCycle(contact(strips=81))
    fine = own.wear(K_W, 5000.0, 320).slow.depth
    errors = [np.abs(own.wear(K_W, 5000.0, jumps).slow.depth - fine).max() for jumps in (20, 40)]
    assert errors[1] < 0.65 * errors[0]
    assert errors[1] < 0.02 * fine.max()


def test_oxygen_is_that_of_diffusion_and_uptake():
    solution = solve_bvp(lambda x, y: np.stack([y[1], 9.0 * y[0]]), lambda a, b: np.array([a[0] - 1.0, b[0] - 1.0]),
                         np.linspace(-1.0, 1.0, 41), np.ones((2, 41)), tol=1e-8)
    place = np.linspace(-1.0, 1.0, 21)
    assert oxygen_share(place, 3.0) == pytest.approx(solution.sol(place)[0], abs=1e-6)


def test_bare_metal_in_the_middle_wears_less_and_only_at_high_power():
    effect, strips = OxygenLimitedWear().changed(distance=0.5e-3, adhesive_share=0.1), contact(strips=81)
    middle, depth = 40, {}
    for frequency in (1e-6, 2.0):
        own = contact(strips=81, frequency=frequency)
        depth[frequency] = LineCycle(own, [effect]).wear(K_W, 5000.0).slow.depth
    plain = LineCycle(strips).wear(K_W, 5000.0).slow.depth
    assert depth[1e-6] == pytest.approx(plain, rel=1e-3, abs=1e-9)
    assert depth[2.0].sum() < 0.5 * plain.sum()
    assert depth[2.0][middle] < 0.5 * plain[middle]
    neutral = LineCycle(strips, [OxygenLimitedWear.neutral()]).wear(K_W, 5000.0).slow.depth
    assert neutral == pytest.approx(plain, rel=1e-12)


def test_debris_that_stays_deepens_the_scar_and_keeps_it_narrow():
    third = catalogue()["third-body"]()
    stays = third.changed(retained_fraction=0.9, residence=1e9, separating_thickness=1e9)
    own = contact(strips=81)
    area = K_W * LOAD * 4.0 * AMPLITUDE * 5000.0
    worn = LineCycle(own, [stays]).wear(K_W, 5000.0)
    assert float(own.interface.areas @ worn.slow.depth) == pytest.approx(area, rel=1e-6)
    plain = LineCycle(own).wear(K_W, 5000.0)
    assert (worn.pressure > 0.0).sum() < 0.7 * (plain.pressure > 0.0).sum()
    assert worn.slow.depth.max() > 1.5 * plain.slow.depth.max()


def test_a_load_that_pulls_is_told():
    with pytest.raises(FretflowError, match="load: must be positive"):
        contact(load=-1.0).press(np.zeros(201), np.zeros(201), np.ones(201, dtype=bool))
