"""A file without a map: its draft says what was guessed, is taken on demand alone, and the run repeats it."""

import json
import tomllib

import numpy as np
import pytest
from scipy.io import savemat

import loopshape as ls
from loopshape.toolbox.formats.commands.import_file import import_file as command
from loopshape.toolbox.formats.drafts.draft_map import draft_map, write_draft
from loopshape.toolbox.formats.tables.import_file import import_file

RATE, N = 500.0, 6000


def loop_signals(injection="controller_input", gain=5.0, noise=0.01):
    """n, z, y of a plant 0.02 q^-1/(1 - 0.9 q^-1) under z = gain (n - y) (or -gain y, n behind it), with noise on y."""
    r = np.random.default_rng(1)
    n, e = r.standard_normal(N), noise * r.standard_normal(N)
    z, y, state = np.zeros(N), np.zeros(N), 0.0
    for k in range(N):
        y[k] = state + e[k]
        z[k] = gain * ((n[k] if injection == "controller_input" else 0.0) - y[k])
        u = z[k] + (n[k] if injection == "plant_input" else 0.0)
        state = 0.9 * state + 0.02 * u
    return n, z, y


def written(path, names, columns, separator=",", decimal=".", above="", units=None, encoding="utf-8"):
    head = above + separator.join(names) + "\n" + (separator.join(units) + "\n" if units else "")
    rows = "\n".join(
        separator.join(f"{v:.9g}".replace(".", decimal) for v in row) for row in zip(*columns, strict=True)
    )
    path.write_bytes((head + rows + "\n").encode(encoding))
    return path


def accepted(file, tmp_path):
    draft = draft_map(file)
    write_draft(tmp_path / "m.toml", draft, file)
    return draft, import_file(file, tmp_path / "m.toml", accept_draft=True)


def test_a_draft_finds_rate_layout_units_parts_and_injection(tmp_path):
    n, z, y = loop_signals()
    t = 1e3 * np.arange(N) / RATE
    file = written(
        tmp_path / "scope.csv", ["Zeit [ms]", "Anregung [mm]", "Stellgröße [V]", "Istwert [mm]"], [t, n, z, y],
        ";", ",", "Messung 7\nPrüfer: A. B.\n\n", encoding="cp1252",
    )  # fmt: skip
    draft, run = accepted(file, tmp_path)
    (loop,), (recording,) = run.loops, run.recordings
    assert run.rate_hz == RATE
    assert (loop.injected, loop.control, loop.output) == ("anregung_m", "stellgroesse_v", "istwert_m")
    assert (recording.info.injection, recording.info.closed_loop) == ("controller_input", True)
    np.testing.assert_allclose(recording.column("istwert_m"), 1e-3 * y, atol=1e-9)
    assert all(sentence.endswith(".") for sentence in draft.guesses)


@pytest.mark.parametrize("injection", ["controller_input", "plant_input"])
def test_without_names_data_tell_the_parts(injection, tmp_path):
    n, z, y = loop_signals(injection)
    t = np.arange(N) / RATE
    names = ["time", "injected", "s1", "s2"] if injection == "controller_input" else ["time", "injected", "ctrl", "pos"]
    _, run = accepted(written(tmp_path / "a.csv", names, [t, n, z, y]), tmp_path)
    (loop,), (recording,) = run.loops, run.recordings
    assert (loop.control, loop.output) == (f"{names[2]}_1", f"{names[3]}_1")
    assert recording.info.injection == injection


def test_the_plant_comes_out_of_a_run_that_a_draft_made(tmp_path):
    n, z, y = loop_signals()
    _, run = accepted(
        written(tmp_path / "a.csv", ["t_s", "chirp", "u_V", "y_m"], [np.arange(N) / RATE, n, z, y]), tmp_path
    )
    P = ls.frf(run)
    q = np.exp(-2j * np.pi * P.frequency_hz / RATE)
    apart = np.abs(P.siso - 0.02 * q / (1.0 - 0.9 * q)) / np.sqrt(P.variance[:, 0, 0])
    assert np.mean(apart < 3.0) > 0.95  # |d|²/var is exponential: 3 sigma is passed by 1 in 8000


def test_a_draft_is_taken_on_demand_alone_and_the_run_says_so(tmp_path):
    n, z, y = loop_signals()
    file = written(tmp_path / "a.csv", ["t_s", "inj", "u_V", "y_m"], [np.arange(N) / RATE, n, z, y])
    draft = draft_map(file)
    write_draft(tmp_path / "m.toml", draft, file)
    with pytest.raises(ls.errors.WrongUseError, match=r"has not been confirmed.*--accept"):
        import_file(file, tmp_path / "m.toml")
    run = import_file(file, tmp_path / "m.toml", accept_draft=True)
    (told,) = [note for note in run.extra["notes"] if "draft map that was not confirmed" in note]
    assert told.split("confirmed: ")[1] == " ".join(draft.guesses)
    with pytest.raises(
        ls.errors.WrongUseError, match=r"is there already; import with it \(--map .*m\.toml --out RUN\)"
    ):
        write_draft(tmp_path / "m.toml", draft, file)


def test_what_is_open_cannot_be_accepted(tmp_path):
    n, z, y = loop_signals()
    file = written(tmp_path / "a.csv", ["inj", "u_V", "y_m"], [n, z, y])
    draft = draft_map(file)
    assert len(draft.open) == 1
    assert "rate_hz" in draft.open[0]
    write_draft(tmp_path / "m.toml", draft, file)
    with pytest.raises(ls.errors.WrongUseError, match=r"questions open.*write rate_hz; answer"):
        import_file(file, tmp_path / "m.toml", accept_draft=True)
    assert draft_map(file, RATE).open == ()


def test_a_closed_loop_without_its_excitation_is_an_open_question(tmp_path):
    _, z, y = loop_signals(gain=20.0, noise=0.5)  # without noise on y its past adds nothing to that of z
    file = written(tmp_path / "a.csv", ["t_s", "u_V", "y_m"], [np.arange(N) / RATE, z, y])
    (question,) = draft_map(file).open
    assert "a loop was closed" in question
    assert "record it too" in question


def test_an_open_loop_and_a_period_are_seen(tmp_path):
    u = np.tile(np.random.default_rng(2).standard_normal(1000), 6)
    y = np.convolve(u, [0.0, 0.5, 0.25])[:N] + 0.001 * np.random.default_rng(3).standard_normal(N)
    file = written(tmp_path / "a.csv", ["t_s", "u_V", "y_m"], [np.arange(N) / RATE, u, y])
    _, run = accepted(file, tmp_path)
    info = run.recordings[0].info
    assert (info.closed_loop, info.injection, info.kind) == (False, "control", "multisine")
    assert (info.period_s, info.periodic_from_s) == (1000 / RATE, 0.0)


@pytest.mark.long
def test_stamps_of_every_kind_give_the_rate(tmp_path):
    n, z, y = loop_signals()
    k = np.arange(N)
    stamps = {
        "iso": [f"2024-03-05T10:{10 + int(s) // 60:02d}:{s % 60:09.6f}" for s in k / RATE],
        "german": [f"05.03.2024 10:{10 + int(s) // 60:02d}:{s % 60:06.3f}" for s in k / RATE],
        "epoch ms": [f"{1709632800000 + round(1e3 * s)}" for s in k / RATE],
        "us": [f"{round(1e6 * s)}" for s in k / RATE],
        "MATLAB's durations": [f"{s:.6g} sec" for s in k / RATE],
    }
    for name, column in stamps.items():
        rows = "\n".join(f"{s},{a:.6g},{b:.6g},{c:.6g}" for s, a, b, c in zip(column, n, z, y, strict=True))
        (tmp_path / "a.csv").write_text("timestamp,inj,u_V,y_m\n" + rows + "\n")
        (tmp_path / "m.toml").unlink(missing_ok=True)
        _, run = accepted(tmp_path / "a.csv", tmp_path)
        assert run.rate_hz == RATE, name
    (tmp_path / "b.csv").write_text("t,y\n2024-03-05,1\n")
    with pytest.raises(ls.LoopshapeError, match="no signals"):
        draft_map(tmp_path / "b.csv")


def test_units_below_the_header_and_lines_above_it(tmp_path):
    n, z, y = loop_signals()
    file = written(
        tmp_path / "a.txt", ["exc", "drive", "position"], [n, z, y], "\t", ".", "Scope v3\nSampling rate: 0.5 kHz\n",
        ["[mm]", "[V]", "[mm]"],
    )  # fmt: skip
    _, run = accepted(file, tmp_path)
    assert run.rate_hz == RATE
    assert set(run.recordings[0].columns) == {"t_s", "exc_m", "drive_v", "position_m"}


def test_a_mat_file_with_a_rate_of_its_own(tmp_path):
    n, z, y = loop_signals()
    savemat(tmp_path / "a.mat", {"dither": n, "u": z[:, None], "pos_meas": y, "fs": RATE, "gain": 3.0})
    draft, run = accepted(tmp_path / "a.mat", tmp_path)
    assert run.rate_hz == RATE
    assert draft.roles == {"dither": "injected", "u": "control", "pos_meas": "output"}


def test_a_file_that_holds_nothing_is_refused_with_a_cure(tmp_path):
    for text, word in (("", "empty"), ("t,u,y\n", "no rows"), ("one\ntwo\nthree\n", "a row of numbers a sample")):
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(ls.LoopshapeError, match=word):
            draft_map(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0")
    with pytest.raises(ls.LoopshapeError, match="no file of text"):
        draft_map(tmp_path / "a.csv")


def test_the_command_writes_draft_picture_and_run(tmp_path, capsys):
    n, z, y = loop_signals()
    file = written(tmp_path / "a.csv", ["t_s", "inj", "u_V", "y_m"], [np.arange(N) / RATE, n, z, y])
    command(file, None, None, False, tmp_path / "d.toml", None, False, True, False)
    told = json.loads(capsys.readouterr().out)
    assert told["open"] == []
    assert (tmp_path / "d.png").read_bytes()[:4] == b"\x89PNG"
    assert tomllib.loads((tmp_path / "d.toml").read_text())["draft"]["guesses"] == told["guesses"]
    command(file, tmp_path / "d.toml", tmp_path / "run", True, None, None, False, False, True)
    assert ls.read(tmp_path / "run").rate_hz == RATE
    with pytest.raises(ls.errors.WrongUseError, match="--out FOLDER"):
        command(file, None, None, True, None, None, False, False, False)


def test_a_draft_that_was_read_and_corrected_is_the_one_that_is_accepted(tmp_path):
    n, z, y = loop_signals()
    file, draft = written(tmp_path / "a.csv", ["t_s", "inj", "u_V", "y_m"], [np.arange(N) / RATE, n, z, y]), "d.toml"
    command(file, None, None, False, tmp_path / draft, None, False, False, True)
    text = (tmp_path / draft).read_text()
    (tmp_path / draft).write_text(text.replace('name = "a"', 'name = "first"'))
    command(file, None, tmp_path / "run", True, tmp_path / draft, None, False, False, True)
    assert [r.info.name for r in ls.read(tmp_path / "run").recordings] == ["first"]


def test_reference_and_error_without_an_output_make_one(tmp_path):
    """A servo pack logs command, following error and torque: the output is the difference."""
    n, _, y = loop_signals()
    file = written(
        tmp_path / "pack.csv", ["time_ms", "PosCmd", "PosErr", "TrqCmd"], [2.0 * np.arange(N), n, n - y, 5 * (n - y)]
    )
    draft, run = accepted(file, tmp_path)
    np.testing.assert_allclose(run.recordings[0].column(run.loops[0].output), y, atol=1e-7)
    assert (run.loops[0].control, run.recordings[0].info.injection) == ("trqcmd_1", "reference")
    assert any("reference less error" in guess for guess in draft.guesses)


@pytest.mark.parametrize(
    "names",
    [
        ("yref", "ymeas", "ucmd"),
        ("riferimento", "posizione", "comando"),
        ("consigne (mm)", "mesure (mm)", "commande (V)"),
    ],
)
def test_names_of_other_languages_and_with_a_signal_s_letter(tmp_path, names):
    n, z, y = loop_signals()
    draft = draft_map(written(tmp_path / "a.csv", ["t_s", *names], [np.arange(N) / RATE, n, y, z]))
    assert [draft.roles.get(name) for name in names] == ["reference", "output", "control"]


def scope_text(head, columns, separator=",", lead="", tail=""):
    rows = (lead + separator.join(f"{v:.9g}" for v in row) + tail for row in zip(*columns, strict=True))
    return head + "\n".join(rows) + "\n"


def test_units_and_names_beside_words_above_the_rows(tmp_path):
    """Scopes write them in lines of the head, with the time's column or without it (Tektronix, Yokogawa)."""
    n, z, y = loop_signals()
    t = np.arange(N) / RATE
    (tmp_path / "a.csv").write_text(scope_text("Vertical Units,V,mm,V\n,,,\nTIME,inj,pos,u\n", [t, n, y, z]))
    draft = draft_map(tmp_path / "a.csv")
    assert [rule["unit"] for rule in draft.table["columns"].values()] == ["V", "mm", "V"]
    head = '"TraceName"  ,"inj","pos","u"\n"VUnit" ,"V","mm","V"\n"HResolution",0.002,0.002,0.002\n\n'
    (tmp_path / "b.csv").write_text(scope_text(head, [n, y, z], lead=","))
    draft = draft_map(tmp_path / "b.csv")
    assert draft.rate_hz == RATE
    assert draft.roles == {"inj": "injected", "pos": "output", "u": "control"}
    assert [rule["unit"] for rule in draft.table["columns"].values()] == ["V", "mm", "V"]


def test_an_increment_beside_the_names_is_the_period_and_a_counter_is_no_signal(tmp_path):
    n, z, y = loop_signals()
    head = "X,inj,u,y,Start,Increment,\nSequence,Volt,Volt,mm,-6.0e-01,2.0e-03,\n"
    (tmp_path / "a.csv").write_text(scope_text(head, [np.arange(N), n, z, y], tail=",,"))
    draft = draft_map(tmp_path / "a.csv")
    assert draft.rate_hz == RATE
    assert draft.roles == {"inj": "injected", "u": "control", "y": "output"}
    assert [rule["unit"] for rule in draft.table["columns"].values()] == ["V", "V", "mm"]


def test_a_period_whose_unit_has_a_cell_of_its_own(tmp_path):
    n, z, y = loop_signals()
    file = written(tmp_path / "a.csv", ["inj", "u", "y"], [n, z, y], above="Sampling Time,2000,us\n")
    assert draft_map(file).rate_hz == pytest.approx(RATE)


def test_channels_of_another_rate_are_brought_by_their_own_stamps_and_none_is_lost_in_silence(tmp_path):
    n, z, y = loop_signals()
    t = np.arange(N) / RATE
    every = {"time of u": t, "u": z, "time of inj": t, "inj": n, "time of pos": t[::2], "pos": y[::2], "extra": y[:77]}
    np.savez(tmp_path / "a.npz", **every)
    draft, run = accepted(tmp_path / "a.npz", tmp_path)
    assert draft.table["columns"]["pos_1"]["time"] == "time of pos"
    assert any("other rows: extra" in guess for guess in draft.guesses)
    assert any("brought" in note or "rate" in note for note in run.extra["notes"])
    np.testing.assert_allclose(run.recordings[0].column("pos_1")[::2], y[::2], atol=1e-9)


def test_a_step_of_another_quantity_is_no_rate(tmp_path):
    n, z, y = loop_signals()
    file = written(tmp_path / "a.csv", ["inj", "u", "y"], [n, z, y], above="Encoder increment: 0.001 mm\n")
    assert draft_map(file).rate_hz == 0.0


def test_a_row_of_types_between_names_and_units_is_neither(tmp_path):
    n, z, y = loop_signals()
    head = "time\texc\tdrive_u\tpos\nf8\tf8\tf8\tf8\ns\tdeg\tV\tdeg\n"
    (tmp_path / "a.asc").write_text(scope_text(head, [np.arange(N) / RATE, n, z, y], "\t"))
    draft, run = accepted(tmp_path / "a.asc", tmp_path)
    assert draft.roles == {"exc": "injected", "drive_u": "control", "pos": "output"}
    assert run.loops[0].output == "pos_rad"


def test_a_time_beside_each_channel(tmp_path):
    """TwinCAT's scope: words in odd columns, what they say in even ones."""
    n, z, y = loop_signals()
    words = {
        "Name": ("MAIN.fSetPos", "MAIN.fTorque", "MAIN.fActPos"),
        "SampleTime[ms]": "222",
        "Unit": ("mm", "%", "mm"),
    }
    head = "Name;Scope\n\n" + "".join(";".join(f"{key};{v}" for v in three) + "\n" for key, three in words.items())
    t = 2.0 * np.arange(N)
    (tmp_path / "a.csv").write_text(scope_text(head + "\n", [t, n, t, z, t, y], ";"))
    draft, run = accepted(tmp_path / "a.csv", tmp_path)
    assert draft.table["time"] == {"column": 1, "unit": "ms"}
    assert run.rate_hz == RATE
    assert draft.roles == {"MAIN.fSetPos": "reference", "MAIN.fTorque": "control", "MAIN.fActPos": "output"}
    np.testing.assert_allclose(run.recordings[0].column(run.loops[0].output), 1e-3 * y, atol=1e-9)


def test_a_column_of_text_among_numbers_is_left_out(tmp_path):
    n, z, y = loop_signals()
    triples = enumerate(zip(n, z, y, strict=True))
    rows = "\n".join(f"{k / RATE:.4f},base,{a:.6g},{b:.6g},{c:.6g}" for k, (a, b, c) in triples)
    (tmp_path / "a.csv").write_text("%time,frame,command,effort,position\n" + rows + "\n")
    draft, run = accepted(tmp_path / "a.csv", tmp_path)
    assert draft.roles == {"command": "reference", "effort": "control", "position": "output"}
    assert run.rate_hz == RATE


def test_names_by_the_standard_s_words_and_drives_units(tmp_path):
    n, z, y = loop_signals()
    for names in (
        ("Führungsgröße", "Stellgröße", "Regelgröße"),
        ("VL.CMD (rpm)", "IL.CMD (Arms)", "VL.FB (rpm)"),
        ("Position Reference", "Torque Reference [%]", "Position Feedback"),
        ("setpoint[0]", "axisSum[0]", "gyroADC[0]"),
    ):
        draft = draft_map(written(tmp_path / "a.csv", ["t_s", *names], [np.arange(N) / RATE, n, z, y]))
        assert [draft.roles[name] for name in names] == ["reference", "control", "output"]


@pytest.mark.parametrize(
    ("name", "unit", "stored"),
    [("torque_nm", "Nm", "torque_nm"), ("u_motor_nm", "Nm", "u_motor_nm"), ("gap_nm", "nm", "gap_m")],
)
def test_nm_behind_what_drives_is_newton_metres_and_else_nanometres(name, unit, stored, tmp_path):
    n, z, y = loop_signals()
    path = written(tmp_path / "a.csv", ["t", "n_rad", name, "y_rad"], [np.arange(N) / RATE, n, z, y])
    columns = draft_map(path).table["columns"]
    assert columns[stored] == {"from": name, "unit": unit}
