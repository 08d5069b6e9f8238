"""A controller as structured text (IEC 61131-3): a function block, alone or as a POU that TwinCAT 3 imports."""

from __future__ import annotations

import uuid

from loopshape.data.control.controller import Controller
from loopshape.toolbox.formats.controllers.controller_words import about, block_words, comment, identifier
from loopshape.toolbox.formats.controllers.limited import AntiWindup, LimitedLaw

_DECLARATION = """{about}
FUNCTION_BLOCK FB_{name}
VAR_INPUT
    fIn : {kind}; (* error *)
    bReset : BOOL; (* to rest: all states become zero *)
{start}END_VAR
VAR_OUTPUT
    fOut : {kind}; (* {output} *)
END_VAR
VAR
    fValue : {kind};
    fNext : {kind};
{extra}{states}
END_VAR
"""
_TWINCAT = """<?xml version="1.0" encoding="utf-8"?>
<TcPlcObject Version="1.1.0.1">
  <POU Name="FB_{name}" Id="{{{guid}}}" SpecialFunc="None">
    <Declaration><![CDATA[{declaration}]]></Declaration>
    <Implementation>
      <ST><![CDATA[{body}]]></ST>
    </Implementation>
  </POU>
</TcPlcObject>
"""


def st_text(controller: Controller, law: LimitedLaw | None = None) -> str:
    """The function block of a controller, in ASCII; call it once a sample. Numbers read back exactly."""
    declaration, body = _parts(controller, law)
    return f"{declaration}{body}END_FUNCTION_BLOCK\n"


def twincat_text(controller: Controller, law: LimitedLaw | None = None) -> str:
    """The same as a POU file of TwinCAT 3 (`.TcPOU`); its Id follows from the controller's digest."""
    declaration, body = _parts(controller, law)
    name = identifier(controller.loop)
    guid = uuid.uuid5(uuid.NAMESPACE_OID, f"{name} {controller.digest}")
    return _TWINCAT.format(name=name, guid=guid, declaration=declaration, body=body)


def _parts(controller: Controller, law: LimitedLaw | None) -> tuple[str, str]:
    """Declaration and body: direct form II transposed, in REAL for single precision and in LREAL for any other."""
    kind = "REAL" if controller.precision == "single" else "LREAL"
    order = range(len(controller.blocks)) if law is None else law.order
    sections = controller.biquads()[list(order)].tolist()
    states = [f"s{k}_{j}" for k in range(1, len(sections) + 1) for j in (1, 2)]
    head = [
        *about(controller),
        "In fixed point the signals are not rounded here." if controller.number_format.fixed else "",
    ]
    output = "control, without a limit: limit and anti-windup belong to the caller"
    start, extra = "", ""
    if law is not None:
        limits = law.limits
        output = f"control, from {limits.low} to {limits.high}, {limits.rate} a second at most"
        start = (
            "    bStart : BOOL; (* take over at fStart without a bump: filters at rest at this error *)\n"
            f"    fStart : {kind};\n"
        )
        names = ["fLow", "fHigh", "fDriven", "fGiven", *(f"fIn{k}" for k in _integrating(law))]
        extra = f"    fLast : {kind} := 0.0;\n" + "".join(f"    {name} : {kind};\n" for name in names)
    declaration = _DECLARATION.format(
        about="\n".join(f"(* {comment(line)} *)" for line in head if line), name=identifier(controller.loop), kind=kind,
        states="\n".join(f"    {state} : {kind} := 0.0;" for state in states), output=output, start=start, extra=extra,
    )  # fmt: skip
    numbers = [[_number(x) for x in row] for row in sections]
    last = ["    fLast := 0.0;"] if law is not None else []
    rows = ["IF bReset THEN", *(f"    {state} := 0.0;" for state in states), *last, "END_IF"]
    if law is not None:
        rows += ["IF bStart THEN", *(f"    {line}" for line in _start(law, numbers)), "END_IF"]
    rows.append("fValue := fIn;")
    first = len(sections) - (0 if law is None else law.integrating)
    for k, place, row in zip(range(1, first + 1), order, numbers, strict=False):
        rows += [f"(* {comment(block_words(controller.blocks[place]))} *)", *_section(k, *row)]
    if law is not None:
        rows += _limited(law, numbers)
    return declaration, "\n".join([*rows, "fOut := fValue;"]) + "\n"


def _integrating(law: LimitedLaw) -> range:
    return range(len(law.order) - law.integrating + 1, len(law.order) + 1)


def _start(law: LimitedLaw, numbers: list[list[str]]) -> list[str]:
    """Takes over at an output: as `Running.start`."""
    low, high, last = _number(law.limits.low), _number(law.limits.high), len(numbers)
    rows = ["fGiven := fStart;", f"IF fGiven > {high} THEN fGiven := {high}; END_IF"]
    rows += [f"IF fGiven < {low} THEN fGiven := {low}; END_IF", "fValue := fIn;"]
    for k, (b0, b1, b2, a1, a2) in enumerate(numbers, start=1):
        out = "fGiven" if k == last else "0.0"
        if k not in _integrating(law):
            out = f"(({b0} + {b1}) + {b2}) / ((1.0 + {a1}) + {a2}) * fValue"
        rows += [
            f"fNext := {out};",
            f"s{k}_2 := {b2} * fValue - {a2} * fNext;",
            f"s{k}_1 := fNext - {b0} * fValue;",
            "fValue := fNext;",
        ]
    return [*rows, "fLast := fGiven;"]


def _limited(law: LimitedLaw, numbers: list[list[str]]) -> list[str]:
    """The integrating sections, the ends of the output, and what the sections keep: as `Running.step`."""
    limits, places = law.limits, _integrating(law)
    rows = [f"fDriven := {'-' if law.turned else ''}fValue;"]
    for k in places:
        rows += [f"fIn{k} := fValue;", f"fValue := {numbers[k - 1][0]} * fValue + s{k}_1;"]
    rows += [f"fLow := {_number(limits.low)};", f"fHigh := {_number(limits.high)};"]
    if law.step < float("inf"):
        step = _number(law.step)
        rows += [f"IF fLast - {step} > fLow THEN fLow := fLast - {step}; END_IF"]
        rows += [f"IF fLast + {step} < fHigh THEN fHigh := fLast + {step}; END_IF"]
    rows += [
        "fGiven := fValue;",
        "IF fValue > fHigh THEN fGiven := fHigh; END_IF",
        "IF fValue < fLow THEN fGiven := fLow; END_IF",
    ]
    back = limits.anti_windup is AntiWindup.BACK_CALCULATION
    rows.append(f"fNext := fValue + {_number(law.share)} * (fGiven - fValue);" if back else "fNext := fValue;")
    kept = [line for k in places for line in _kept(k, places, numbers[k - 1])]
    if not back and kept:
        kept = ["IF NOT ((fValue - fGiven) * fDriven > 0.0) THEN", *(f"    {line}" for line in kept), "END_IF"]
    return [*rows, *kept, "fLast := fGiven;", "fValue := fGiven;"]


def _kept(k: int, places: range, row: list[str]) -> list[str]:
    _, b1, b2, a1, a2 = row
    out = "fNext" if k == places[-1] else f"fIn{k + 1}"
    return [f"s{k}_1 := {b1} * fIn{k} - {a1} * {out} + s{k}_2;", f"s{k}_2 := {b2} * fIn{k} - {a2} * {out};"]


def _section(k: int, b0: str, b1: str, b2: str, a1: str, a2: str) -> list[str]:
    return [
        f"fNext := {b0} * fValue + s{k}_1;",
        f"s{k}_1 := {b1} * fValue - {a1} * fNext + s{k}_2;",
        f"s{k}_2 := {b2} * fValue - {a2} * fNext;",
        "fValue := fNext;",
    ]


def _number(value: float) -> str:
    """A number that reads back exactly; a negative one in brackets, since the language has no two signs in a row."""
    text = repr(value) if "." in repr(value) else repr(value).replace("e", ".0e")
    return f"({text})" if text.startswith("-") else text
