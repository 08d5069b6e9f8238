"""Compiled kernels kept on disk: an edit anywhere beneath one is seen, for every user and two processes at once."""

import importlib.util
import json
import logging
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import examiner
import numba
import numpy as np
import pytest

import loopshape
from loopshape.core.kernels.compiled import compiled, compiled_reading, sources

MASS, VISCOUS, TICK_S, TICKS = 2.0, 3.0, 1e-3, 1000
#: where a mass pushed off at 1 m/s is after a second, and how many kernels were compiled for it
COASTS = f"""
import json, sys
import numpy as np
from loopshape.toolbox.servo import closed_loop, motion, parameters as k
c = np.zeros(len(k.AXIS_PARAMETERS.rows))
c[k.MASS], c[k.VISCOUS] = {MASS}, {VISCOUS}
c.setflags(write=len(sys.argv) == 1)  # another type for the compiler
axis = closed_loop.under_way(c, 0.0, 1.0, 0.0)
closed_loop.follow(axis, np.zeros({TICKS}), np.zeros({TICKS}), (0.0, 0.0), {TICK_S}, 1)
json.dump([axis.x[motion.DRIVE], closed_loop.follow.stats.cache_misses.total()], sys.stdout)
"""
BRAKED = pytest.approx(MASS / VISCOUS * (1.0 - math.exp(-VISCOUS / MASS * TICKS * TICK_S)), rel=1e-6)  # m dv/dt = -d v
FREE = pytest.approx(TICKS * TICK_S, rel=1e-12)
#: the files of ours that each of the modules named brings with it, its packages' own files left out
LOADED = """
import importlib, itertools, json, os, sys, types
files, ours = {}, ("loopshape", "examiner")
for name in sys.argv[1:]:
    for loaded in [m for m in sys.modules if m.split(".")[0] in ours]:
        del sys.modules[loaded]
    for place in sys.argv[1:]:
        for package in itertools.accumulate(place.split(".")[:-1], "{}.{}".format):
            bare = sys.modules[package] = types.ModuleType(package)
            bare.__path__ = [package.replace(".", "/")]
    importlib.import_module(name)
    found = [m for n, m in sys.modules.items() if n.split(".")[0] in ours and hasattr(m, "__file__")]
    files[name] = [os.path.relpath(m.__file__) for m in found]
json.dump(files, sys.stdout)
"""


def copied(folder):
    """A copy of the package that nobody has run yet."""
    here = Path(loopshape.__file__).parent
    return shutil.copytree(here, folder / "loopshape", ignore=shutil.ignore_patterns("__pycache__"))


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    return copied(tmp_path_factory.mktemp("package"))


def started(package, *words, code=COASTS, **environment):
    path = {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(package.parent / "cache")}
    return subprocess.Popen(
        [sys.executable, "-c", code, *words], cwd=package.parent, env=os.environ | path | environment,
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


def answer(process):
    output, _ = process.communicate(timeout=200)
    assert process.returncode == 0
    return json.loads(output)


def coast(package, *words, **environment):
    """Metres after a second, and how many kernels were compiled for it."""
    return answer(started(package, *words, **environment))


def edit(file, old, new):
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


def name(file, package):
    return ".".join(file.relative_to(package.parent).with_suffix("").parts)


def kept(package):
    return {p.name for p in (package / "__pycache__/kernels").glob("*servo.closed_loop-*")}


@pytest.mark.long
def test_two_processes_that_compile_at_once_keep_both_forms(tmp_path):
    package = copied(tmp_path)
    both = [started(package), started(package, "read-only")]
    assert [answer(one) for one in both] == [[BRAKED, 1]] * 2
    assert [coast(package), coast(package, "read-only")] == [[BRAKED, 0]] * 2


@pytest.mark.long
@pytest.mark.short
def test_an_edited_callee_gives_new_physics(package):
    """A force in a file beneath the kernel's is multiplied by 0; what was compiled before is used no more, and gone."""
    coast(package)
    before = kept(package)
    file = package / "toolbox/servo/motion.py"
    edit(file, "    viscous = c[k.VISCOUS]", "    viscous = 0.0 * c[k.VISCOUS]")
    assert coast(package) == [FREE, 1]
    assert len(kept(package)) == 1
    assert not kept(package) & before
    edit(file, "    viscous = 0.0 * c[k.VISCOUS]", "    viscous = c[k.VISCOUS]")
    assert coast(package) == [BRAKED, 1]


@pytest.mark.long
def test_another_processor_has_its_own(package):
    """A home that machines share: none runs, or writes over, what another compiled for itself."""
    coast(package)
    assert coast(package, NUMBA_CPU_NAME="generic") == [BRAKED, 1]
    assert coast(package) == [BRAKED, 0]


@pytest.mark.long
def test_a_damaged_file_is_compiled_again(package):
    coast(package)
    for name in kept(package):
        file = package / "__pycache__/kernels" / name
        whole = file.read_bytes()
        file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert coast(package) == [BRAKED, 1]
    assert coast(package) == [BRAKED, 0]


@pytest.mark.long
def test_where_the_package_cannot_be_written_the_users_folder_serves(tmp_path):
    package = copied(tmp_path)
    (package / "__pycache__").touch()  # stands where a folder would be made, for root too
    assert [coast(package), coast(package)] == [[BRAKED, 1], [BRAKED, 0]]
    assert (tmp_path / "cache/loopshape/kernels").is_dir()
    nowhere = {"XDG_CACHE_HOME": str(package / "__init__.py")}
    assert coast(package, **nowhere) == [BRAKED, 1]


@pytest.mark.long
def test_a_key_covers_all_that_an_import_runs(package):
    """For every file with a compiled function: no module of ours that Python loads with it is outside its key."""
    rooms = [Path(one.__file__).parent for one in (loopshape, examiner)]
    files = {name(p, room): p for room in rooms for p in room.rglob("*.py") if "@compiled" in p.read_text()}
    assert len(files) > 15
    shutil.copytree(rooms[1], package.parent / "examiner", ignore=shutil.ignore_patterns("__pycache__"))
    loaded = answer(started(package, *files, code=LOADED))
    for module, file in files.items():
        keyed = {str(p.relative_to(room.parent)) for p in sources(file) for room in rooms if p.is_relative_to(room)}
        assert set(loaded[module]) <= keyed, module


def test_what_is_imported_for_types_alone_is_no_part_of_a_key(tmp_path):
    """An edit of what no kernel runs compiles none again, and a start reads a few files and not the whole package."""
    (tmp_path / "kernel.py").write_text(
        "from typing import TYPE_CHECKING\n\nimport runs\n\nif TYPE_CHECKING:\n    import types_alone\n\n"
        "    from types_too import Kind\nimport runs_too\n"
    )
    for one in ("runs", "runs_too", "types_alone", "types_too"):
        (tmp_path / f"{one}.py").write_text("")
    assert {p.stem for p in sources(tmp_path / "kernel.py")} == {"kernel", "runs", "runs_too"}
    margins = Path(loopshape.__file__).with_name("core") / "kernels" / "loops" / "margins.py"
    assert not [p for p in sources(margins) if "core" not in p.parts and p.name != "__init__.py"]


@compiled
def scaled(x, factor):
    return factor * x


@compiled_reading("out")
def summed(x, out):
    out[0] += scaled(x[0], 2) + scaled(x[1], 3)


@compiled
def of_both(x):
    own, out = x + 1.0, np.zeros(1)
    summed(x, out)
    summed(own, out)
    return out[0]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_constants_and_arrays_of_a_kernel_s_own_share_one_form():
    given = np.array([1.0, 10.0])
    given.setflags(write=False)
    assert of_both(given) == 2.0 * 1.0 + 3.0 * 10.0 + 2.0 * 2.0 + 3.0 * 11.0
    assert [len(one.signatures) for one in (scaled, summed)] in ([1, 1], [0, 0])  # none where the caller was kept whole


def test_what_it_reads_may_not_be_written():
    @compiled_reading("out")
    def turned(x, out):
        x[0] = out[0]

    @compiled
    def caller(x):
        turned(x, x)

    if not numba.config.DISABLE_JIT:
        with pytest.raises(numba.TypingError, match=r"[Cc]annot"):
            caller(np.zeros(1))


def test_a_kernel_for_kernels_alone_refuses_python_before_and_after_it_is_compiled(monkeypatch):
    monkeypatch.setattr("loopshape.core.kernels.compiled.keep", lambda function: None)  # a second run finds no module

    def _within(x):
        return 2.0 * x

    _within.__module__ = "loopshape.core.kernels.tried"  # there a name with a line before it says so
    within = compiled(_within)

    @compiled
    def caller(x):
        return within(x)

    for _ in range(2 if not numba.config.DISABLE_JIT else 0):
        with pytest.raises(TypeError, match="called by kernels alone"):
            within(4.0)
        assert caller(4.0) == 8.0


def test_a_compilation_is_logged_and_a_kept_form_is_not(tmp_path, caplog):
    (tmp_path / "doubled_kernel.py").write_text("def doubled(x):\n    return 2.0 * x\n")
    spec = importlib.util.spec_from_file_location("doubled_kernel", tmp_path / "doubled_kernel.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    caplog.set_level(logging.INFO, "loopshape.kernels")
    assert [compiled(module.doubled)(4.0) for _ in range(2)] == [8.0, 8.0]
    assert caplog.messages == ["compiling doubled"]
