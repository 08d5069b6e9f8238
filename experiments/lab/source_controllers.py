"""The source's own controllers and fitted plants, from its printed numbers (`source`)."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import angular
from loopshape.data.control.controller import Block, Controller
from loopshape.data.response.model import TransferFunction
from loopshape.toolbox.arm.source import numbers, value

#: the loop that each printed controller closes; table 5.6 stands for p_A and p_C
TABLES = {
    "table_5_1": "theta2",
    "table_5_2": "p_ab",
    "table_5_4": "theta1",
    "table_5_5": "theta2",
    "table_5_6": "p_a",
    "table_h_1": "theta1",
}


def controller(table: str, loop: str | None = None, rate_hz: float = 1000.0) -> Controller:
    """The controller of a printed table ("table_5_1"): the blocks that the table has, in the source's order.

    Gain, lead-lag, notch and low-pass (H.1-H.5); the low-pass is of second order where a damping is printed. `loop`
    names another loop than the table's own. Refuses a table that prints no controller.
    """
    if table not in TABLES:
        raise WrongUseError("the source prints no controller there", repr(table), f"use one of {', '.join(TABLES)}")
    given = _numbers_of(table)
    blocks = [Block("gain", {"gain": given["gain"]})]
    if "lead1" in given:
        blocks.append(Block("lead_lag", {"f1_hz": given["lead1"], "f2_hz": given["lead2"]}))
    if "notch" in given:
        blocks.append(_notch(given["notch"], given["b1"], given["b2"]))
    damped = {"damping": given["zeta"]} if "zeta" in given else {}
    blocks.append(Block("low_pass_2" if damped else "low_pass_1", {"f_hz": given["lowpass"], **damped}))
    return Controller(loop or TABLES[table], tuple(blocks), rate_hz)


def angle_controller(gain: float | None = None, notch_hz: float | None = None, rate_hz: float = 1000.0) -> Controller:
    """Table 5.1, angle of the 1-DoF arm, with another gain or notch where given.

    The source's simulation (figure 5.7) has its notch at the key `figure_5_7.notch`.
    """
    printed = controller("table_5_1", rate_hz=rate_hz)
    p, lead, notch, low_pass = printed.blocks
    if gain is not None:
        p = Block("gain", {"gain": gain})
    if notch_hz is not None:
        notch = _notch(notch_hz, notch.parameters["damping1"], notch.parameters["damping2"])
    return Controller(printed.loop, (p, lead, notch, low_pass), rate_hz)


def pressure_controller(rate_hz: float = 1000.0) -> Controller:
    """Table 5.2, cumulative pressure of the 1-DoF arm."""
    return controller("table_5_2", rate_hz=rate_hz)


def third_order_plant(place: str, delay_s: float = 0.0) -> TransferFunction:
    """theta2/z_theta2 in rad/V as fitted by the source (4.10), of a place such as "figure_4_12".

    Places are figure_4_12, figure_4_14, figure_4_15.measured and figure_4_15.simulated; `delay_s` is no part of the
    printed fit. Refuses a place without the three numbers.
    """
    if f"{place}.kappa" not in numbers():
        fitted = sorted(key.removesuffix(".kappa") for key in numbers() if key.endswith(".kappa"))
        raise WrongUseError("the source prints no third-order fit there", repr(place), f"use {', '.join(fitted)}")
    w, zeta = float(angular(value(f"{place}.f"))), value(f"{place}.zeta")
    return TransferFunction(np.array([value(f"{place}.kappa")]), np.array([1.0, 2.0 * zeta * w, w * w, 0.0]), delay_s)


def _numbers_of(table: str) -> dict[str, float]:
    return {key.removeprefix(f"{table}."): value(key) for key in numbers() if key.startswith(f"{table}.")}


def _notch(f_hz: float, damping1: float, damping2: float) -> Block:
    return Block("notch", {"f1_hz": f_hz, "f2_hz": f_hz, "damping1": damping1, "damping2": damping2})
