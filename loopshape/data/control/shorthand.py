"""Blocks of a controller in short, for scripts: `gain(2.2)`, `notch(58.8, 0.01, 0.7)`, `lead_lag((3, 20), (30, 200))`.

A number fixes a parameter, a pair (low, high) leaves it to tuning within these bounds, and None leaves it to tuning
within bounds that follow from the plants (`bounded`). Formulas are those of `loopshape.data.control.block`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError, an
from loopshape.core.units import TWO_PI, from_db
from loopshape.data.control.block import OPEN, Block, BlockTemplate, Free
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF

Parameter = float | tuple[float, float] | None
#: bounds of dampings and ratios that follow from no plant, by name
DAMPINGS = {"damping": (0.2, 2.0), "damping1": (0.005, 1.0), "damping2": (0.1, 2.0)}
#: bounds of a resonator's dampings and of a complex lead's, where none are given
RESONATOR, COMPLEX = ((0.01, 2.0), (0.005, 1.0)), (0.1, 1.0)


def _block(kind: str, tie: dict[str, str] | None = None, **parameters: Parameter) -> BlockTemplate:
    made: dict[str, float | Free] = {}
    for name, value in parameters.items():
        if value is None:
            made[name] = OPEN
        elif isinstance(value, tuple | list):
            if len(value) != 2 or not 0.0 < value[0] < value[1] < np.inf:
                raise WrongUseError(f"bounds of {name} of {an(kind)} block need 0 < low < high", repr(value))
            made[name] = Free(float(value[0]), float(value[1]))
        else:
            made[name] = float(value)
    return BlockTemplate(kind, made, tie or {})


def gain(gain: Parameter = None) -> BlockTemplate:
    """A gain, dimensionless (control unit over output unit).

    >>> import loopshape as ls
    >>> ls.gain(2.2).kind
    'gain'
    """
    return _block("gain", gain=gain)


def lead_lag(f1_hz: Parameter = None, f2_hz: Parameter = None) -> BlockTemplate:
    """(1 + s/w1)/(1 + s/w2): a lead where f1 < f2, a lag where f1 > f2; corners in Hz.

    >>> import loopshape as ls
    >>> ls.lead_lag(8.0, 150.0).parameters["f1_hz"]
    8.0
    """
    return _block("lead_lag", f1_hz=f1_hz, f2_hz=f2_hz)


def notch(
    f_hz: Parameter = None, damping1: Parameter = None, damping2: Parameter = None, f2_hz: Parameter = None,
    *, depth_db: float | None = None, width_hz: float | None = None,
) -> BlockTemplate:  # fmt: skip
    """A notch at `f_hz`: damping of its zeros over that of its poles; `f2_hz` moves its poles (a skewed notch).

    `depth_db` (above 3.01) at `f_hz` and `width_hz` between its -3 dB points are another way to say the dampings.

    >>> import loopshape as ls
    >>> ls.notch(58.8, 0.05, 0.7).tie
    {'f2_hz': 'f1_hz'}
    >>> round(ls.notch(50.0, depth_db=20.0, width_hz=10.0).parameters["damping2"], 4)
    0.101
    """
    if depth_db is not None or width_hz is not None:
        damping1, damping2 = _dampings(f_hz, (damping1, damping2, f2_hz), depth_db, width_hz)
    if f2_hz is None:
        return _block("notch", {"f2_hz": "f1_hz"}, f1_hz=f_hz, damping1=damping1, damping2=damping2)
    return _block("notch", f1_hz=f_hz, f2_hz=f2_hz, damping1=damping1, damping2=damping2)


def _dampings(
    f_hz: Parameter, others: tuple[Parameter, ...], depth_db: float | None, width_hz: float | None
) -> tuple[float, float]:
    """Dampings of a notch by depth and width: with x = f/f0 - f0/f it is 1/2 where x^2 = 4 z2^2 - 8 z1^2 in power."""
    what = "a notch by its depth (above 3.01 dB) and its width needs both and f_hz as numbers, and no dampings"
    numbers = [x for x in (f_hz, depth_db, width_hz) if isinstance(x, int | float) and 0.0 < x < np.inf]
    if len(numbers) < 3 or any(x is not None for x in others) or from_db(-numbers[1]) >= np.sqrt(0.5):
        raise WrongUseError(what, f"f_hz = {f_hz!r}, depth_db = {depth_db!r}, width_hz = {width_hz!r}")
    f, depth, width = numbers
    ratio = float(from_db(-depth))
    damping2 = width / (2.0 * f * np.sqrt(1.0 - 2.0 * ratio**2))
    return ratio * damping2, float(damping2)


def biquad(
    f1_hz: Parameter = None, f2_hz: Parameter = None, damping1: Parameter = None, damping2: Parameter = None
) -> BlockTemplate:
    """A free biquad: zeros at `f1_hz` with `damping1` over poles at `f2_hz` with `damping2`, 1 at low frequency.

    A notch whose zeros and poles lie apart; with a damping above 1 a pair is two real roots.

    >>> import loopshape as ls
    >>> sorted(ls.biquad((5.0, 50.0), (5.0, 50.0)).parameters)
    ['damping1', 'damping2', 'f1_hz', 'f2_hz']
    """
    return _block("notch", f1_hz=f1_hz, f2_hz=f2_hz, damping1=damping1, damping2=damping2)


def resonator(f_hz: Parameter = None, damping1: Parameter = None, damping2: Parameter = None) -> BlockTemplate:
    """A peak filter, damping1/damping2 high at `f_hz` and 1 elsewhere: the dampings of its zeros over its poles.

    >>> import loopshape as ls
    >>> block = ls.resonator(50.0, 0.5, 0.05).block({})
    >>> round(abs(block.parameters["damping1"] / block.parameters["damping2"]))
    10
    """
    wide, narrow = RESONATOR
    return _block("notch", {"f2_hz": "f1_hz"}, f1_hz=f_hz, damping1=damping1 or wide, damping2=damping2 or narrow)


def complex_lead(f1_hz: Parameter = None, f2_hz: Parameter = None, damping: Parameter = None) -> BlockTemplate:
    """Lead of a complex pair of zeros at `f1_hz` and of poles at `f2_hz` with one damping; a lag where f1 > f2.

    It turns the phase by more in a narrower band than two equal lead-lags in series, which it is with damping 1
    (Messner, Bedillion, Xia and Karns, Lead and lag compensators with complex poles and zeros, IEEE Control Systems
    Magazine 27(1), 2007).

    >>> import loopshape as ls
    >>> ls.complex_lead(20.0, 60.0, 0.4).tie
    {'damping2': 'damping1'}
    """
    return _block("notch", {"damping2": "damping1"}, f1_hz=f1_hz, f2_hz=f2_hz, damping1=damping or COMPLEX)


def low_pass(f_hz: Parameter = None, damping: Parameter = None, *, order: int = 2) -> BlockTemplate:
    """A low-pass of first or second order with its corner in Hz; `damping` for the second order alone.

    >>> import loopshape as ls
    >>> ls.low_pass(120.0, order=1).kind
    'low_pass_1'
    """
    if order == 1 and damping is None:
        return _block("low_pass_1", f_hz=f_hz)
    if order != 2:
        raise WrongUseError("a low-pass has order 1, without damping, or 2", f"order {order}, damping {damping!r}")
    return _block("low_pass_2", f_hz=f_hz, damping=damping)


def pi(f_hz: Parameter = None) -> BlockTemplate:
    """(s + w)/s: an integrator up to the corner `f_hz`.

    >>> import loopshape as ls
    >>> ls.pi(0.5).kind
    'pi'
    """
    return _block("pi", f_hz=f_hz)


def pid(
    gain: Parameter = None, fi_hz: Parameter = None, fd_hz: Parameter = None, ff_hz: Parameter = None,
    **gains: float,
) -> BlockTemplate:  # fmt: skip
    """A PID with a tame derivative, gain (1 + wi/s + (s/wd)/(s/wf + 1)); corners in Hz, `ff_hz` that of the filter.

    By `kp`, `ti`, `td`, `tf` (in s) it is kp (1 + 1/(ti s) + td s/(tf s + 1)), by `kp`, `ki`, `kd`, `tf` it is
    kp + ki/s + kd s/(tf s + 1): all four are numbers above zero.

    >>> import loopshape as ls
    >>> ls.controller(ls.pid(2.0, 0.5, 8.0, 200.0), rate_hz=1000.0).integrators()
    1
    >>> round(ls.pid(kp=2.0, ti=0.5, td=0.02, tf=0.001).parameters["fi_hz"], 4)
    0.3183
    """
    if gains:
        if {*gains} not in ({"kp", "ti", "td", "tf"}, {"kp", "ki", "kd", "tf"}) or not min(gains.values()) > 0.0:
            raise WrongUseError(
                "a PID by its times or gains has kp, ti, td, tf or kp, ki, kd, tf, all above zero",
                ", ".join(f"{name} = {value!r}" for name, value in gains.items()), "or use corners in Hz",
            )  # fmt: skip
        kp, tf = gains["kp"], gains["tf"]
        ti, td = (gains["ti"], gains["td"]) if "ti" in gains else (kp / gains["ki"], gains["kd"] / kp)
        gain, fi_hz, fd_hz, ff_hz = kp, *(1.0 / (TWO_PI * t) for t in (ti, td, tf))
    return _block("pid", gain=gain, fi_hz=fi_hz, fd_hz=fd_hz, ff_hz=ff_hz)


def controller(
    *blocks: BlockTemplate,
    rate_hz: float,
    loop: str = "",
    prewarp_hz: float | None = None,
    computation_delay_s: float = 0.0,
    added_hold: bool = False,
    precision: str = "double",
) -> Controller:
    """A controller of blocks in series with all parameters given, as it runs at `rate_hz` after Tustin's rule.

    Keywords are those of `Controller`. Raises WrongUseError where a parameter is left to tuning.

    >>> import loopshape as ls
    >>> ls.controller(ls.gain(2.0), ls.lead_lag(8.0, 150.0), rate_hz=1000.0)
    Controller: gain, lead_lag at 1000 Hz
    """
    for one in blocks:
        if free := [name for name, value in one.parameters.items() if isinstance(value, Free)]:
            raise WrongUseError(f"{an(one.kind)} block of a controller needs numbers", ", ".join(free), "or use tune")
    made: tuple[Block, ...] = tuple(one.block({}) for one in blocks)
    return Controller(
        loop, made, rate_hz, prewarp_hz=prewarp_hz, computation_delay_s=computation_delay_s, added_hold=added_hold,
        precision=precision,
    )  # fmt: skip


def bounded(structure: Sequence[BlockTemplate], plants: Sequence[FRF]) -> tuple[BlockTemplate, ...]:
    """The structure with bounds for what was open: frequencies in the plants' valid bands, gains about 1/|P|."""
    if not any(value == OPEN for block in structure for value in block.parameters.values()):
        return tuple(structure)
    bands = np.array([frf.valid_band_hz for frf in plants])
    low, high = float(np.nanmin(bands)), float(np.nanmax(bands))
    sizes = np.concatenate([np.abs(frf.siso[frf.valid]) for frf in plants])
    gain_decades = 3.0  # decades about 1/|P| in the valid band that an open gain may reach
    usual, factor = 1.0 / float(np.exp(np.mean(np.log(sizes)))), 10.0**gain_decades

    def closed(name: str, value: float | Free) -> float | Free:
        if value != OPEN:
            return value
        if name == "gain":
            return Free(usual / factor, usual * factor)
        return Free(*DAMPINGS[name]) if name in DAMPINGS else Free(low, high)

    return tuple(
        replace(block, parameters={name: closed(name, value) for name, value in block.parameters.items()})
        for block in structure
    )
