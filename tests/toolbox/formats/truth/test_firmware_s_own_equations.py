"""Rate controllers of flight firmware as blocks: against the firmware's own difference equations, sample by sample."""

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import loopshape as ls
from loopshape.toolbox.formats.commands.export import export_controller, firmware
from loopshape.toolbox.formats.controllers.controller_words import step
from loopshape.toolbox.formats.controllers.drives import controller_of_parameters, drive_parameters, drive_text
from loopshape.toolbox.formats.controllers.firmware import (
    controller_of,
    left_out,
    parameters_of,
    read_parameters,
    with_notches,
)

RATE_HZ = 1000.0
T = 1.0 / RATE_HZ
PX4 = {
    "MC_ROLLRATE_K": 1.2, "MC_ROLLRATE_P": 0.15, "MC_ROLLRATE_I": 0.2, "MC_ROLLRATE_D": 0.003, "IMU_DGYRO_CUTOFF": 30.0,
    "IMU_GYRO_CUTOFF": 80.0, "IMU_GYRO_NF0_FRQ": 140.0, "IMU_GYRO_NF0_BW": 25.0,
}  # fmt: skip
ARDUPILOT = {
    "ATC_RAT_PIT_P": 0.135, "ATC_RAT_PIT_I": 0.135, "ATC_RAT_PIT_D": 0.0036, "ATC_RAT_PIT_FLTE": 60.0,
    "ATC_RAT_PIT_FLTD": 20.0, "INS_GYRO_FILTER": 40.0,
}  # fmt: skip
BETAFLIGHT = {
    "p_yaw": 45.0, "i_yaw": 80.0, "d_yaw": 30.0, "gyro_lpf1_static_hz": 250.0, "dterm_lpf1_static_hz": 75.0,
    "dterm_lpf2_static_hz": 150.0, "dterm_lpf1_type": "PT1", "dterm_lpf2_type": "PT2", "gyro_lpf1_type": "PT3",
    "gyro_lpf2_static_hz": 180.0, "gyro_lpf2_type": "BIQUAD",
}  # fmt: skip
E = np.random.default_rng(7).standard_normal(400)


class Alpha:
    """y += a (x - y), a = T/(T + 1/(2 pi f)): AlphaFilter of PX4, LowPassFilter of ArduPilot, PT1 of Betaflight."""

    def __init__(self, f_hz):
        self.a, self.y = T / (T + 1.0 / (2.0 * np.pi * f_hz)), 0.0

    def __call__(self, x):
        self.y += self.a * (x - self.y)
        return self.y


class Biquad:
    """Direct form I."""

    def __init__(self, b, a):
        self.b, self.a, self.x, self.y = b, a, [0.0, 0.0], [0.0, 0.0]

    def __call__(self, x):
        y = (
            self.b[0] * x
            + self.b[1] * self.x[0]
            + self.b[2] * self.x[1]
            - self.a[0] * self.y[0]
            - self.a[1] * self.y[1]
        )
        self.x, self.y = [x, self.x[0]], [y, self.y[0]]
        return y


def two_pole(f_hz):
    """LowPassFilter2p of PX4 and ArduPilot."""
    ohm = np.tan(np.pi * f_hz * T)
    c = 1.0 + 2.0 * np.cos(np.pi / 4.0) * ohm + ohm**2
    b0 = ohm**2 / c
    return Biquad([b0, 2.0 * b0, b0], [2.0 * (ohm**2 - 1.0) / c, (1.0 - 2.0 * np.cos(np.pi / 4.0) * ohm + ohm**2) / c])


def notch(f_hz, width_hz):
    """NotchFilter of PX4."""
    alpha, beta = np.tan(np.pi * width_hz * T), -np.cos(2.0 * np.pi * f_hz * T)
    a0 = 1.0 / (1.0 + alpha)
    return Biquad([a0, 2.0 * beta * a0, a0], [2.0 * beta * a0, (1.0 - alpha) * a0])


def px4(e):
    """RateControl::update: the integral of before this sample; D on the slope of the filtered gyro."""
    gyro, low, slope = notch(140.0, 25.0), two_pole(80.0), Alpha(30.0)
    integral, before, out = 0.0, 0.0, []
    for value in e:
        x = low(gyro(value))
        d = slope((x - before) / T)
        before = x
        out.append(1.2 * (0.15 * x + 0.003 * d) + integral)
        integral += 1.2 * 0.2 * x * T
    return np.array(out)


def ardupilot(e):
    """AC_PID::update_all: filtered error, its slope filtered, the integral with this sample."""
    gyro, error, slope = two_pole(40.0), Alpha(60.0), Alpha(20.0)
    integral, before, out = 0.0, 0.0, []
    for value in e:
        x = error(gyro(value))
        d = slope((x - before) / T)
        before = x
        integral += 0.135 * x * T
        out.append(0.135 * x + integral + 0.0036 * d)
    return np.array(out)


def betaflight(e):
    """pid.c: D on the slope of the gyro behind two PT1; terms in their scales, error in deg/s, the sum over 1000."""
    three = [Alpha(1.961459177 * 250.0) for _ in range(3)]
    biquad, first, second = two_pole(180.0), Alpha(75.0), [Alpha(1.553773974 * 150.0) for _ in range(2)]
    integral, before, out = 0.0, 0.0, []
    for value in np.degrees(e):
        x = biquad(three[2](three[1](three[0](value))))
        filtered = second[1](second[0](first(x)))
        d, before = (filtered - before) / T, filtered
        integral += 0.244381 * 80.0 * x * T
        out.append((0.032029 * 45.0 * x + integral + 0.000529 * 30.0 * d) / 1000.0)
    return np.array(out)


@pytest.mark.parametrize(
    ("name", "axis", "parameters", "law"),
    [
        ("px4", "roll", PX4, px4),
        ("ardupilot", "pitch", ARDUPILOT, ardupilot),
        ("betaflight", "yaw", BETAFLIGHT, betaflight),
    ],
)
def test_blocks_answer_as_the_firmware_s_own_equations(name, axis, parameters, law):
    C = controller_of(parameters, name, axis, RATE_HZ)
    want = law(E)
    np.testing.assert_allclose(step(C, E), want, rtol=0.0, atol=1e-9 * np.abs(want).max())


@pytest.mark.parametrize(
    ("name", "axis", "parameters"),
    [
        ("px4", "roll", {k: v for k, v in PX4.items() if "IMU_GYRO" not in k and k != "MC_ROLLRATE_K"}),
        ("ardupilot", "pitch", {k: v for k, v in ARDUPILOT.items() if "FLTE" not in k and "INS" not in k}),
        (
            "betaflight",
            "yaw",
            {k: v for k, v in BETAFLIGHT.items() if k[0] in "pi" or k in ("d_yaw", "dterm_lpf1_static_hz")},
        ),
    ],
)
def test_parameters_come_back_as_they_went_in(name, axis, parameters):
    back = parameters_of(controller_of(parameters, name, axis, RATE_HZ), name)
    assert back == pytest.approx(parameters, rel=1e-7)


@pytest.mark.parametrize(
    "text",
    [
        "1\t1\tMC_ROLLRATE_P\t0.15\t9\n",
        "MC_ROLLRATE_P,0.15\n",
        "# x\nMC_ROLLRATE_P 0.15\n",
        "set MC_ROLLRATE_P = 0.15\n",
    ],
)
def test_parameter_files_of_ground_stations(text, tmp_path):
    (tmp_path / "a.params").write_text(text)
    assert read_parameters(tmp_path / "a.params") == {"MC_ROLLRATE_P": 0.15}


def test_the_command_makes_a_controller_file_and_export_writes_its_parameters_back(tmp_path):
    mine = {name: value for name, value in PX4.items() if name != "MC_ROLLRATE_K" and "_GYRO_" not in name}
    rows = [f"1\t1\t{name}\t{value}\t9" for name, value in mine.items()]
    (tmp_path / "a.params").write_text("\n".join(rows) + "\n")
    app = typer.Typer()
    app.command("firmware")(firmware)
    app.command("export-controller")(export_controller)
    words = ["--of", "px4", "--rate-hz", "1000", "--out", str(tmp_path / "c.toml")]
    done = CliRunner().invoke(app, ["firmware", str(tmp_path / "a.params"), *words])
    assert done.exit_code == 0, done.output
    for to, ending in (("px4", "params"), ("ardupilot", "param"), ("betaflight", "cli")):
        words = ["export-controller", str(tmp_path / "c.toml"), "--to", to, "--out", str(tmp_path / "out")]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, repr(done.exception)
        found = read_parameters(tmp_path / "out" / f"controller_roll.{ending}")
        assert len(found) == 4
    back = read_parameters(tmp_path / "out" / "controller_roll.params")
    assert back == pytest.approx({name: PX4[name] for name in back}, rel=1e-6)


@pytest.mark.parametrize("integral", [0.2, 0.9, 5.0, 30.0])
def test_much_integral_makes_the_zeros_complex_and_the_answers_stay_the_firmware_s(integral):
    law = {"MC_ROLLRATE_P": 0.15, "MC_ROLLRATE_I": integral, "MC_ROLLRATE_D": 0.003, "IMU_DGYRO_CUTOFF": 30.0}
    total, before, slope, want = 0.0, 0.0, Alpha(30.0), []
    for x in E:
        d, before = slope((x - before) / T), x
        want.append(0.15 * x + 0.003 * d + total)
        total += integral * x * T
    C = controller_of(law, "px4", "roll", RATE_HZ)
    assert ("section" in {block.kind for block in C.blocks}) == (integral > 2.0)  # zeros meet at about P^2/(4 D)
    np.testing.assert_allclose(step(C, E), want, rtol=0.0, atol=1e-9 * np.abs(want).max())
    assert parameters_of(C, "px4") == pytest.approx(law, rel=1e-6)


def test_a_filter_that_changes_in_flight_is_named():
    (said,) = left_out(BETAFLIGHT | {"dyn_notch_count": 3.0, "rpm_filter_harmonics": 0.0}, "betaflight", "yaw")
    assert "dyn_notch_count = 3" in said
    assert left_out(PX4, "px4", "roll") == ()
    assert len(left_out(ARDUPILOT | {"INS_HNTCH_ENABLE": 1.0}, "ardupilot", "pitch")) == 1


def test_what_is_no_rate_controller_is_refused(tmp_path):
    with pytest.raises(ls.errors.WrongUseError, match="MC_ROLLRATE_I is a number"):
        controller_of({"MC_ROLLRATE_P": 0.1}, "px4", "roll", RATE_HZ)
    with pytest.raises(ls.errors.WrongUseError, match="left half plane"):
        controller_of(PX4 | {"MC_ROLLRATE_I": 500.0, "MC_ROLLRATE_D": 0.0}, "px4", "roll", RATE_HZ)
    for word in ("BIQUAD", "PT9"):
        with pytest.raises(ls.errors.WrongUseError, match="PT1"):
            controller_of(BETAFLIGHT | {"dterm_lpf1_type": word}, "betaflight", "yaw", RATE_HZ)
    with pytest.raises(ls.errors.WrongUseError, match="roll, pitch, yaw"):
        controller_of(PX4, "px4", "x", RATE_HZ)
    with pytest.raises(ls.errors.WrongUseError, match="a gain, pi and one lead_lag"):
        parameters_of(controller_of(PX4, "px4", "roll", RATE_HZ), "px4")
    (tmp_path / "a.param").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ls.LoopshapeError):
        read_parameters(tmp_path / "a.param")


def test_an_integral_without_d_is_a_pi():
    """The yaw axis as PX4 and ArduPilot ship it: no D."""
    given = {"MC_YAWRATE_P": 0.2, "MC_YAWRATE_I": 0.1, "MC_YAWRATE_D": 0.0}
    C = controller_of(given, "px4", "yaw", RATE_HZ)
    assert [block.kind for block in C.blocks] == ["gain", "pi"]
    np.testing.assert_allclose(step(C, E), odrive(E, 0.2, 0.1), atol=1e-12)


ODRIVE = {"pos_gain": 20.0, "vel_gain": 0.16, "vel_integrator_gain": 0.32}
MOTOR = {"current_control_bandwidth": 1000.0, "phase_inductance": 2e-5, "phase_resistance": 0.01}


def odrive(e, p, i):
    """controller.cpp and motor.cpp: P on the error of this sample, the integral of before it, then integrated."""
    integral, out = 0.0, []
    for value in e:
        out.append(p * value + integral)
        integral += i * T * value
    return np.array(out)


@pytest.mark.parametrize(
    ("loop", "law"),
    [
        ("position", lambda e: 20.0 * e),
        ("velocity", lambda e: odrive(e / (2.0 * np.pi), 0.16, 0.32)),
        ("current", lambda e: odrive(e, 1000.0 * 2e-5, 1000.0 * 0.01)),
    ],
)
def test_loops_of_odrive_answer_as_its_own_equations(loop, law):
    C = controller_of_parameters(ODRIVE | MOTOR, "odrive", loop, RATE_HZ)
    want = law(E)
    np.testing.assert_allclose(step(C, E), want, rtol=0.0, atol=1e-9 * np.abs(want).max())


@pytest.mark.parametrize(
    ("of", "loop", "given"),
    [
        ("odrive", "position", {"pos_gain": 20.0}),
        ("odrive", "velocity", {"vel_gain": 0.16, "vel_integrator_gain": 0.32}),
        ("sercos", "velocity", {"S-0-0100": 0.4, "S-0-0101": 8.0}),
        ("sercos", "position", {"S-0-0104": 16.0}),
        ("sercos", "current", {"S-0-0106": 30.0, "S-0-0107": 0.0}),
    ],
)
def test_parameters_of_drives_come_back_as_they_went_in(of, loop, given, tmp_path):
    C = controller_of_parameters(given, of, loop, RATE_HZ)
    assert drive_parameters(C, of) == pytest.approx(given, rel=1e-9)
    (tmp_path / "a.txt").write_text(drive_text(C, of))
    again = controller_of_parameters(read_parameters(tmp_path / "a.txt"), of, loop, RATE_HZ)
    np.testing.assert_allclose(step(again, E), step(C, E), rtol=1e-9, atol=1e-12)


def test_a_sercos_velocity_loop_is_its_gain_and_reset_time():
    C = controller_of_parameters({"S-0-0100": 0.4, "S-0-0101": 8.0}, "sercos", "velocity", RATE_HZ)
    f = np.array([1.0, 10.0, 20.0])
    np.testing.assert_allclose(C.response(f), 0.4 * (1.0 + 1.0 / (0.008 * 2j * np.pi * f)), rtol=2e-3)


def test_a_backup_of_two_axes_is_asked_for_one(tmp_path):
    one = '{"axis0.controller.config.vel_gain": 0.16, \n"axis0.controller.config.vel_integrator_gain": 0.32}'
    (tmp_path / "a.json").write_text(one)
    given = read_parameters(tmp_path / "a.json")
    assert drive_parameters(controller_of_parameters(given, "odrive", "velocity", RATE_HZ), "odrive")["vel_gain"] > 0.0
    with pytest.raises(ls.errors.WrongUseError, match="of one axis"):
        controller_of_parameters(given | {"axis1.controller.config.vel_gain": 0.2}, "odrive", "velocity", RATE_HZ)
    with pytest.raises(ls.errors.WrongUseError, match="follow from the motor"):
        drive_parameters(controller_of_parameters(MOTOR, "odrive", "current", RATE_HZ), "odrive")
    with pytest.raises(ls.errors.WrongUseError, match="rate that the loop runs at"):
        controller_of_parameters({**MOTOR, "phase_resistance": 0.04}, "odrive", "current", RATE_HZ)
    with pytest.raises(ls.errors.WrongUseError, match="position, velocity, current"):
        controller_of_parameters(given, "odrive", "roll", RATE_HZ)


@pytest.mark.parametrize(("name", "parameters", "axis"), [("px4", PX4, "roll"), ("betaflight", BETAFLIGHT, "yaw")])
def test_a_bank_of_dynamic_notches_is_the_firmware_s_product(name, parameters, axis):
    bank = [(120.0, 20.0), (185.0, 4.0)] if name == "px4" else [(120.0, 3.0), (185.0, 5.0)]
    alone = controller_of(parameters, name, axis, RATE_HZ)
    C = with_notches(alone, [f"{f:g}:{x:g}" for f, x in bank], name)
    f_hz = np.array([1.0, 50.0, 118.0, 190.0, 420.0])
    z, expected = np.exp(2j * np.pi * f_hz / RATE_HZ), alone.response(f_hz)
    for f, x in bank:
        w = 2.0 * np.pi * f / RATE_HZ
        a = np.tan(np.pi * x / RATE_HZ) if name == "px4" else np.sin(w) / (2.0 * x)
        expected = expected * (1 - 2 * np.cos(w) / z + z**-2) / (1 + a - 2 * np.cos(w) / z + (1 - a) * z**-2)
    np.testing.assert_allclose(C.response(f_hz), expected, rtol=1e-9)


@pytest.mark.parametrize("word", ["120", "600:20", "120:0", "a:b", "120:-3"])
def test_a_notch_that_no_bank_holds_is_refused(word):
    with pytest.raises(ls.errors.WrongUseError, match="FREQUENCY:WIDTH in Hz, below half the rate"):
        with_notches(controller_of(PX4, "px4", "roll", RATE_HZ), [word], "px4")
