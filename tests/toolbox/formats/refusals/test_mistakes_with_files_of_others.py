"""Twenty files that cannot be drafted or read as they are: each is refused, or asked, with what to do."""

import json

import numpy as np
import pytest
from run_files import CsvShape

import loopshape as ls
from loopshape.toolbox.formats.commands.import_file import import_file as command
from loopshape.toolbox.formats.drafts.draft_map import draft_map
from loopshape.toolbox.formats.frf.frf_exchange import add_frfs
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.sources import Place, open_source

N = 2000
T = np.arange(N) / 500.0
U = np.random.default_rng(0).standard_normal(N)
Y = np.convolve(U, [0.0, 0.5, 0.3])[:N] + 0.01 * np.random.default_rng(1).standard_normal(N)


def rows(first, last, stamps=T):
    return "".join(f"{stamps[k]:.10g},{U[k]:.6g},{Y[k]:.6g}\n" for k in range(first, last))


#: mistake -> text, and what the refusal or the question must say
FILES = {
    "nothing but stamps": ("t\n0\n0.1\n0.2\n", "no signal that moves"),
    "signals that rest": ("t_s,u,y\n" + "".join(f"{k},1,2\n" for k in range(50)), "no signal that moves"),
    "a spectrum by its name": ("freq,psd_x,psd_y\n" + rows(0, N), "import-frf"),
    "a spectrum by its unit": ("axis (Hz),a,b\n" + rows(0, N), "import-frf"),
    "a spectrum by its steps": ("k,a,b\n" + rows(0, 500, 1.01 ** np.arange(500)), "rises by a constant factor"),
    "a header again in the middle": ("t,u,y\n" + rows(0, 900) + "t,u,y\n" + rows(900, N), "several tables"),
    "an empty line in the middle": ("t,u,y\n" + rows(0, 900) + "\n" + rows(900, N), "several tables"),
    "stamps that count": ("t,u,y\n" + rows(0, N, np.arange(N)), "a count of rows"),
    "stamps that count, with a point": ("time,u,y\n" + "".join(f"{k}.0,{U[k]},{Y[k]}\n" for k in range(N)), "count"),
    "stamps of 5": ("t,u,y\n" + rows(0, N, 5.0 * np.arange(N)), "s, ms or us"),
    "a unit of time that is none": ("t (ticks),u,y\n" + rows(0, N), "'ticks'"),
    "a baud rate": ("Baud rate: 9600\nu,y\n" + "".join(f"{a},{b}\n" for a, b in zip(U, Y, strict=True)), "rate_hz"),
    "control and output of one column": (
        "t_s,u,y\n" + "".join(f"{t},{u},{u}\n" for t, u in zip(T, U, strict=True)), "same"
    ),
    "a name of a set point that answers": (
        "t_s,setpoint,u\n" + "".join(f"{t},{y},{u}\n" for t, u, y in zip(T, U, Y, strict=True)), "it answers 'u'"
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", FILES)
def test_a_file_that_does_not_tell_is_refused_or_asked(mistake, tmp_path):
    text, word = FILES[mistake]
    (tmp_path / "a.csv").write_text(text)
    try:
        said = " ".join(draft_map(tmp_path / "a.csv").open)
    except ls.LoopshapeError as error:
        said = str(error)
    assert word in said


def test_what_cannot_be_drafted_leaves_no_draft_behind(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.csv").write_text(FILES["nothing but stamps"][0])
    for _ in range(2):
        with pytest.raises(ls.LoopshapeError, match="no signal that moves"):
            command(tmp_path / "one.csv", quiet=True)
    assert [path.name for path in tmp_path.iterdir()] == ["one.csv"]


def test_accept_takes_no_draft_of_another_file_of_the_same_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder, order in (("a", "u,y"), ("b", "y,u")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "rec.csv").write_text(f"t_s,{order}\n" + rows(0, N))
    command(tmp_path / "a" / "rec.csv", quiet=True)
    with pytest.raises(ls.errors.WrongUseError, match=r"not the draft of this file.*remove it"):
        command(tmp_path / "b" / "rec.csv", out=tmp_path / "run", accept=True, quiet=True)
    command(tmp_path / "a" / "rec.csv", out=tmp_path / "run", accept=True, quiet=True)
    assert ls.read(tmp_path / "run").rate_hz == 500.0


def test_a_damaged_channel_of_1e300_is_drafted_without_an_exception(tmp_path):
    """Squares of 1e300 are infinite; a mutated TDMS file holds such numbers."""
    u = U.copy()
    u[50] = 1e300
    np.savez(tmp_path / "a.npz", t=T, u=u, y=Y, z=np.where(np.arange(N) == 7, np.inf, U))
    draft = draft_map(tmp_path / "a.npz")
    assert (draft.roles["u"], draft.roles["y"]) == ("control", "output")  # as they were made
    assert draft.rate_hz == pytest.approx(500.0)


def test_lists_of_different_lengths_are_called_so(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"u": [[1.0, 2.0], [3.0]], "t": [0.0, 1.0]}))
    with pytest.raises(ls.LoopshapeError, match=r"lists of different lengths.*1 to 2"):
        draft_map(tmp_path / "a.json")
    (tmp_path / "b.json").write_text(json.dumps({"t": T.tolist(), "u": U[:900].tolist(), "y": Y.tolist()}))
    assert any("u (900 of 2000)" in guess for guess in draft_map(tmp_path / "b.json").guesses)


def test_a_column_of_an_array_whose_signals_lie_in_rows_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.stack([T, U, Y]))
    source = open_source(tmp_path / "a.npz", CsvShape())
    np.testing.assert_array_equal(source.signal(Place("x", row=2)), U)
    with pytest.raises(ls.errors.WrongUseError, match=r"3 x 2000.*rows.*row = N"):
        source.signal(Place("x", column=1))


def test_a_draft_with_open_parts_names_its_only_loop_and_no_injection(tmp_path):
    (tmp_path / "a.csv").write_text("t_s,a,b,c\n" + "".join(f"{t},{v[0]},{v[1]},{v[2]}\n" for t, v in zip(
        T, np.random.default_rng(2).standard_normal((N, 3)), strict=True)))  # fmt: skip
    draft = draft_map(tmp_path / "a.csv")
    assert draft.open
    assert draft.table["recording"]["excites"] == "loop"
    assert "injection" not in draft.table["recording"]


def test_files_of_one_rig_make_columns_and_a_rate_of_one_run(tmp_path):
    runs = []
    for k, rate in ((1, 1000.109), (2, 999.948)):
        data = {f"exp{k}.X.t (s).Data": np.arange(N) / rate, f"exp{k}.X.u (V).Data": U, f"exp{k}.Y.enc1 (mm).Data": Y}
        np.savez(tmp_path / f"e{k}.npz", **data)
        runs.append(draft_map(tmp_path / f"e{k}.npz"))
    one, two = (draft.table for draft in runs)
    assert one["rate_hz"] == two["rate_hz"] == 1000.0
    assert [*one["columns"]] == [*two["columns"]]
    assert one["columns"]["y_enc1_m"]["unit"] == "mm"


def test_a_sum_of_two_units_says_the_gain_that_makes_one(tmp_path):
    (tmp_path / "a.csv").write_text("p,a,u\n" + rows(0, N))
    (tmp_path / "m.toml").write_text(
        'format = "loopshape-map/1"\nrate_hz = 500.0\n[columns]\np_m = { from = "p", unit = "m" }\n'
        'a_rad = { from = "a", unit = "rad" }\nu_v = { from = "u", unit = "V" }\n[[loop]]\nname = "x"\n'
        'control = "u_v"\noutput = "p_m + 0.4557 a_rad"\n[recording]\nkind = "noise"\ninjection = "control"\n'
        'excites = "x"\nclosed_loop = false\n'
    )
    with pytest.raises(ls.errors.WrongUseError, match=r'a_m = \{ from = ..., unit = "m", gain = 0.4557 \}'):
        import_file(tmp_path / "a.csv", tmp_path / "m.toml")


def test_names_of_many_outputs_make_a_loop_and_a_bad_one_leaves_no_folder(tmp_path):
    f = np.array([1.0, 2.0])
    outputs = tuple(f"K1_VIS_BS_OPLEV_NUMBER_{k}_1" for k in range(12))
    one = ls.FRF.from_arrays(f, np.ones((2, 12, 1), complex), relative_std=0.1, outputs=outputs, inputs=("u_1",))
    ls.write(one, tmp_path / "a.mat")
    found = ls.formats.read_frf(tmp_path / "a.mat", loop="")
    assert add_frfs(tmp_path / "run", [found])
    bad = ls.FRF.from_arrays(f, [1.0, 1j], relative_std=0.1, loop="a|b")
    with pytest.raises(ls.LoopshapeError, match="--loop"):
        add_frfs(tmp_path / "other", [bad])
    assert not (tmp_path / "other").exists()
    with pytest.raises(ls.LoopshapeError, match=r"FRFs alone.*gap --model take it.*ls.read needs recordings"):
        ls.read(tmp_path / "run")


def test_entities_are_refused_in_every_encoding(tmp_path):
    for code in ("utf-8", "utf-16"):
        text = f'<?xml version="1.0" encoding="{code}"?><!DOCTYPE a [<!ENTITY b "x">]><LIGO_LW>&b;</LIGO_LW>'
        (tmp_path / "a.xml").write_bytes(text.encode(code))
        with pytest.raises(ls.LoopshapeError, match="entities"):
            ls.formats.read_frf(tmp_path / "a.xml", relative_std=0.1)
