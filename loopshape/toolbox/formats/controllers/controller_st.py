"""A controller as structured text (IEC 61131-3): a function block, alone or as a POU that TwinCAT 3 imports."""

from __future__ import annotations

import uuid

from loopshape.data.control.controller import Controller
from loopshape.toolbox.formats.controllers.controller_words import about, block_words, comment, identifier

_DECLARATION = """{about}
FUNCTION_BLOCK FB_{name}
VAR_INPUT
    fIn : {kind}; (* error *)
    bReset : BOOL; (* to rest: all states become zero *)
END_VAR
VAR_OUTPUT
    fOut : {kind}; (* control, without a limit: limit and anti-windup belong to the caller *)
END_VAR
VAR
    fValue : {kind};
    fNext : {kind};
{states}
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


def st_text(controller: Controller) -> str:
    """The function block of a controller, in ASCII; call it once a sample. Numbers read back exactly."""
    declaration, body = _parts(controller)
    return f"{declaration}{body}END_FUNCTION_BLOCK\n"


def twincat_text(controller: Controller) -> str:
    """The same as a POU file of TwinCAT 3 (`.TcPOU`); its Id follows from the controller's digest."""
    declaration, body = _parts(controller)
    name = identifier(controller.loop)
    guid = uuid.uuid5(uuid.NAMESPACE_OID, f"{name} {controller.digest}")
    return _TWINCAT.format(name=name, guid=guid, declaration=declaration, body=body)


def _parts(controller: Controller) -> tuple[str, str]:
    """Declaration and body: direct form II transposed, in REAL for single precision and in LREAL for any other."""
    kind = "REAL" if controller.precision == "single" else "LREAL"
    sections = controller.biquads().tolist()
    states = [f"s{k}_{j}" for k in range(1, len(sections) + 1) for j in (1, 2)]
    head = [
        *about(controller),
        "In fixed point the signals are not rounded here." if controller.number_format.fixed else "",
    ]
    declaration = _DECLARATION.format(
        about="\n".join(f"(* {comment(line)} *)" for line in head if line), name=identifier(controller.loop), kind=kind,
        states="\n".join(f"    {state} : {kind} := 0.0;" for state in states),
    )  # fmt: skip
    rows = ["IF bReset THEN", *(f"    {state} := 0.0;" for state in states), "END_IF", "fValue := fIn;"]
    for k, (block, row) in enumerate(zip(controller.blocks, sections, strict=True), start=1):
        rows += [f"(* {comment(block_words(block))} *)", *_section(k, *(_number(x) for x in row))]
    return declaration, "\n".join([*rows, "fOut := fValue;"]) + "\n"


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
    return f"({text})" if value < 0.0 else text
