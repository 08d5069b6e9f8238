"""A machine of which an FRF alone was measured: its formula with one thing changed and noise, and a linear model."""

import json
from dataclasses import replace

import numpy as np
import pytest
from commands import loopshape
from scipy.linalg import expm

import loopshape as ls
from loopshape.toolbox.gap.nouns.machine import Input, Model, ModelParameter, Output, Port
from loopshape.toolbox.gap.own.linear import simulable

MOTOR, LOAD, DAMPING, SPRING = 0.006, 0.014, 0.05, 0.8


def motion(t, x, u, p):
    """Angle and speed of a lever on a spring."""
    return x[1], (u[0] - p.damping * x[1] - p.spring * x[0]) / (p.motor + p.lever + 0.03 * p.load)


PARAMETERS = (
    ModelParameter("motor", MOTOR, "kg m2", 0.03, "none"),
    ModelParameter("lever", LOAD, "kg m2", 0.03, "none"),
    ModelParameter("damping", DAMPING, "N m s/rad", 0.10, "none"),
    ModelParameter("spring", SPRING, "N m/rad", 0.03, "none"),
    ModelParameter("load", 0.0, "kg", effect="payload@lever", range=(0.0, 1.0)),
)
MODEL = Model(
    "winch", motion, ("angle", "speed"), PARAMETERS, (Input("drum", "torque_nm", unit="N m"),),
    (Output("encoder", "angle", "lever_rad", unit="rad"),),
    (Port("bearing", "drum", "angle", "speed", motor_inertia="motor", unit="N m"),),
)  # fmt: skip


def frf_of(inertia=0.0, viscous=0.0, delay_s=0.0, stiffness=0.0, absorber=0.0, std=0.01, seed=1, hold_hz=0.0, lines=96):
    """The lever's response by its formula, every number within its tolerance, from 0.4 to 40 Hz."""
    f, rng = np.geomspace(0.4, 40.0, lines), np.random.default_rng(seed)
    s = 2j * np.pi * f
    own = 1.01 * LOAD * s**2 + (1.04 * DAMPING + viscous) * s + 0.985 * SPRING + inertia * s**2
    if absorber:  # a mass on a soft spring, of 9 Hz
        w = 2 * np.pi * 9.0
        own = own + absorber * s**2 * (w**2 + 0.1 * w * s) / (s**2 + 0.1 * w * s + w**2)
    if stiffness:  # the encoder on the motor's side
        through = stiffness + 0.01 * s
        response = (own + through) / (own * through + (own + through) * 1.01 * MOTOR * s**2)
    else:
        response = 1.0 / (own + 1.01 * MOTOR * s**2)
    response = response * np.exp(-s * delay_s)
    if hold_hz:
        response = response * (1.0 - np.exp(-s / hold_hz)) / (s / hold_hz)
    noise = np.sqrt(0.5) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    hold = {"rate_hz": hold_hz, "hold": "included"} if hold_hz else {}
    return ls.FRF.from_arrays(
        f, response * (1.0 + std * noise), relative_std=std, inputs=("torque_nm",), outputs=("lever_rad",),
        recording="bench", **hold,
    )  # fmt: skip


@pytest.mark.long
def test_a_payload_is_named_with_its_size_and_a_budget_by_lines_held_out():
    found = ls.gap(frf_of(inertia=0.006), model=MODEL)
    first = found.ranking[0]
    assert found.verdict == first.effect == "payload@lever"
    assert first.magnitude == pytest.approx(0.2, rel=0.15)
    assert found.gap.before > 3.0
    assert found.gap.after < 1.5
    assert found.budget[0].gap == pytest.approx(found.gap.before)
    assert [(x.output, str(x.source)) for x in found.floors] == [("encoder", "frf")]
    kinds = {name.split("@")[0] for r in found.ranking for name in r.effect.split("+")}
    assert not kinds & {"coulomb_friction", "backlash", "dead_zone", "actuator_saturation", "force_offset"}
    assert "joint_flexibility" in kinds
    assert any("coulomb_friction" in note and "record" in note for note in found.notes)


@pytest.mark.long
@pytest.mark.parametrize("hold_hz", [0.0, 100.0])
def test_a_delay_is_named_as_twins_and_the_hold_is_none(hold_hz):
    found = ls.gap(frf_of(delay_s=0.006, hold_hz=hold_hz), model=MODEL)
    first = next(r for r in found.ranking if r.effect == "actuator_delay@drum")
    assert {"actuator_delay@drum", "sensor_delay@encoder"} <= set(found.ambiguity[0])
    assert found.verdict in ("actuator_delay@drum", "sensor_delay@encoder")
    assert first.magnitude == pytest.approx(6.0, rel=0.05)


@pytest.mark.long
def test_a_flexible_joint_is_named_with_its_stiffness():
    found = ls.gap(frf_of(stiffness=60.0), model=MODEL)
    # the form takes the rotor's inertia as nominal: 1 % of it may stand beside, as a gain of 1 %
    assert "joint_flexibility@bearing" in found.verdict.split("+")
    alone = next(r for r in found.ranking if r.effect == "joint_flexibility@bearing")
    assert alone.magnitude == pytest.approx(60.0, rel=0.1)
    assert found.gap.after < 2.0


@pytest.mark.long
def test_a_healthy_machine_within_its_tolerances_has_no_gap():
    found = ls.gap(frf_of(), model=MODEL)
    assert found.verdict == "none"
    assert found.gap.before < 2.0


@pytest.mark.hour
@pytest.mark.long
def test_a_resonance_that_no_effect_makes_is_unknown():
    assert ls.gap(frf_of(absorber=0.008), model=MODEL).verdict == "unknown"


@pytest.mark.parametrize("hold_hz", [0.0, 100.0])
def test_a_recording_of_an_frf_is_what_the_machine_answers_to_its_input(hold_hz):
    # two outputs in other units; the truth is the exact response of the matrices to the held input
    frf = frf_of(std=1e-9, hold_hz=hold_hz)
    s = 2j * np.pi * frf.frequency_hz
    both = np.stack([frf.siso, 1e3 * s * frf.siso], axis=1)[:, :, None]
    hold = {"rate_hz": hold_hz, "hold": "included"} if hold_hz else {}
    frf = ls.FRF.from_arrays(
        frf.frequency_hz, both, relative_std=0.02, inputs=("torque_nm",), outputs=("lever_rad", "speed_mrad_s"), **hold
    )
    outputs = (*MODEL.outputs, Output("speed", "speed", "speed_mrad_s", 1e-3, "rad/s"))
    plant, run = simulable(replace(MODEL, outputs=outputs), [frf])
    inertia, damping, spring = 1.01 * (MOTOR + LOAD), 1.04 * DAMPING, 0.985 * SPRING
    whole = expm(np.array([[0, 1, 0], [-spring / inertia, -damping / inertia, 1 / inertia], [0, 0, 0]]) / run.rate_hz)
    for r in run.recordings[:2]:
        u, x, y = r.column("torque_nm"), np.zeros(2), []
        for held in u:
            y.append(x)
            x = whole[:2, :2] @ x + whole[:2, 2] * held
        late = slice(u.size // 2, None)  # the start is forgotten
        for column, mine in zip(("lever_rad", "speed_mrad_s"), (np.array(y) * [1.0, 1e3]).T, strict=True):
            off = np.sqrt(np.mean((r.column(column) - mine)[late] ** 2)) / np.std(mine[late])
            assert off < 0.01
    assert [o.leaves for o in plant.model.outputs] == pytest.approx(
        [
            0.02 * np.sqrt(np.mean(r.column(o.column) ** 2)) * o.factor
            for o, r in zip(outputs, run.recordings, strict=False)
        ],
        rel=0.3,
    )


def with_friction(t, x, u, p):
    """The lever with dry friction."""
    return x[1], (u[0] - 0.02 * np.tanh(x[1] / 0.01) - p.damping * x[1] - p.spring * x[0]) / (p.motor + p.lever)


def test_a_model_that_is_not_linear_is_refused():
    bent = Model("winch", with_friction, MODEL.states, PARAMETERS, MODEL.inputs, MODEL.outputs, MODEL.ports)
    with pytest.raises(ls.errors.WrongUseError, match=r"FRF.*linear model.*record in time"):
        ls.gap(frf_of(), model=bent)


def test_an_frf_without_error_other_columns_or_too_few_lines_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match=r"error.*relative-std"):
        ls.gap(frf_of(std=0.0), model=MODEL)
    other = ls.FRF.from_arrays([1.0, 2.0], [1j, 1.0], relative_std=0.1, inputs=("u_v",), outputs=("lever_rad",))
    with pytest.raises(ls.errors.WrongUseError, match=r"u_v.*torque_nm"):
        ls.gap(other, model=MODEL)
    with pytest.raises(ls.errors.WrongUseError, match="lines"):
        ls.gap(frf_of(lines=10), model=MODEL)
    with pytest.raises(ls.errors.WrongUseError, match="model of your own"):
        ls.gap(frf_of())


@pytest.mark.long
def test_a_folder_of_import_frf_is_diagnosed_by_the_command(tmp_path):
    frf = frf_of(inertia=0.006)
    f, g = frf.frequency_hz, frf.siso
    table = np.column_stack([f, g.real, g.imag])
    np.savetxt(tmp_path / "bench.csv", table, delimiter=",", header="frequency_hz,real,imag", comments="")
    (tmp_path / "model.toml").write_text(
        'format = "loopshape-model/1"\naxis = "rotary"\neffort = { column = "torque_nm" }\n'
        'position = { column = "lever_rad" }\n[numbers]\ninertia = { value = 0.020, tolerance = 0.03 }\n'
        "damping = { value = 0.05, tolerance = 0.1 }\nspring = { value = 0.8, tolerance = 0.03 }\n"
    )

    names = ("--inputs", "torque_nm", "--outputs", "lever_rad", "--relative-std", "0.01")
    assert loopshape("import-frf", tmp_path / "bench.csv", "--out", tmp_path / "bench", *names).returncode == 0
    answer = tmp_path / "gap.json"
    words = ("--model", tmp_path / "model.toml", "--save-answer", answer)
    assert loopshape("gap", tmp_path / "bench", *words, "--report", tmp_path / "gap.png").returncode == 0
    found = json.loads(answer.read_text())
    assert found["verdict"].startswith("payload@")
    assert abs(sum(r["probability"] for r in found["ranking"]) - 1.0) < 1e-6
    assert found["floors"][0]["source"] == "frf"
