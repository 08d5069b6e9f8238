"""Diagrams by file: check and tune of two actuators, learning, and the exported C stepped against the simulation."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from bench_nouns import LoopSetup, RequirementResult
from commands import loopshape
from run_files import write_frfs

import loopshape as ls
from loopshape.toolbox.diagrams.files import read_diagram
from loopshape.toolbox.pages.report.report_inputs import gather
from loopshape.toolbox.rig.target.blocks import blocks

RATE = 2000.0
F = np.geomspace(0.1, 800.0, 90)
MODELS = {
    "P1": control.c2d(control.ss(control.tf([4000.0], [1.0, 20.0, 100.0])), 1.0 / RATE),
    "P2": control.c2d(control.ss(control.tf([1.0e6], [1.0, 400.0, 1.0e6])), 1.0 / RATE),
}
PAGE = (Path(__file__).parents[3] / "docs" / "structures.md").read_text()
DIAGRAM = PAGE.split("```toml\n")[1].split("```")[0]
REQUIRE = """
format = "loopshape-requirements/1"
[[loop]]
name = "C1"
sensitivity_peak_db = 6.0
integrators = 0
structure = [{ kind = "gain", gain = [0.01, 100.0] }]
"""


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with the FRFs of two loops, and the files beside it."""
    words = {"relative_std": 0.01, "open_loop": True, "recording": "r"}
    frfs = [ls.FRF.from_control(MODELS[p], F, loop=loop, **words) for p, loop in (("P1", "coarse"), ("P2", "fine"))]
    write_frfs(tmp_path / "run", frfs)
    (tmp_path / "diagram.toml").write_text(DIAGRAM)
    C1 = ls.controller(ls.gain(0.8), ls.lead_lag(20.0, 200.0), rate_hz=RATE, loop="C1")
    ls.write(C1, tmp_path / "c.toml")
    return tmp_path / "run"


def test_a_diagram_is_checked_at_its_tuned_block(run: Path) -> None:
    require = run.parent / "r.toml"
    require.write_text('format = "loopshape-requirements/1"\n[[loop]]\nname = "C1"\nmodulus_margin = 0.3\n')
    done = loopshape(
        "check", run, run.parent / "c.toml", "--require", require, "--diagram", run.parent / "diagram.toml", "--json"
    )
    answer = json.loads(done.stdout)
    assert [one["loop"] for one in answer["loops"]] == ["C2", "C1"]
    assert answer["passed"]
    assert any(Path(path).name == "diagram.png" for path in answer["figures"])


def test_a_diagram_with_an_unstable_inner_loop_is_refused_in_words(run: Path) -> None:
    text = DIAGRAM.replace("gain = 0.3", "gain = 30.0")
    (run.parent / "diagram.toml").write_text(text)
    done = loopshape("check", run, run.parent / "c.toml", "--diagram", run.parent / "diagram.toml")
    assert done.returncode == 2
    assert "inner loop C2 is unstable" in " ".join(done.stderr.split())


def test_learning_says_whether_trials_converge(tmp_path: Path) -> None:
    s = 2j * np.pi * F
    P = ls.FRF.from_arrays(F, 20.0 / s, relative_std=0.01, rate_hz=RATE, loop="x", recording="r", open_loop=True)
    write_frfs(tmp_path / "run", [P])
    ls.write(ls.controller(ls.gain(0.5), rate_hz=RATE, loop="x"), tmp_path / "c.toml")
    out = tmp_path / "learning.json"
    loopshape("learning", tmp_path / "run", tmp_path / "c.toml", "--band-hz", 0.1, 20, "--out", out)
    told = json.loads(out.read_text())
    L = ls.learning(P, ls.controller(ls.gain(0.5), rate_hz=RATE), band_hz=(0.1, 20.0))
    assert told["converges"] == "passed"
    np.testing.assert_allclose(told["factor"], L.factor)
    assert (tmp_path / "run" / "figures" / "learning_x.png").exists()


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("kind", ["parallel", "observer", "repetitive", "decoupled"])
def test_exported_c_steps_as_the_simulation(kind: str, tmp_path: Path) -> None:
    """The step in C, fed with what the simulation measured, gives what the simulation put into the plants."""
    C = ls.controller(ls.gain(0.8), ls.lead_lag(20.0, 200.0), rate_hz=RATE)
    P1, P2 = (ls.FRF.from_control(MODELS[name], F, relative_std=0.01) for name in ("P1", "P2"))
    C2 = ls.controller(ls.gain(0.3), ls.low_pass(30.0, order=1), rate_hz=RATE)
    nominal = control.tf([4000.0], [1.0, 20.0, 100.0])
    D, models = {
        "parallel": (ls.diagrams.dual_stage(P1, P2, C2).with_part("C1", C), MODELS),
        "observer": (
            ls.diagrams.disturbance_observer(P1, nominal, ls.low_pass(20.0, 0.7)).with_part("C", C),
            {"P": MODELS["P1"]},
        ),
        "decoupled": decoupled_by_filters(C),
        "repetitive": (
            ls.learning.repetitive(P1, C, 0.05, 300.0, learning=ls.gain(0.5), preview=7),
            {"P": MODELS["P1"]},
        ),
    }[kind]
    ls.formats.export(D, tmp_path, "c")
    outputs = ["u"] if kind in ("observer", "repetitive") else ["u1", "u2"]
    inputs = ["r1", "r2", "y1", "y2"] if kind == "decoupled" else ["r", "y"]
    read = " ".join(["%lf"] * len(inputs))
    show = " ".join(["%.17g"] * len(outputs))
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "diagram.h"\nint main(void) {\n'
        "  diagram_state s; diagram_inputs in; diagram_outputs out; diagram_reset(&s);\n"
        f'  while (scanf("{read}", {", ".join(f"&in.{n}" for n in inputs)}) == {len(inputs)}) {{\n'
        "    diagram_step(&s, &in, &out);\n"
        f'    printf("{show}\\n", {", ".join(f"out.{n}" for n in outputs)}); }}\n  return 0; }}\n'
    )
    command = ["cc", "-std=c99", "-Wall", "-Werror", "-ffp-contract=off", "main.c", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    signals = ls.diagrams.simulate(
        D, models, {r: np.sin((0.02 + 0.01 * k) * np.arange(300)) for k, r in enumerate(D.external)}
    )
    rows = np.stack([signals[name] for name in inputs], axis=1).tolist()
    lines = "\n".join(" ".join(map(repr, row)) for row in rows)
    done = subprocess.run([tmp_path / "main"], input=lines, capture_output=True, text=True, check=True, timeout=60)
    found = np.array([row.split() for row in done.stdout.splitlines()], dtype=float).T
    for name, values in zip(outputs, found, strict=True):
        np.testing.assert_allclose(values, signals[name], atol=1e-9 * np.abs(signals[name]).max())


def decoupled_by_filters(C: ls.Controller) -> tuple[ls.diagrams.Diagram, dict[str, control.StateSpace]]:
    """Two loops that share an actuator's lag, behind filters of second order, and the plant's model."""
    both = control.append(MODELS["P1"], MODELS["P2"])
    mixed = control.ss(both.A, both.B, np.array([[1.0, 0.4], [0.3, 1.0]]) @ both.C, both.D, both.dt)
    P = ls.FRF.from_control(mixed, F, relative_std=0.01, inputs=("a_v", "b_v"))
    return ls.diagrams.decoupled(P, ls.diagrams.decouple(P, (2.0, 100.0), 2), {"a_v": C, "b_v": C}), {"P": mixed}


def test_a_diagram_still_to_be_tuned_is_not_exported(tmp_path: Path) -> None:
    P = ls.FRF.from_control(MODELS["P1"], F)
    D = ls.diagrams.prefilter(P, ls.controller(ls.gain(1.0), rate_hz=RATE))
    with pytest.raises(ls.errors.WrongUseError, match="no controller yet"):
        ls.formats.export(D, tmp_path, "c")


def test_a_diagram_is_exported_by_the_command_as_by_the_function(run: Path) -> None:
    words = ("--diagram", run.parent / "diagram.toml", "--run", run)
    for to, name in (("c", "diagram.h"), ("json", "diagram.json")):
        out = run.parent / to
        done = loopshape("export-controller", run.parent / "c.toml", "--to", to, "--out", out, *words, "--json")
        told = json.loads(done.stdout)
        assert [one["loop"] for one in told["exported"]] == ["C1", "C2"]
        assert told["diagram"] == str(out / name)
        D = read_diagram(run.parent / "diagram.toml", run)
        (C1,) = ls.read_controllers(run.parent / "c.toml")
        for path in ls.formats.export(D.with_part("C1", C1), run.parent / f"{to}2", to):
            assert path.read_bytes() == (out / path.name).read_bytes()
    for half in (words[:2], words[2:]):
        done = loopshape("export-controller", run.parent / "c.toml", "--to", "c", "--out", run.parent / "x", *half)
        assert done.returncode == 2
        assert "give both" in done.stderr


def test_a_report_shows_the_diagram_and_the_loops_within(run: Path) -> None:
    """Picture, inner loop and the tuned loop on what its block meets, with the margins of `check`."""
    (run.parent / "r.toml").write_text(REQUIRE.split("structure")[0])
    words = ["--controller", run.parent / "c.toml", "--require", run.parent / "r.toml"]
    words += ["--diagram", run.parent / "diagram.toml", "--json"]
    told = json.loads(loopshape("report", run, *words).stdout)
    page = (run / "report.html").read_text()
    D = read_diagram(run.parent / "diagram.toml", run)
    (C1,) = ls.read_controllers(run.parent / "c.toml")
    met = ls.diagrams.equivalent(D)
    verdict = ls.check(met.plants, C1, met.asked(ls.Requirements("C1", sensitivity_peak_db=6.0, integrators=0)))
    assert told["outcome"] == verdict.outcome == "passed"
    assert 'alt="Block diagram; tuned is block C1"' in page
    assert "Inner loop C2" in page
    (inner,), (outer,) = met.inner["C2"].margins.values(), verdict.margins.values()
    for m in (inner, outer):
        assert f"{m.phase_margin_deg:.4g}" in page
        assert f"{m.sensitivity_peak_db:.4g}" in page
    assert DIAGRAM.splitlines()[1] in page  # verbatim, under provenance
    assert "has no frequency response" not in page


def test_a_diagram_s_report_fails_with_a_loop_within(run: Path) -> None:
    """The outcome of the whole counts a requirement of a loop within that is missed."""
    made = gather(run, run.parent / "c.toml", None, "today", diagram=run.parent / "diagram.toml")
    assert made.outcome is None
    asked = replace(
        made.inner["C2"], lines=(RequirementResult("phase_margin_deg", "deg", 60.0, 10.0, -50.0, "failed", "r", None),)
    )
    assert replace(made, inner={"C2": asked}).outcome == "failed"


def test_decoupling_filters_run_on_a_target_as_they_are_drawn() -> None:
    """The target's blocks, evaluated one after the other at 7 Hz, give z as the diagram has it."""
    D, _ = decoupled_by_filters(ls.controller(ls.gain(0.8), ls.lead_lag(20.0, 200.0), rate_hz=RATE))
    columns = {"y1": "a_rad", "y2": "b_rad", "u1": "z_a_v", "u2": "z_b_v", "r1": "r_a_rad", "r2": "r_b_rad"}
    loops = [LoopSetup(n, f"r_{n}_rad", f"n_{n}_rad", f"z_{n}_v", f"{n}_rad", None) for n in ("a", "b")]
    made, given = blocks(ls.diagrams.Wired(D, columns), loops, RATE)
    near = int(np.argmin(np.abs(F - 7.0)))
    z = np.exp(-2j * np.pi * F[near] / RATE)
    for k, moved in enumerate(("r1", "r2", "y1", "y2")):
        signals = [1.0 + 0j if i == k else 0j for i in range(4)]
        for one in made:
            value = sum(weight * signals[i] for i, weight in one.terms)
            for b0, b1, b2, a1, a2 in one.sections:
                value *= (b0 + b1 * z + b2 * z**2) / (1.0 + a1 * z + a2 * z**2)
            signals.append(value)
        for loop, to in (("a", "u1"), ("b", "u2")):
            wanted = ls.diagrams.transfer(D, moved, to, opened=("P",)).siso[near]
            assert signals[4 + given[loop]] == pytest.approx(wanted, rel=1e-9)
