"""`loopshape equilibria`: where the arm can stand, and how it moves there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet


def equilibria(
    out: Annotated[Path, typer.Option(help="Folder for the figures.")] = Path("equilibria"),
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Draw the 1-DoF arm's equilibria. Figures 4.7 and 4.8 of the source, and a list of its 24 operating points."""
    from loopshape.toolbox.arm.dynamics.equilibrium import pressures
    from loopshape.toolbox.arm.dynamics.linear import linearise
    from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
    from loopshape.toolbox.arm.source import EQUILIBRIA

    output = Output(as_json, quiet)
    vector = ARM1_PARAMETERS.vector()
    c, supply = constants(vector), float(vector[ARM1_PARAMETERS.index("supply_bar")])
    rows = []
    for theta, p_ab in EQUILIBRIA:
        p_a, p_b = pressures(c, theta, p_ab)
        kappa, f_hz, zeta = linearise(c, theta, p_ab).third_order()
        rows.append([theta, p_ab, p_a, p_b, f_hz, zeta, kappa, max(p_a, p_b) <= supply])
    keys = ("theta2_deg", "p_ab_bar", "p_a_bar", "p_b_bar", "f_hz", "zeta", "kappa", "within_supply")
    output.table("Equilibria, linearised with averaged valves", list(keys), rows)
    drawn = draw_equilibria(out)
    output.say("\n".join(drawn))
    output.json({"equilibria": [dict(zip(keys, row, strict=True)) for row in rows], "figures": drawn})


def draw_equilibria(folder: Path) -> list[str]:
    """The source's figures 4.7 and 4.8 for the nominal arm; gives the files."""
    import numpy as np

    from loopshape.toolbox.arm.dynamics.equilibrium import angle_map, pressure_map
    from loopshape.toolbox.arm.equilibria_pictures import contours_by_angle, contours_by_pressures
    from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
    from loopshape.toolbox.arm.source import EQUILIBRIA
    from loopshape.verbs.pictures import save
    from loopshape.view.style import figure_of

    c = constants(ARM1_PARAMETERS.vector())
    grid = np.linspace(0.15, 1.2, 43)
    theta_deg, p_ab_bar = np.linspace(-40.0, 40.0, 41), np.linspace(0.4, 2.2, 37)
    points = [{"theta2_deg": t, "p_ab_bar": p} for t, p in EQUILIBRIA]
    by_pressure = contours_by_pressures(grid, grid, angle_map(c, grid, grid))
    by_angle = contours_by_angle(theta_deg, p_ab_bar, *pressure_map(c, theta_deg, p_ab_bar), points=points)
    named = ((by_pressure, "angle_over_pressures"), (by_angle, "pressures_over_angle"))
    return [str(save(figure_of(ax), folder / f"{name}.png")) for ax, name in named]
