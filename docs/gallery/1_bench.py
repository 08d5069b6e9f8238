"""
A measured response and its verdict
===================================

Left the frequency response of a motor bench with the 95 % radius of its error at each frequency, right what a controller
keeps of each requirement on it: the worst case with its 95 % interval.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter
from scipy.stats import f

import loopshape as ls

BENCH = Path("../../examples/motor_bench")
P = ls.frf(ls.formats.read_table(BENCH / "multisine_type_a.parquet", BENCH / "map.toml"))
model = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
(C,), (R,) = (
    ls.read_controllers(BENCH / "controller.toml"),
    ls.read_requirements(BENCH / "requirements.toml"),
)
v = ls.check(P, C, R, fits=[model])
v

# %%
# The error of a response is circular in the complex plane: in 95 of 100 cases it is below the root of
# variance · F(0.95; 2, freedom). Twenty periods of one second leave 0.2 to 2 % of P at most frequencies, and more in
# the anti-resonance, where the plant answers least.

f_hz, size = P.frequency_hz, np.abs(P.siso)
radius = np.sqrt(P.variance[:, 0, 0] * f.ppf(0.95, 2, P.variance_freedom))
plt.rcParams["font.size"] = 8.0
figure, panels = plt.subplot_mosaic(
    [["size", "verdict"], ["error", "verdict"]],
    figsize=(7.0, 3.4), layout="constrained", width_ratios=[1.0, 1.6], height_ratios=[2.2, 1.0],
)  # fmt: skip
low, high = (20.0 * np.log10(np.maximum(size + k * radius, 1e-6)) for k in (-1.0, 1.0))
panels["size"].fill_between(f_hz, low, high, color="#0072B2", alpha=0.35, linewidth=0.0)
panels["size"].semilogx(f_hz, 20.0 * np.log10(size), color="#0072B2", linewidth=1.2)
panels["size"].set(ylabel="|P| [dB re 1 rad/A]", title="motor bench, closed loop, 20 s")
panels["error"].loglog(f_hz, 100.0 * radius / size, color="#0072B2", linewidth=1.0)
panels["error"].set(xlabel="frequency [Hz]", ylabel="error [%]")
panels["error"].set_yticks([0.1, 1.0, 10.0], ["0.1", "1", "10"])
panels["error"].yaxis.set_minor_formatter(NullFormatter())
for name in ("size", "error"):
    panels[name].set_xlim(f_hz[0], f_hz[-1])
    panels[name].set_xticks(
        [20, 50, 100, 200], ["20", "50", "100", "200"] if name == "error" else [""] * 4
    )
    panels[name].xaxis.set_minor_formatter(NullFormatter())
    panels[name].grid(alpha=0.3)
rows = v.table()
cells = [
    [r["requirement"].rsplit("_", 1)[0].replace("_", " "), f"{r['required']:g} {r['unit']}", f"{r['worst case']:.2f} [{r['low']:.2f}, {r['high']:.2f}]",
     r["outcome"]]
    for _, r in rows.iterrows()
]  # fmt: skip
panels["verdict"].set_axis_off()
panels["verdict"].set_title(f"verdict: {v.outcome}", fontweight="bold")
shown = panels["verdict"].table(
    cells, colLabels=["requirement", "required", "worst case [95 %]", "outcome"],
    loc="center", cellLoc="left", colLoc="left", edges="horizontal", colWidths=[0.36, 0.13, 0.36, 0.15],
)  # fmt: skip
shown.auto_set_font_size(False)
shown.set_fontsize(7.0)
shown.scale(1.0, 1.9)
for k, outcome in enumerate(rows["outcome"]):
    shown[k + 1, 3].get_text().set_color("#00795A" if outcome == "passed" else "#D55E00")
