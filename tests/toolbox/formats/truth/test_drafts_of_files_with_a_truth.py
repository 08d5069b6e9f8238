"""Drafts of files in other programs' layouts, of loops simulated here: right, or asked; never wrong and accepted."""

import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import chirp, lfilter

from loopshape.toolbox.formats.drafts.draft_map import draft_map
from loopshape.toolbox.formats.drafts.draft_roles import find_roles

N = 6000
MODE = ((0.0, 0.002, 0.0019), (1.0, -1.93, 0.94))
LAG = ((0.0, 0.004), (1.0, -0.995))


def excitation(kind, rng):
    t = np.arange(N)
    if kind == "sweep":
        return chirp(t, 2e-4, N, 0.1, phi=-90)
    if kind == "multisine":
        phases = rng.uniform(0.0, 2.0 * np.pi, 40)
        one = sum(np.cos(2.0 * np.pi * k * t[:1000] / 1000 + p) for k, p in zip(range(1, 80, 2), phases, strict=True))
        return np.tile(one / 5.0, N // 1000)
    hold = {"noise": 1, "held noise": 10, "steps": 400, "prbs": 7}[kind]
    few = rng.choice([-1.0, 1.0], N // hold + 1) if kind == "prbs" else rng.standard_normal(N // hold + 1)
    return np.repeat(few, hold)[:N]


def loop(place, kind, plant=MODE, gain=1.0, noise=0.01, seed=1):
    """x, z, u, y of z = PI (r + n - y), u = z + n: x moves the place; `control` opens the loop, and then z = u = x."""
    rng = np.random.default_rng(seed)
    x, e, (b, a) = excitation(kind, rng), noise * rng.standard_normal(N), plant
    z, u, y, free, total = (*(np.zeros(N) for _ in range(4)), 0.0)
    for k in range(N):
        free[k] = sum(b[i] * u[k - i] - a[i] * free[k - i] for i in range(1, min(k + 1, len(b))))
        free[k] -= sum(a[i] * free[k - i] for i in range(len(b), min(k + 1, len(a))))
        y[k] = free[k] + e[k]
        error = (x[k] if place in ("reference", "controller_input") else 0.0) - y[k]
        total += 0.05 * gain * error
        z[k] = x[k] if place == "control" else gain * error + total
        u[k] = z[k] + (x[k] if place == "plant_input" else 0.0)
    return x, z, u, y


def text(path, head, columns, separator=",", decimal="."):
    rows = (separator.join(c if isinstance(c, str) else f"{c:.9g}".replace(".", decimal) for c in row)
            for row in zip(*columns, strict=True))  # fmt: skip
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def t(rate):
    return np.arange(N) / rate


FILES = {}


def file_of(rate, control, output, places):
    """Register a writer of a file with its truth: rate (None: nothing tells), columns, places that are right."""

    def keep(write):
        FILES[write.__name__] = (write, rate, control, output, places)
        return write

    return keep


@file_of(2000.0, "Channel A", "Channel B", ("control",))
def picoscope(folder):
    _, z, _, y = loop("control", "noise")
    head = "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n"
    return text(folder / "a.csv", head, [1e3 * t(2000.0), z, 1e3 * y])


@file_of(1e4, "2", "1", ("control",))
def keysight(folder):
    _, z, _, y = loop("control", "prbs")
    return text(folder / "a.csv", "x-axis,1,2\nsecond,Volt,Volt\n", [t(1e4) - 0.1, y, z])


@file_of(2000.0, "Current Command [A]", "Velocity [cnt/sec]", ("reference",))
def servo_recorder(folder):
    x, z, _, y = loop("reference", "noise")
    head = "Time;Velocity Command [cnt/sec];Velocity [cnt/sec];Current Command [A]\n"
    return text(folder / "a.csv", head, [t(2000.0), x, y, z], ";", ",")


@file_of(250.0, "/joint_states/j1/effort", "/joint_states/j1/position", ("reference",))
def plot_juggler(folder):
    x, z, _, y = loop("reference", "multisine")
    head = "__time,/cmd/position/data,/joint_states/j1/position,/joint_states/j1/effort\n"
    stamps = [f"{1.7e9 + s:.6f}" for s in t(250.0)]
    return text(folder / "a.csv", head, [stamps, x, y, z])


@file_of(1000.0, "Drive", "Sensor", ("control",))
def labview(folder):
    _, z, _, y = loop("control", "noise")
    head = (
        "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\nChannels\t2\t\nDelta_X\t0.001\t0.001\t\n"
        "***End_of_Header***\t\nX_Value\tDrive\tSensor\tComment\n"
    )
    return text(folder / "a.lvm", head, [t(1000.0), z, y], "\t")


@file_of(None, "q", "th", ("control",))
def counted_rows(folder):
    _, z, _, y = loop("control", "held noise", LAG)
    return text(folder / "a.dat", "t q th\n", [np.arange(N), z, y], " ")


@file_of(1.0, "q", "th", ("control",))
def heat_exchanger(folder):
    _, z, _, y = loop("control", "held noise", LAG)
    return text(folder / "a.csv", "time_s,q,th\n", [t(1.0), z, y])


@file_of(500.0, "u", "d", ("reference",))
def displacement_d_in_a_loop(folder):
    x, z, _, y = loop("reference", "held noise")
    return text(folder / "a.csv", "t_s,d,r,u\n", [t(500.0), y, x, z])


@file_of(500.0, "u", "d", ("control",))
def displacement_d_alone(folder):
    _, z, _, y = loop("control", "held noise")
    return text(folder / "a.csv", "t_s,d,u\n", [t(500.0), y, z])


@file_of(500.0, "u", "y", ("control",))
def injected_that_is_a_copy(folder):
    _, z, _, y = loop("control", "noise")
    return text(folder / "a.csv", "t_s,disturbance,u,y\n", [t(500.0), z, z, y])


@file_of(100.0, "thrust", "pose_z", ("control",))
def drone(folder):
    _, z, _, y = loop("control", "prbs")
    rng = np.random.default_rng(5)
    psd = np.abs(lfilter([1.0], [1.0, -0.9], rng.standard_normal(N)))
    return text(folder / "a.csv", "t_s,pose_x,psd_z,pose_z,thrust\n", [t(100.0), rng.standard_normal(N), psd, y, z])


@file_of(100.0, "torque", "uVal", ("control",))
def a_value_called_u(folder):
    _, z, _, y = loop("control", "noise")
    head = "t_s,uVal,torque,Propeller Mech. Efficiency\n"
    return text(folder / "a.csv", head, [t(100.0), y, z, np.abs(y)])


@file_of(1.0, "TIC101.OP", "TIC101.PV", ("reference",))
def historian(folder):
    x, z, _, y = loop("reference", "steps", LAG, 3.0)
    clock = [f"01.03.2024 {k // 3600:02d}:{k // 60 % 60:02d}:{k % 60:02d}" for k in range(N)]
    return text(folder / "a.csv", "Zeitstempel;TIC101.SP;TIC101.PV;TIC101.OP\n", [clock, x, y, z], ";")


@file_of(2259.0, "Mot 1 DAC(bits)", "Mot 1 Act Pos(cts)", ("reference",))
def motion_controller(folder):
    x, z, _, y = loop("reference", "sweep")
    head = "Time(msec)\tMot 1 Cmd Pos(cts)\tMot 1 Act Pos(cts)\tMot 1 DAC(bits)\n"
    return text(folder / "a.txt", head, [1e3 * t(2259.0), x, y, z], "\t")


@file_of(None, "controller.cmd_thrust", "stateEstimate.z", ("reference",))
def stamps_of_ten(folder):
    x, z, _, y = loop("reference", "steps")
    head = "timestamp,ctrltarget.z,stateEstimate.z,controller.cmd_thrust\n"
    return text(folder / "a.csv", head, [1000.0 + 10.0 * np.arange(N), x, y, z])


@file_of(100.0, "u", "y", ("control",))
def seventy_other_columns(folder):
    _, z, _, y = loop("control", "noise")
    names = [f"aux{k}" for k in range(70)]
    aux = np.random.default_rng(3).standard_normal((70, N))
    return text(folder / "a.csv", ",".join(["t_s", *names, "u", "y"]) + "\n", [t(100.0), *aux, z, y])


@file_of(200.0, "rec.u", "rec.y", ("controller_input", "reference"))
def many_constants_before_the_recording(folder):
    x, z, _, y = loop("controller_input", "noise")
    constants = {f"par{k}": np.array([1.0, 2.0, 3.0 + k]) for k in range(170)}
    savemat(folder / "a.mat", constants | {"rec": {"t": t(200.0), "exc": x, "u": z, "y": y}})
    return folder / "a.mat"


@file_of(500.0, "data_vm 2", "data_theta 3", ("reference",))
def signals_in_rows(folder):
    x, z, _, y = loop("reference", "noise")
    savemat(folder / "a.mat", {"data_theta": np.stack([t(500.0), x, y]), "data_vm": np.stack([t(500.0), z])})
    return folder / "a.mat"


@file_of(100.0, "speed", "voltage", ("control",))
def names_the_wrong_way_round(folder):
    _, z, _, y = loop("control", "noise")
    return text(folder / "a.csv", "t_s,speed,voltage\n", [t(100.0), z, y])


@file_of(100.0, "y", "u", ("control",))
def u_and_y_the_wrong_way_round(folder):
    _, z, _, y = loop("control", "noise")
    return text(folder / "a.csv", "t_s,u,y\n", [t(100.0), y, z])


@file_of(1000.0, "u_total", "y", ("controller_input", "reference"))
def control_logged_behind_the_sum(folder):
    x, _, u, y = loop("plant_input", "noise")
    return text(folder / "a.csv", "t_s,exc,u_total,y\n", [t(1000.0), x, u, y])


@file_of(1000.0, "u", "y", ("plant_input",))
def multisine_at_the_plant(folder):
    x, z, _, y = loop("plant_input", "multisine")
    return text(folder / "a.csv", "t_s,exc,u,y\n", [t(1000.0), x, z, y])


@file_of(1000.0, "u", "y", ("controller_input",))
def sweep_at_the_controller(folder):
    x, z, _, y = loop("controller_input", "sweep")
    return text(folder / "a.csv", "t_s,exc,u,y\n", [t(1000.0), x, z, y])


@file_of(1000.0, "u", "y", ("plant_input",))
def noise_at_the_plant(folder):
    x, z, _, y = loop("plant_input", "noise", noise=0.001)
    return text(folder / "a.csv", "t_s,exc,u,y\n", [t(1000.0), x, z, y])


@file_of(0.2, "Heater", "Temperature", ("control",))
def minutes(folder):
    _, z, _, y = loop("control", "steps", LAG, noise=0.002)
    return text(folder / "a.csv", "Time_min,Heater,Temperature\n", [t(12.0), z, y])


@file_of(None, "u", "y", ("control",))
def baud_is_no_rate(folder):
    _, z, _, y = loop("control", "noise")
    return text(folder / "a.csv", "Baud rate: 115200\nu,y\n", [z, y])


@file_of(2000.0, "u", "y", ("control",))
def samples_per_second(folder):
    _, z, _, y = loop("control", "noise")
    return text(folder / "a.csv", "Sample rate: 2 kS/s\nu,y\n", [z, y])


#: asked, because nothing in them tells: each says why in its name or its layout
ASKED = {
    "counted_rows", "drone", "a_value_called_u", "stamps_of_ten", "signals_in_rows", "u_and_y_the_wrong_way_round",
    "multisine_at_the_plant", "sweep_at_the_controller", "baud_is_no_rate",
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
def test_a_draft_is_right_or_asked(name, tmp_path):
    write, rate, control, output, places = FILES[name]
    draft = draft_map(write(tmp_path))
    by = {role: column for column, role in draft.roles.items()}
    if draft.open:
        assert name in ASKED
        return
    assert rate is not None
    assert draft.rate_hz == pytest.approx(rate, rel=1e-3)
    assert (by["control"], by["output"]) == (control, output)
    assert draft.table["recording"]["injection"] in places


@pytest.mark.long
def test_columns_that_are_left_out_or_passed_over_are_counted(tmp_path):
    said = " ".join(draft_map(seventy_other_columns(tmp_path)).guesses)
    assert "among 24 of 64 signals" in said
    assert "a draft holds 64 of the 72 signals that move" in said
    assert "(8 in all)" in said
    said = " ".join(draft_map(many_constants_before_the_recording(tmp_path)).guesses)
    assert "other rows" in said
    assert "(170 in all)" in said
    said = " ".join(draft_map(injected_that_is_a_copy(tmp_path)).guesses)
    assert "it equals 'u', row by row" in said


def test_a_stated_correlation_is_the_measured_one(tmp_path):
    x, z, _, y = loop("controller_input", "noise")
    roles = find_roles(["exc", "u", "y"], np.stack([x, z, y], axis=1))
    assert f"correlation {np.corrcoef(x, z)[0, 1]:.2f}, of what is new" in " ".join(roles.guesses)


WORDS = {
    "telling": {"z": ("u", "ctrl", "plantinput"), "y": ("y", "actual", "feedback"), "x": ("setpoint", "exc", "chirp")},
    "hinting": {"z": ("voltage", "z", "thrust"), "y": ("pos", "q", "level"), "x": ("cmd", "d", "profile")},
    "none": {"z": ("ch1", "a1"), "y": ("ch2", "a2"), "x": ("ch3", "a3")},
    "lying": {"z": ("pos", "speed"), "y": ("voltage", "d"), "x": ("temperature", "q")},
}
KINDS = ("noise", "held noise", "sweep", "multisine", "prbs", "steps")
RIGHT = {"reference": ("reference", "controller_input"), "controller_input": ("reference", "controller_input")}


@pytest.mark.long
def test_drafts_of_random_loops_with_telling_and_lying_names_are_right_or_asked():
    """100 loops: place, kind, plant, noise and kind of name drawn; at the controller's input and reference is one."""
    rng, right = np.random.default_rng(7), 0
    for seed in range(100):
        place = str(rng.choice(["reference", "controller_input", "plant_input", "control"]))
        plant, noise = (MODE, LAG)[rng.integers(2)], float(rng.choice([0.001, 0.01, 0.05]))
        x, z, _, y = loop(place, str(rng.choice(KINDS)), plant, 1.0 if plant is MODE else 3.0, noise, seed)
        signals = {"z": z, "y": y} | ({} if place == "control" else {"x": x})
        said = {part: str(rng.choice(WORDS[str(rng.choice([*WORDS]))][part])) for part in signals}
        if len({*said.values()}) < len(said):
            continue
        order = [str(part) for part in rng.permutation([*signals])]
        roles = find_roles([said[p] for p in order], np.stack([signals[p] for p in order], axis=1))
        by = {role.value: name for role, name in roles.by_role.items()}
        if roles.open or not {"control", "output"} <= set(by):
            continue
        right += 1
        assert (by["control"], by["output"]) == (said["z"], said["y"])
        assert roles.recording["injection"] in RIGHT.get(place, (place,))
        assert place == "control" or by.get("injected", by.get("reference")) == said["x"]
    assert right > 25
