"""What stands between a user's recordings and a diagnosis: units, settings, constants, files that change, limits.

Truths are simulated by scipy with tight tolerance, or are real recordings whose columns were spoiled by a known factor.
"""

import os
from dataclasses import dataclass, field, replace
from functools import cache

import numba
import numpy as np
import own_machine
import pytest
from bench_nouns import RecordingInfo
from run_files import write_json
from scipy.integrate import solve_ivp

import loopshape as ls
from loopshape.io.input_guard import noting
from loopshape.toolbox.gap.diagnose.diagnose import Attribution
from loopshape.toolbox.gap.nouns.gap_report import BudgetPart, BudgetStep
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.plant import OwnMachine
from loopshape.toolbox.gap.recordings.next_recording import SHARES, repeat
from loopshape.toolbox.gap.recordings.suitable import suitable

DEG = 180.0 / np.pi


FAST = replace(own_machine.MODEL, motion=numba.njit(nogil=True)(own_machine.motion))  # compiled once for all tests


@cache
def winch(**effect):
    return own_machine.run_of(2, **effect)


def spoiled(run, columns, factor=1.0, shift=0.0):
    """The run with columns multiplied and moved."""

    def changed(r):
        own = {k: factor * r.column(k) + shift if k in columns else r.column(k) for k in r.columns}
        return ls.Recording(r.info, r.rate_hz, own)

    return replace(run, recordings=tuple(changed(r) for r in run.recordings))


@cache
def compiled(motion):
    """A machine with this right-hand side, compiled for its own names of parameters."""
    return Composed(next(m for m in (FAST, PENDULUM, servo_model()) if m.motion is motion))


def checked(run, model=FAST):
    """Only what is looked at before anything is fitted."""
    plant = OwnMachine(model, composed=compiled(model.motion).of(model))
    return plant.readied(run, [r.info.name for r in run.recordings if r.info.role == "estimation"])


@pytest.mark.long
@pytest.mark.parametrize("factor", [DEG, 1.0 / DEG, 1000.0, 1e-3, 2.0 * np.pi, -1.0])
@pytest.mark.parametrize("column", ["torque_nm", "lever_rad"])
def test_a_column_wrong_by_a_plain_factor_is_named_with_its_factor_and_key(column, factor):
    with pytest.raises(ls.errors.WrongUseError, match="mapped wrongly") as refused:
        checked(spoiled(winch(), [column], factor))
    text = str(refused.value)
    assert column in text.split(":")[0]
    assert f'beside column = "{column}" by {1.0 / factor:.6g}' in text
    assert "model.toml" in text


@pytest.mark.long
@pytest.mark.parametrize(
    "wrong", [{"inertia": 0.5}, {"inertia": 2.0}, {"damping": 4.0}, {"damping": 0.0}, {"spring": 2.0}, {"weight": 0.0}]
)
def test_no_wrong_parameter_is_a_slip_of_units(wrong):
    own = [replace(p, value=wrong.get(p.name, 1.0) * p.value) for p in FAST.parameters]
    checked(winch(), replace(FAST, parameters=tuple(own)))


@pytest.mark.long
@pytest.mark.parametrize(("column", "factor"), [("torque_nm", 1.5), ("torque_nm", 0.5), ("lever_rad", 2.0),
                                                ("lever_rad", 0.6), ("torque_nm", 4.0)])  # fmt: skip
def test_a_gain_that_a_parameter_may_make_is_left_to_the_diagnosis(column, factor):
    checked(spoiled(winch(), [column], factor))


def servo(t, x, u, p):
    """A position servo: a PD law of gain u[1] on the reference u[0] drives an inertia with damping and a payload."""
    torque = u[1] * (u[0] - x[0]) + u[2]
    return x[1], (torque - p.damping * x[1]) / (p.inertia + p.payload)


def servo_model(**gain):
    """The servo as a user describes it; what `gain` says of the input of that name."""
    return ls.gap.Model(
        "servo", FAST_SERVO, ("angle", "speed"),
        (
            ls.gap.ModelParameter("inertia", 0.02, "kg m2", 0.03, "none"),
            ls.gap.ModelParameter("damping", 0.1, "N m s/rad", 0.1),
            ls.gap.ModelParameter("payload", 0.0, "kg m2", effect="payload@arm", range=(0.0, 0.1)),
        ),
        (ls.gap.Input("target", "target_rad", unit="rad"), ls.gap.Input("kp", "kp_nm_per_rad", unit="N m/rad", **gain),
         ls.gap.Input("push", None, unit="N m")),
        (ls.gap.Output("encoder", "angle", "angle_rad", unit="rad"),),
        (ls.gap.Port("shaft", "push", "angle", "speed", unit="N m"),), window_s=0.5,
    )  # fmt: skip


FAST_SERVO = numba.njit(nogil=True)(servo)


def servo_recording(k, gains, *, payload=0.0, rate_hz=250.0, seconds=6.0, **info):
    """The servo under a wandering target, its gain one of `gains` in equal parts of the time (scipy, LSODA)."""
    n, rng = round(seconds * rate_hz), np.random.default_rng(k)
    t = np.arange(n) / rate_hz
    target = sum(
        a * np.sin(2 * np.pi * f * t + q)
        for a, f, q in zip((0.5, 0.3, 0.2), (0.3, 1.1, 2.3), rng.uniform(0, 6, 3), strict=True)
    )
    kp = np.asarray(gains, dtype=float)[np.minimum(np.arange(n) * len(gains) // n, len(gains) - 1)]

    def slope(time, x):
        i = min(int(time * rate_hz), n - 1)
        return [x[1], (kp[i] * (target[i] - x[0]) - 0.1 * x[1]) / (0.02 + payload)]

    x = solve_ivp(slope, (0.0, t[-1]), [0.0, 0.0], "RK45", t_eval=t, rtol=1e-6, atol=1e-8, max_step=1.0 / rate_hz).y
    read = x[0] + 1e-4 * rng.standard_normal(n)
    told = RecordingInfo(f"s{k}.parquet", "profile", "reference", **info)
    return ls.Recording(told, rate_hz, {"target_rad": target, "kp_nm_per_rad": kp, "angle_rad": read})


def servo_run(*recordings):
    return ls.Run(recordings[0].rate_hz, (), recordings)


def places(plant):
    return {e.effect.split("@")[1] for e in plant.effects}


def test_a_gain_that_schedules_has_no_sign_and_no_actuator():
    run = servo_run(*(servo_recording(k, (2.0, 6.0, 3.0)) for k in (1, 2)))
    plant, _, _ = checked(run, servo_model(schedules=True))
    assert "kp" not in places(plant)
    assert {"target", "shaft", "encoder"} <= places(plant)
    assert "kp" not in plant.shapes([plant.prepare(run.recordings[0], run, None)]).axes
    acts, _, _ = checked(run, servo_model())
    assert "kp" in places(acts)


def test_a_column_that_never_changes_within_a_recording_schedules_by_itself():
    run = servo_run(*(servo_recording(k, (gain,)) for k, gain in ((1, 2.0), (2, 6.0))))
    plant, _, _ = checked(run, servo_model())
    assert "kp" not in places(plant)


def test_a_larger_repetition_leaves_what_schedules_as_it_is():
    run = servo_run(servo_recording(1, (2.0, 6.0)))
    plant = OwnMachine(servo_model(schedules=True))
    again = plant.repeated(plant.prepare(run.recordings[0], run, None), {}, 2.0)
    assert set(np.unique(again.u[:, 1])) <= {2.0, 6.0}
    assert np.abs(again.u[:, 0]).max() > 1.5 * 0.5


def test_a_force_does_not_act_at_an_input_that_schedules():
    with pytest.raises(ls.errors.WrongUseError, match="input of port bearing; received drum schedules"):
        replace(FAST, inputs=(ls.gap.Input("drum", "torque_nm", schedules=True),))
    with pytest.raises(ls.errors.WrongUseError, match="schedules, so its values are recorded"):
        ls.gap.Input("kp", schedules=True)


def test_constants_of_a_recording_are_parameters_of_the_model_there():
    plain, loaded = servo_recording(1, (4.0,)), servo_recording(2, (4.0,), payload=0.03, parameters={"payload": 0.03})
    run = servo_run(plain, loaded)
    plant = OwnMachine(servo_model())
    left = [
        np.sqrt(np.mean(plant.paths(plant.prepare(r, run, None), {})["inputs -> encoder"] ** 2)) for r in run.recordings
    ]
    assert max(left) < 1.5
    unsaid = replace(loaded, info=replace(loaded.info, parameters={}))
    assert np.sqrt(np.mean(plant.paths(plant.prepare(unsaid, run, None), {})["inputs -> encoder"] ** 2)) > 10.0


def test_a_tolerance_moves_a_constant_by_its_share():
    c = OwnMachine(servo_model()).composed
    assert c.values({"inertia": 0.022}, {"inertia": 0.05}).inertia == pytest.approx(0.055)
    assert c.values({"change.inertia": 0.001}, {"inertia": 0.05}).inertia == pytest.approx(0.051)
    assert c.values({"inertia": 0.022}).inertia == 0.022


def test_a_constant_that_is_no_parameter_is_refused():
    run = servo_run(servo_recording(1, (4.0,)), servo_recording(2, (4.0,), role="validation", parameters={"load": 1.0}))
    with pytest.raises(ls.errors.WrongUseError, match=r"parameters of s2\.parquet are the model's; received 'load'"):
        checked(run, servo_model())


def test_recordings_of_several_rates_are_followed_each_at_its_own():
    run = servo_run(*(servo_recording(k, (4.0,), rate_hz=rate) for k, rate in ((1, 250.0), (2, 100.0), (3, 1000.0))))
    plant, run, names = checked(run, servo_model())
    for name in names:
        r = run.recording(name)
        off = plant.paths(plant.prepare(r, run, None), {})["inputs -> encoder"]
        assert np.sqrt(np.mean(off**2)) < 2.0, name


@dataclass
class Answer:
    """Of a diagnosis what a note needs."""

    notes: list = field(default_factory=list)
    fix: None = None


MODEL_TOML = """
format = "loopshape-model/1"
file = "lever.py"
function = "motion"
states = ["angle", "speed"]
parameter = [{ name = "inertia", value = 0.02 }]
input = [{ name = "drum", column = "torque_nm" }, { name = "kp", column = "kp_1", schedules = true }]
output = [{ name = "encoder", state = "angle", column = "lever_rad", offset = 1.5 }]
"""


def model_folder(folder):
    (folder / "model.toml").write_text(MODEL_TOML)
    (folder / "lever.py").write_text("def motion(t, x, u, p):\n    return x[1], u[0] / p.inertia\n")
    return folder / "model.toml"


def test_a_model_file_that_is_touched_meanwhile_does_not_lose_the_answer(tmp_path, monkeypatch):
    model, run = model_folder(tmp_path), servo_run(servo_recording(1, (4.0,)))

    def touched(*_, **__):
        (tmp_path / "lever.py").write_text("broken(")
        os.utime(model, ns=(1, 1))
        return Answer(["as before"])

    monkeypatch.setattr("loopshape.toolbox.gap.diagnose.diagnose.diagnose", touched)
    with noting():
        found = ls.gap(run, model=model)
        write_json(tmp_path / "answer.json", found.notes)
    assert found.notes[0] == "as before"
    assert found.notes[1].startswith(
        "model.toml, lever.py changed meanwhile: the answer is of the model as it was read"
    )


def test_a_recording_that_changes_meanwhile_still_loses_the_answer(tmp_path, monkeypatch):
    (tmp_path / "run").mkdir()
    ls.write(servo_run(servo_recording(1, (4.0,))), tmp_path / "run")

    def touched(*_, **__):
        os.utime(tmp_path / "run" / "run.toml", ns=(1, 1))
        return Answer()

    monkeypatch.setattr("loopshape.toolbox.gap.diagnose.diagnose.diagnose", touched)
    with noting():
        ls.gap(ls.read(tmp_path / "run"), model=servo_model())
        with pytest.raises(ls.LoopshapeError, match="changed by another process"):
            write_json(tmp_path / "answer.json", {})


def test_model_toml_says_what_schedules_and_where_a_zero_is(tmp_path):
    from loopshape.toolbox.gap.own.file import read_model

    own = read_model(model_folder(tmp_path))
    assert [i.schedules for i in own.inputs] == [False, True]
    assert own.outputs[0].offset == 1.5


@pytest.mark.long
def test_a_zero_that_is_a_quarter_turn_off_is_named_and_offset_cures_it():
    wrong = spoiled(swing(), ["angle_rad"], shift=-0.5 * np.pi)
    with pytest.raises(
        ls.errors.WrongUseError, match=r"angle_rad: its zero is off by 0\.25 of a turn.*write offset = 1\.5708"
    ):
        checked(wrong, PENDULUM)
    cured = replace(PENDULUM, outputs=(replace(PENDULUM.outputs[0], offset=0.5 * np.pi),))
    checked(wrong, cured)


def pendulum(t, x, u, p):
    """A pendulum under a torque: it hangs at 0."""
    return x[1], (u[0] - p.damping * x[1] - p.weight * np.sin(x[0])) / p.inertia


PENDULUM = ls.gap.Model(
    "pendulum", numba.njit(nogil=True)(pendulum), ("angle", "speed"),
    (ls.gap.ModelParameter("inertia", 0.02, "kg m2", 0.03, "none"),
     ls.gap.ModelParameter("damping", 0.01, "N m s/rad", 0.1),
     ls.gap.ModelParameter("weight", 1.0, "N m", 0.03, "none")),
    (ls.gap.Input("motor", "torque_nm", unit="N m"),), (ls.gap.Output("encoder", "angle", "angle_rad", unit="rad"),),
    (ls.gap.Port("pivot", "motor", "angle", "speed", unit="N m"),), window_s=0.4,
)  # fmt: skip


@cache
def swing(size=1.4):
    """A pendulum that a torque turns all the way round, and back (scipy)."""
    rate_hz, t = 250.0, np.arange(2000) / 250.0

    def recording(k):
        torque = size * np.sin(2 * np.pi * (0.31 + 0.05 * k) * t + k)

        def slope(time, x):
            return [x[1], (np.interp(time, t, torque) - 0.01 * x[1] - np.sin(x[0])) / 0.02]

        x = solve_ivp(slope, (0.0, t[-1]), [0.1, 0.0], t_eval=t, rtol=1e-6, atol=1e-8, max_step=4e-3).y[0]
        read = x + 1e-4 * np.random.default_rng(k).standard_normal(t.size)
        info = RecordingInfo(f"p{k}.parquet", "profile", "control", closed_loop=False)
        return ls.Recording(info, rate_hz, {"torque_nm": torque, "angle_rad": read})

    return servo_run(recording(1), recording(2))


HARD, SOFT = {"port.bearing.stiffness": 0.1, "port.bearing.hardening": 2.0}, {"port.bearing.stiffness": 0.1}


def proposed(*recordings):
    """What to record next to tell two springs apart that part with the cube of the angle: the larger the better."""
    run = servo_run(*recordings)
    return repeat(OwnMachine(FAST), run, run.recordings, ("hard", HARD), ("soft", SOFT)), run


def test_a_proposal_stays_within_commands_and_outputs_that_were_seen():
    found, _ = proposed(winch().recordings[0])
    assert "times as large" not in found.sentence or "0.7" in found.sentence or "0.4" in found.sentence


def test_a_small_recording_is_proposed_larger_up_to_what_was_seen():
    large = winch().recordings[0]
    small = spoiled(servo_run(large), ["torque_nm", "lever_rad"], 0.5).recordings[0]
    small = replace(small, info=replace(small.info, file="small.parquet"))
    found, run = proposed(small, replace(large, info=replace(large.info, file="large.parquet")))
    plant = OwnMachine(FAST)
    f = {r.info.name: plant.prepare(r, run, None) for r in run.recordings}
    fits = {s: plant.within(plant.repeated(f["small"], HARD, s), list(f.values())) for s in SHARES}
    assert fits[1.4]
    assert not plant.within(plant.repeated(f["large"], HARD, 1.4), list(f.values()))
    assert "within the commands and outputs seen" in found.sentence or found.name == "large"


def test_an_axis_whose_positions_lie_off_zero_is_not_asked_to_go_there():
    r = winch().recordings[0]
    off = ls.Recording(
        r.info, r.rate_hz, {"torque_nm": r.column("torque_nm"), "lever_rad": r.column("lever_rad") + 5.0}
    )
    plant, run = OwnMachine(FAST), servo_run(off)
    f = plant.prepare(off, run, None)
    assert not plant.within(plant.repeated(f, {}, 0.4), [f])


def test_a_pendulum_that_turns_all_the_way_is_not_at_one_operating_point():
    notes, _ = suitable(OwnMachine(PENDULUM), swing())
    assert np.ptp(swing().recordings[0].column("angle_rad")) > 2.0 * np.pi
    assert not any("one operating point" in note for note in notes)


def test_a_pendulum_that_hardly_moves_is_at_one_operating_point_and_its_range_is_told():
    notes, _ = suitable(OwnMachine(PENDULUM), swing(0.05))
    (note,) = [note for note in notes if "one operating point" in note]
    low, high = (f([f(r.column("angle_rad")) for r in swing(0.05).recordings]) for f in (min, max))
    assert f"angle_rad from {low:.3g} to {high:.3g}" in note


def test_a_carriage_that_goes_along_its_axis_is_not_at_one_operating_point():
    t = np.arange(4000) / 250.0
    x = 0.125 * (1.0 - np.cos(2 * np.pi * t / 8.0))
    info = RecordingInfo("x.parquet", "profile", "reference")
    axis = replace(PENDULUM, outputs=(ls.gap.Output("encoder", "angle", "x_m", unit="m"),))
    notes, _ = suitable(OwnMachine(axis), servo_run(ls.Recording(info, 250.0, {"torque_nm": x, "x_m": x})))
    assert not any("one operating point" in note for note in notes)


def test_the_place_of_something_unknown_is_that_of_the_ceiling_held_out():
    steps = (
        BudgetStep(BudgetPart.BEFORE, (), 9.0, None, None),
        BudgetStep(BudgetPart.CEILING, ("pivot",), 2.0, 0.9, None),
    )
    found = Attribution(None, None, {}, {}, {"unknown": 1.0}, None, steps)
    assert found.nearest == "pivot"
    assert replace(found, budget=steps[:1]).nearest == "unknown"


@pytest.mark.long
def test_a_healthy_servo_with_a_gain_a_payload_and_two_rates_has_no_gap():
    told = {"payload": 0.02, "parameters": {"payload": 0.02}}
    run = servo_run(
        servo_recording(1, (2.0,)), servo_recording(2, (6.0,), rate_hz=125.0, **told),
        servo_recording(3, (4.0,), role="validation"),
    )  # fmt: skip
    found = ls.gap(run, model=servo_model(), table=False)
    assert found.verdict == "none"
    assert not any("@kp" in r.effect for r in found.ranking)


def test_magnitudes_have_units_of_the_port_and_of_its_position():
    plant, _, _ = checked(winch())
    units = {e.effect: e.unit for e in plant.effects}
    assert units["viscous_error@bearing"] == "N m s/rad"
    assert units["cable_stiffness@bearing"] == "N m/rad"
    assert units["coulomb_friction@bearing"] == "N m"


def topple(t, x, u, p):
    """An unstable balance with a hardening spring that runs away within a window when it is pushed."""
    return x[1], 30.0 * x[0] + 5.0 * x[0] ** 3 + p.gain * u[0] * (1.0 + 1e3 * abs(x[0]))


@pytest.mark.long
def test_a_push_under_which_a_window_runs_away_tells_no_size():
    balance = replace(
        PENDULUM,
        motion=numba.njit(nogil=True)(topple),
        parameters=(ls.gap.ModelParameter("gain", 1.0, "1", 0.1, "none"),),
    )
    t = np.arange(1500) / 250.0
    columns = {"torque_nm": 1e-3 * np.sin(9.0 * t), "angle_rad": 1e-3 * np.sin(9.0 * t + 3.0)}
    run = servo_run(ls.Recording(RecordingInfo("b.parquet", "profile", "control"), 250.0, columns))
    plant = OwnMachine(balance)
    scale = plant._port("pivot", [plant.prepare(run.recordings[0], run, None)], 1e-3)
    assert 1e-4 < scale.force < 10.0
