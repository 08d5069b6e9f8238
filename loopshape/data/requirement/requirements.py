"""What is required of a loop or of several at once, and the table of limits.

`Requirements` have a field for each limit and `Margins` a reading, so a check is one loop over `LIMITS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.gate import pass_fields
from loopshape.core.units import db, from_db
from loopshape.data.control.block import BlockTemplate
from loopshape.data.requirement.limits_over import MASKED, AtPoints, Mask
from loopshape.data.requirement.weight import Objective, Weight, is_number
from loopshape.data.result.detuning import SEARCHED_PERCENT


class Scale(StrEnum):
    """How the kernel's column tells a quantity: in its own unit, as its ln, or (dB) as ln of its inverse."""

    PLAIN = "plain"
    LN = "ln"
    INVERSE = "inverse"


@dataclass(frozen=True)
class Limit:
    """A row of the table that check, tune, tables, report, page and JSON loop over: a quantity and how it is limited.

    For people: `label` is its name, `unit` its unit, `sense` `at_least` or `at_most`. A value asked for is finite,
    `positive` or not below `least`, and at most `most`, for the reason `why_most`. `plot` is the response (S, T, CS,
    PS, L, L phase) on which its worst place is marked, and its limit drawn where that is a ceiling in dB. `margin` puts
    it in the report's table of margins, not of peaks. `closeness` ranks, from 1, what says how close L comes to -1; 0
    says nothing of it. `keeps_off` marks what alone is enough to keep L off -1: a tuning needs one. `together` says
    that several loops at once can be held to it, or to it "alone".

    For the readings: `column` of `core.kernels.loops.margins` on its `scale`, or `read`, "module:function" of a loop to
    a `Reading`. A reading that is freed of its bias lies between 0 and `ceiling`. A `distance` scatters as a logarithm
    only where its deviation, on the column's scale, is at most this. `asked` is read only where it is asked for,
    `crossing` only where the 0 dB crossing is in sight, and `open` has no end where the last line does not reach it.
    `magnitude` is that of `core.kernels.loops.tuning_rows` which a tuning holds below the limit; `own_rows` says that a
    tuning reads it otherwise. A limit with neither cannot be tuned for. `disturbed` ones need what disturbs the loop.
    """

    name: str
    sense: str
    unit: str
    label: str
    plot: str = ""
    positive: bool = False
    least: float = -np.inf
    most: float = np.inf
    why_most: str = "no loop whose |L| falls off has more"
    margin: bool = False
    closeness: int = 0
    keeps_off: bool = False
    together: str = ""
    column: str = ""
    scale: Scale = Scale.PLAIN
    read: str = ""
    ceiling: float | None = None
    distance: float = np.inf
    asked: bool = False
    crossing: bool = False
    open: bool = False
    magnitude: str = ""
    own_rows: bool = False
    disturbed: bool = False

    def value(self, column: Any) -> Any:
        """The quantity from the kernel's column, of numbers or arrays."""
        with np.errstate(over="ignore", divide="ignore"):
            if self.scale is Scale.INVERSE:
                return -db(np.exp(column))
            return np.exp(column) if self.scale is Scale.LN else column

    def on_column(self, value: Any) -> Any:
        """The kernel's column from the quantity."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.scale is Scale.INVERSE:
                return -np.log(from_db(value))
            return np.log(value) if self.scale is Scale.LN else value

    def of_db(self, step: float) -> float:
        """A step in dB on the kernel's column."""
        return step if self.scale is Scale.PLAIN else float(np.log(from_db(step)))

    @property
    def column_sign(self) -> float:
        """1 where the kernel's column is to be large, -1 where it is to be small."""
        return 1.0 if (self.sense == "at_least") != (self.scale is Scale.INVERSE) else -1.0

    @property
    def sign(self) -> float:
        """1 where the quantity is to be large, -1 where it is to be small."""
        return 1.0 if self.sense == "at_least" else -1.0

    @property
    def short(self) -> str:
        """Its name for people without the explanation in brackets."""
        return self.label.split(" (")[0]

    def refuse(self, value: float | None, whose: str) -> None:
        """Refuse a value that makes no sense."""
        of = f"{self.name} of {whose}"
        if value is None:
            return
        if self.positive:
            refuse_not_positive(of, value)
        if not np.isfinite(value):
            raise WrongUseError(f"{of} must be finite", f"{value!r}")
        if value < self.least:
            below = "negative" if self.least == 0.0 else f"below {self.least:g}"
            raise WrongUseError(f"{of} must not be {below}", f"{value!r}")
        if value > self.most:
            raise WrongUseError(f"{of} must not exceed {self.most:g}", f"{value!r}", self.why_most)


def refuse_not_positive(what: str, value: float) -> None:
    """Refuse a number that is not positive and finite."""
    if not 0.0 < value < np.inf:
        raise WrongUseError(f"{what} must be positive and finite", f"{value!r}")


_SEARCHED = "shifts are not searched farther; a plant that moves so much needs FRFs of each of its states"
_ROWS: tuple[Limit, ...] = (
    Limit("gain_margin_db", "at_least", "dB", "gain margin", plot="L", least=0.0, margin=True, closeness=5,
          keeps_off=True, column="GAIN_DB", ceiling=np.inf, own_rows=True),
    Limit("gain_reduction_margin_db", "at_least", "dB", "gain reduction margin", plot="L", least=0.0, margin=True,
          closeness=6, column="REDUCTION_DB", ceiling=np.inf, crossing=True, own_rows=True),
    Limit("phase_margin_deg", "at_least", "deg", "phase margin", plot="L phase", least=0.0, most=180.0, margin=True,
          closeness=4, keeps_off=True, column="PHASE_DEG", ceiling=180.0, crossing=True, own_rows=True),
    Limit("modulus_margin", "at_least", "1", "modulus margin", plot="S", positive=True, most=1.0, margin=True,
          closeness=1, keeps_off=True, together="too", column="LN_MODULUS", scale=Scale.LN, distance=0.5,
          magnitude="S"),
    Limit("delay_margin_s", "at_least", "s", "delay margin", plot="L phase", positive=True, margin=True, closeness=7,
          keeps_off=True, column="LN_DELAY_S", scale=Scale.LN, crossing=True, own_rows=True),
    Limit("sensitivity_peak_db", "at_most", "dB", "peak |S|", plot="S", closeness=2, keeps_off=True, together="too",
          column="LN_MODULUS", scale=Scale.INVERSE, distance=0.5, magnitude="S"),
    Limit("complementary_peak_db", "at_most", "dB", "peak |T|", plot="T", closeness=8, together="too",
          column="COMPLEMENTARY_DB", distance=4.34, magnitude="T"),
    Limit("control_peak_db", "at_most", "dB", "peak |CS|", plot="CS", column="CONTROL_DB", distance=4.34,
          magnitude="CS"),
    Limit("control_high_frequency_db", "at_most", "dB", "|CS| at high frequency", plot="CS", column="CONTROL_HIGH_DB",
          magnitude="CS"),
    Limit("bandwidth_hz", "at_least", "Hz", "bandwidth (first 0 dB crossing of L)", plot="L", positive=True,
          margin=True, column="LN_BANDWIDTH_HZ", scale=Scale.LN, own_rows=True),
    Limit("disk_margin", "at_least", "1", "disk margin", positive=True, most=2.0, margin=True, closeness=3,
          keeps_off=True, together="too", column="LN_DISK", scale=Scale.LN, ceiling=2.0, distance=0.5,
          magnitude="DISK"),
    Limit("process_peak_db", "at_most", "dB", "peak |PS|", plot="PS", column="PROCESS_DB", distance=4.34,
          magnitude="PS"),
    Limit("sensitivity_bandwidth_hz", "at_least", "Hz", "bandwidth of S (|S| rises through -3 dB)", positive=True,
          column="LN_SENSITIVITY_HZ", scale=Scale.LN, open=True, own_rows=True),
    Limit("complementary_bandwidth_hz", "at_least", "Hz", "bandwidth of T (|T| falls through -3 dB)", positive=True,
          column="LN_COMPLEMENTARY_HZ", scale=Scale.LN, open=True, own_rows=True),
    Limit("controller_bandwidth_hz", "at_most", "Hz", "bandwidth of C (|C| within 3 dB of its largest)", positive=True,
          read="loopshape.loop.margin.margins:controller_bandwidth", own_rows=True),
    Limit("detuning_percent", "at_least", "%", "detuning margin (shift of the plant's frequencies)",
          positive=True, most=SEARCHED_PERCENT, why_most=_SEARCHED, margin=True, own_rows=True),
    Limit("sensitivity_mask_db", "at_most", "dB", "|S| over its mask", plot="S", column="MASK_S", asked=True,
          magnitude="S"),
    Limit("complementary_mask_db", "at_most", "dB", "|T| over its mask", plot="T", column="MASK_T", asked=True,
          magnitude="T"),
    Limit("control_mask_db", "at_most", "dB", "|CS| over its mask", plot="CS", column="MASK_CS", asked=True,
          magnitude="CS"),
    Limit("process_mask_db", "at_most", "dB", "|PS| over its mask", plot="PS", column="MASK_PS", asked=True,
          magnitude="PS"),
    Limit("loop_mask_db", "at_most", "dB", "|L| over its mask", plot="L", column="MASK_L", asked=True,
          magnitude="LOOP"),
    Limit("loop_floor_db", "at_most", "dB", "|L| below its floor", plot="L", column="FLOOR_L", asked=True,
          magnitude="FLOOR"),
    Limit("weighted_norm", "at_most", "1", "norm of the weighted loop", positive=True, column="LN_WEIGHTED",
          scale=Scale.LN, asked=True, magnitude="NORM"),
    Limit("error_rms", "at_most", "1", "rms of the error (in the output's unit)", positive=True, own_rows=True,
          disturbed=True),
    Limit("control_rms", "at_most", "1", "plant input rms (in its unit)", positive=True, own_rows=True,
          disturbed=True),
    Limit("control_peak", "at_most", "1", "plant input peak (in its unit, over the record)", positive=True,
          own_rows=True, disturbed=True),
    Limit("control_rate", "at_most", "1", "plant input peak rate (in its unit a second, over the record)",
          positive=True, own_rows=True, disturbed=True),
    Limit("saturation_percent", "at_most", "%", "share of time in saturation", positive=True, most=50.0,
          why_most="a loop that saturates more of the time is no linear one any more", own_rows=True, disturbed=True),
    Limit("input_output_disk_margin", "at_least", "1", "disk margin, inputs and outputs at once",
          positive=True, most=2.0, together="alone"),
)  # fmt: skip
#: what a single loop keeps, and what all loops of a plant keep at once
LIMITS = tuple(limit for limit in _ROWS if limit.together != "alone")
TOGETHER = tuple(sorted((x for x in _ROWS if x.together), key=lambda x: "disk" not in x.name))
LIMIT_OF = {limit.name: limit for limit in _ROWS}
#: fields of `Requirements` that are lists of tables in a file
_TABLES = ("masks", "weights", "at", "structure")
#: limits that hold for all operating points alike
OF_ALL_POINTS = ("controller_bandwidth_hz", "detuning_percent", "weighted_norm")


@dataclass(frozen=True, eq=False)
class Requirements:
    """What one loop must keep at every operating point, or all loops of a plant together; None requires nothing.

    `control_high_frequency_db` limits |CS| at and above `control_high_frequency_from_hz`. `structure` is
    the controller that `tune` may choose from; `check` does not need it. `band_hz` narrows the lines that
    are looked at, and None takes the FRF's valid band. `integrators` and `unstable_poles` declare the
    plant's; None leaves them to its fit or its lowest lines. `objective` is what `tune` makes large within them all.
    `masks` limit responses over frequency; each sets the allowance that belongs to it (`sensitivity_mask_db`: by how
    much |S| may exceed its masks) to 0. `weights` make one norm of |S|, |T|, |CS| and |PS| over all frequencies, the
    same at all operating points: `weighted_norm` limits it, and the objective may make it small. `error_rms` limits the
    rms of the error, in the output's unit, under what disturbs the loop: `check` and `tune` need a recording of that.
    So do `control_rms`, `control_peak` and `control_rate` of the plant's input, in its unit, and `saturation_percent`,
    the share of time at which it lies outside `control_range` (lowest and highest input).
    Where several of `at` hold at an operating point the last has its way. What all loops keep together
    (`ls.check(..., together=...)`) is of `TOGETHER`, the poles and the band alone: `input_output_disk_margin` there.
    Refuses values that make no sense.
    """

    loop: str = ""
    gain_margin_db: float | None = None
    gain_reduction_margin_db: float | None = None
    phase_margin_deg: float | None = None
    modulus_margin: float | None = None
    delay_margin_s: float | None = None
    sensitivity_peak_db: float | None = None
    complementary_peak_db: float | None = None
    control_peak_db: float | None = None
    control_high_frequency_db: float | None = None
    control_high_frequency_from_hz: float | None = None
    bandwidth_hz: float | None = None
    disk_margin: float | None = None
    input_output_disk_margin: float | None = None
    process_peak_db: float | None = None
    sensitivity_bandwidth_hz: float | None = None
    complementary_bandwidth_hz: float | None = None
    controller_bandwidth_hz: float | None = None
    detuning_percent: float | None = None
    sensitivity_mask_db: float | None = None
    complementary_mask_db: float | None = None
    control_mask_db: float | None = None
    process_mask_db: float | None = None
    loop_mask_db: float | None = None
    loop_floor_db: float | None = None
    weighted_norm: float | None = None
    error_rms: float | None = None
    control_rms: float | None = None
    control_peak: float | None = None
    control_rate: float | None = None
    saturation_percent: float | None = None
    control_range: tuple[float, float] | None = None
    masks: tuple[Mask, ...] = ()
    weights: tuple[Weight, ...] = ()
    at: tuple[AtPoints, ...] = ()
    band_hz: tuple[float, float] | None = None
    structure: tuple[BlockTemplate, ...] = ()
    integrators: int | None = None
    unstable_poles: int | None = None
    objective: Objective = Objective()  # noqa: RUF009 (frozen)
    READ_AS: ClassVar = {"loop": "name"}
    ALSO_READ: ClassVar[tuple[str, ...]] = ("disturbance_below_hz",)

    def __repr__(self) -> str:
        """One line: its loop and each limit that is given."""
        asked = [(x, value) for x in LIMIT_OF.values() if (value := getattr(self, x.name)) is not None]
        words = [f"{limit.name} {limit.sense.replace('_', ' ')} {value:g}" for limit, value in asked]
        words += [f"others at {len(self.at)} ranges of operating points"] if self.at else []
        return f"Requirements{f' {self.loop}' if self.loop else ''}: {', '.join(words) or 'none'}"

    def __post_init__(self) -> None:
        pass_fields(self)
        self._check_values()
        self._allow_nothing_over_masks()
        for one in self.at:
            self._check_at(one)
        if not self.weights and (self.weighted_norm is not None or self.objective.weighted_norm):
            raise WrongUseError(
                f"a weighted norm of loop {self.loop!r} needs weights", "none", "give weights = (ls.Weight(...), ...)"
            )
        if (self.control_high_frequency_db is None) != (self.control_high_frequency_from_hz is None):
            raise WrongUseError(
                f"loop {self.loop!r}: control_high_frequency_db and control_high_frequency_from_hz go together",
                "one of them",
                "give both or none",
            )

    def _check_values(self) -> None:
        for limit in LIMIT_OF.values():
            limit.refuse(getattr(self, limit.name), f"loop {self.loop!r}")
        if self.control_high_frequency_from_hz is not None:
            what = f"control_high_frequency_from_hz of loop {self.loop!r}"
            refuse_not_positive(what, self.control_high_frequency_from_hz)
        if self.band_hz is not None and not _rising_pair(self.band_hz):
            raise WrongUseError("band_hz is two rising frequencies", f"{self.band_hz!r}")
        self._check_range()
        for name, least in (("integrators", -2), ("unstable_poles", 0)):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < least):
                raise WrongUseError(f"{name} of loop {self.loop!r} is a whole number from {least}", f"{value!r}")

    def _check_range(self) -> None:
        ends = self.control_range
        if ends is not None:
            if len(ends) != 2 or not all(is_number(x) and np.isfinite(x) for x in ends) or ends[0] >= ends[1]:
                raise WrongUseError(
                    f"control_range of loop {self.loop!r} is the lowest and the highest input", f"{ends!r}",
                    "for example control_range = [-10.0, 10.0]",
                )  # fmt: skip
            object.__setattr__(self, "control_range", (float(ends[0]), float(ends[1])))
        every = (self.saturation_percent, *(one.limits.get("saturation_percent") for one in self.at))
        if ends is None and any(value is not None for value in every):
            raise WrongUseError(
                f"saturation_percent of loop {self.loop!r} needs the actuator's range", "none",
                "give control_range, the lowest and the highest input",
            )  # fmt: skip

    def _allow_nothing_over_masks(self) -> None:
        masked = {mask.quantity for mask in self.masks}
        for name in MASKED:
            if name in masked and getattr(self, name) is None:
                object.__setattr__(self, name, 0.0)
            if name not in masked and getattr(self, name) is not None:
                raise WrongUseError(
                    f"{name} of loop {self.loop!r} needs a mask", f"{getattr(self, name)!r}", "give one"
                )

    def _check_at(self, one: AtPoints) -> None:
        """Refuse limits at operating points that are none of one operating point, or make no sense."""
        known = {limit.name for limit in LIMITS} - set(OF_ALL_POINTS) - set(MASKED)
        if unknown := sorted(set(one.limits) - known):
            raise WrongUseError(
                f"at operating points of loop {self.loop!r} cannot be limited", ", ".join(unknown),
                f"known are {', '.join(sorted(known))} and masks",
            )  # fmt: skip
        for name, value in one.limits.items():
            if not is_number(value):
                raise WrongUseError(f"{name} of loop {self.loop!r} must be a number", f"{value!r}")
        self._with(one)

    def _with(self, one: AtPoints) -> Requirements:
        replaced = {mask.quantity for mask in one.masks}
        kept = tuple(mask for mask in self.masks if mask.quantity not in replaced)
        changes: dict[str, Any] = {name: float(value) for name, value in one.limits.items()}
        return replace(self, at=(), masks=(*kept, *one.masks), **changes)

    def of(self, point: Mapping[str, float]) -> Requirements:
        """What is required at an operating point."""
        made = self
        for one in self.at:
            made = made._with(one) if one.holds_at(point) else made
        return replace(made, at=()) if self.at else self

    def limited(self) -> tuple[str, ...]:
        """Names of the quantities that are limited, at some operating point at least, in the order of `LIMITS`."""
        every = (self, *(self._with(one) for one in self.at))
        return tuple(x.name for x in LIMITS if any(getattr(one, x.name) is not None for one in every))

    def moved(self, by: Mapping[str, float]) -> Requirements:
        """The same with limits moved by these amounts, at all operating points."""
        at = tuple(replace(one, limits={k: v + by.get(k, 0.0) for k, v in one.limits.items()}) for one in self.at)
        own = {name: getattr(self, name) for name in by}
        changes: dict[str, Any] = {name: now + by[name] for name, now in own.items() if now is not None}
        return replace(self, at=at, **changes)

    def stricter(self, limits: Mapping[str, float]) -> Requirements:
        """Requirements under which these limits hold too: of each quantity the stricter one."""
        made: dict[str, Any] = {}
        for name, limit in limits.items():
            own, tighter = getattr(self, name), max if LIMIT_OF[name].sense == "at_least" else min
            made[name] = limit if own is None else tighter(own, limit)
        return replace(self, **made)

    def of_all(self) -> Requirements:
        """These, as what all loops of a plant keep together; refuses what is of each loop by itself."""
        own = [*(limit.name for limit in TOGETHER), "integrators", "unstable_poles", "band_hz"]
        if unfit := [
            f.name for f in fields(self) if f.name not in ("loop", *own) and getattr(self, f.name) != f.default
        ]:
            what = f"all loops together are limited by {', '.join(own)} alone"
            raise WrongUseError(what, ", ".join(unfit), "limit each loop by itself")
        if self.integrators is not None and self.integrators < 0:
            raise WrongUseError("integrators of several loops is a whole number from 0", f"{self.integrators!r}")
        return self

    def with_all(self, together: Requirements) -> Requirements:
        """Requirements of the one loop that there is, with what all loops keep: the stricter limit, its own poles."""
        limits = {x.name: v for x in TOGETHER if (v := getattr(together, x.name)) is not None}
        own = [x for x in ("integrators", "unstable_poles", "band_hz") if getattr(self, x) is None]
        return replace(self.stricter(limits), **{name: getattr(together, name) for name in own})

    def masks_on(self, plot: str) -> tuple[Mask, ...]:
        """Masks of a response, those of some operating points alone included."""
        every = (*self.masks, *(mask for one in self.at for mask in one.masks))
        return tuple(mask for mask in every if mask.response == plot)

    def ceilings_db(self, plot: str) -> list[tuple[float, float | None]]:
        """Upper limits of a response in dB that are asked for, each with the frequency it begins at (None: all)."""
        begins = {"control_high_frequency_db": self.control_high_frequency_from_hz}
        drawn = [x for x in LIMITS if (x.plot, x.sense, x.unit) == (plot, "at_most", "dB") and x.name not in MASKED]
        asked = ((getattr(self, x.name), begins.get(x.name)) for x in drawn)
        return [(limit, from_hz) for limit, from_hz in asked if limit is not None]

    @classmethod
    def unfolded(cls, table: Mapping[str, Any]) -> dict[str, Any]:
        """A `[[loop]]` with its objective as a table of weights."""
        given = dict(table)
        below = {key: given.pop(key) for key in cls.ALSO_READ if key in given}
        if below or "objective" in given:
            given["objective"] = Objective.unfolded(given.get("objective", "bandwidth"), below)
        return given

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Self:
        """Requirements of a table with `name`, whose values are of the kinds of the fields."""
        given = cls.unfolded(table)
        for key, kind in {"structure": BlockTemplate, "weights": Weight}.items():
            given[key] = tuple(map(kind.from_table, given.get(key, ())))  # type: ignore[attr-defined]
        given["at"] = tuple(map(AtPoints.unfolded, given.get("at", ())))
        for one in (given, *given["at"]):
            one["masks"] = tuple(Mask(**mask) for mask in one.get("masks", ()))
        given |= {"at": tuple(AtPoints(**x) for x in given["at"]), "objective": Objective(**given.get("objective", {}))}
        return cls(loop=given.pop("name"), **given)

    def to_table(self) -> dict[str, Any]:
        """The table of these requirements in a file, as `from_table` reads it; what is at its default is left out.

        Refuses weights that have no form in a file.
        """
        asked = {f.name: value for f in fields(self) if (value := getattr(self, f.name)) != f.default}
        made = {name: [one.to_table() for one in asked.pop(name)] for name in _TABLES if name in asked}
        made |= {"objective": asked.pop("objective").to_table()} if "objective" in asked else {}
        made |= {"band_hz": list(asked.pop("band_hz"))} if "band_hz" in asked else {}
        return {"name": asked.pop("loop", ""), **asked, **made}


def _rising_pair(band: Any) -> bool:
    numbers = isinstance(band, (list, tuple)) and all(isinstance(x, (int, float)) for x in band)
    return numbers and len(band) == 2 and 0.0 < band[0] < band[1] < np.inf
