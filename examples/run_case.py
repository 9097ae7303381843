"""A case from Python: its loops, maps and curves as labelled arrays, its summary, and a figure.

The stages are kept in the folder that is given, so that a second call reads what the first has computed.
"""

import sys
import tempfile
from pathlib import Path

import fretflow as ff
import numpy as np

CASE = Path(__file__).with_name("quick.toml")


def main(out: Path) -> None:
    """Run the case to the wear of its faces, with its results in `out`."""
    case = ff.load_case(CASE)
    results = ff.run(case, out, until="wear", progress=lambda share, text: print(f"{share:4.0%} {text}"))

    unworn = results.loops.sel(cycles=0)  # xarray: dimension phase, displacement in m, force in N
    limit = case.contact.friction_coefficient * case.test.normal_load
    assert abs(float(unworn.friction_force.max()) / limit - 1.0) < 0.01  # it slides

    load = float((results.maps.mean_pressure * results.maps.area).sel(cycles=0).sum())  # Pa m^2
    assert abs(load / case.test.normal_load - 1.0) < 1e-6

    volume = float(results.wear.volume[-1])  # m^3; Archard: all work of friction at one coefficient wears
    energy = float(results.wear.energy[-1])
    archard = case.wear.coefficient * energy / case.contact.friction_coefficient
    assert abs(volume / archard - 1.0) < 0.02
    assert results.summary["wear volume"].value == volume

    assert np.allclose(results.maps.stick + results.maps.slip + results.maps.separation, 1.0)
    results.plot().savefig(out / "quick.png")
    assert (out / "quick.png").stat().st_size > 10_000


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            main(Path(folder))
