"""The winch as an FMU, compiled from `winch_fmu.c`: its description, its library, and the archive around them."""

import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

PARAMETERS = {"inertia": 0.020, "damping": 0.05, "spring": 0.8, "weight": 0.30, "load": 0.0}
SOURCE = Path(__file__).with_name("winch_fmu.c")


def built(folder, version):
    """The path of winch.fmu in the folder, FMI 2 or 3."""
    fmpy = pytest.importorskip("fmpy", reason="the extra `fmu` is not installed")
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    library = folder / f"winch{fmpy.sharedLibraryExtension}"
    own = ["-DFMI3"] if version == 3 else []
    (folder / "rest.c").write_text(rest(version))
    sources = [SOURCE, folder / "rest.c"]
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", *own, "-o", library, *sources, "-lm"], check=True)
    place = fmpy.platform_tuple if version == 3 else fmpy.platform
    with zipfile.ZipFile(folder / "winch.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description(version))
        archive.write(library, f"binaries/{place}/{library.name}")
    return folder / "winch.fmu"


def rest(version):
    """Functions of the standard that FMPy looks for and nobody calls here: each gives an error."""
    from fmpy import fmi2, fmi3

    names = [n for n in dir(fmi3.FMU3Model if version == 3 else fmi2.FMU2Model) if re.match(r"fmi[23][A-Z]", n)]
    written = SOURCE.read_text()
    return "".join(f"int {n}(void) {{ return 3; }}\n" for n in names if f"{n}(" not in written)


def description(version):
    """modelDescription.xml."""
    rows = [(n, "parameter", "tunable", v) for n, v in PARAMETERS.items()] + [("drum", "input", "continuous", 0.0)]
    return (_third if version == 3 else _second)(rows)


def _second(rows):
    one = '<ScalarVariable name="{}" valueReference="{}" causality="{}" variability="{}"{}><Real {}/></ScalarVariable>'
    own = [one.format(n, k, c, v, "", f'start="{s}"') for k, (n, c, v, s) in enumerate(rows)]
    exact = ' initial="exact"'
    own += [one.format(n, 6 + k, "local", "continuous", exact, 'start="0"') for k, n in enumerate(("angle", "speed"))]
    own += [one.format(f"der({n})", 8 + k, "local", "continuous", "", f'derivative="{7 + k}"')
            for k, n in enumerate(("angle", "speed"))]  # fmt: skip
    return (
        '<?xml version="1.0"?><fmiModelDescription fmiVersion="2.0" modelName="winch" guid="w1" '
        'numberOfEventIndicators="0"><ModelExchange modelIdentifier="winch"/><ModelVariables>' + "".join(own)
        + '</ModelVariables><ModelStructure><Derivatives><Unknown index="9"/><Unknown index="10"/></Derivatives>'
        "</ModelStructure></fmiModelDescription>"
    )  # fmt: skip


def _third(rows):
    one = '<Float64 name="{}" valueReference="{}" causality="{}" variability="{}" {}/>'
    own = ['<Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>']
    own += [one.format(n, k, c, v, f'start="{s}"') for k, (n, c, v, s) in enumerate(rows)]
    own += [one.format(n, 6 + k, "local", "continuous", 'initial="exact" start="0"')
            for k, n in enumerate(("angle", "speed"))]  # fmt: skip
    own += [one.format(f"der({n})", 8 + k, "local", "continuous", f'derivative="{6 + k}"')
            for k, n in enumerate(("angle", "speed"))]  # fmt: skip
    return (
        '<?xml version="1.0"?><fmiModelDescription fmiVersion="3.0" modelName="winch" instantiationToken="w1">'
        '<ModelExchange modelIdentifier="winch"/><ModelVariables>' + "".join(own) + "</ModelVariables><ModelStructure>"
        '<ContinuousStateDerivative valueReference="8"/><ContinuousStateDerivative valueReference="9"/>'
        "</ModelStructure></fmiModelDescription>"
    )  # fmt: skip
