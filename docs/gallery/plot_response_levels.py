"""
Friction damps some levels more than others
===========================================

Amplitude over force about the first mode, at four levels of excitation. While the joint sticks the curve is that of a
stiff spring; in between, friction takes most; where all of it slides, the joint hardly holds.
"""

import fretflow as ff
import matplotlib.pyplot as plt

case = ff.load_case("../../examples/quick.toml")
sweep = case.output.frequency_response.model_copy(update={"stop": 400.0, "points": 60})
output = case.output.model_copy(update={"frequency_response": sweep, "loop_cycles": (), "wear_map_cycles": ()})
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for newton in (10, 75, 150, 400):
    test = case.test.model_copy(update={"excitation_amplitude": float(newton), "cycles": 0})
    changed = case.model_copy(update={"name": "quick-levels", "test": test, "output": output})
    curve = ff.run(changed, "runs", until="response").curves["unworn"]
    axes.loglog(curve.frequency, 1e6 * curve.amplitude / newton, label=f"{newton} N")
axes.set(xlabel="frequency in Hz", ylabel="amplitude of the moving mass in µm/N")
axes.set_xticks((20, 40, 100, 200, 400), (20, 40, 100, 200, 400))
axes.legend()
plt.show()
