"""`ls.read` gives what `ls.write` took: every noun that has a file of its own, number for number."""

from pathlib import Path

import numpy as np
import pytest

import loopshape as ls

F = np.geomspace(1.0, 100.0, 40)
C = ls.controller(ls.gain(2.0), ls.pi(1.5), ls.notch(30.0, depth_db=12.0, width_hz=4.0), rate_hz=1000.0, loop="x")


def plant() -> ls.FRF:
    rng = np.random.default_rng(3)
    H = 1.0 / (1.0 + 2j * np.pi * F * 0.01) * (1.0 + 0.01 * rng.standard_normal(F.size))
    return ls.FRF.from_arrays(F, H, std=0.01 * np.abs(H), rate_hz=1000.0, loop="x")


@pytest.mark.parametrize("ending", [".csv", ".mat", ".h5"])
def test_an_frf(tmp_path: Path, ending: str) -> None:
    P = plant()
    back = ls.read(ls.write(P, tmp_path / f"plant{ending}"))
    assert isinstance(back, ls.FRF)
    for name in ("frequency_hz", "response", "variance", "valid"):
        np.testing.assert_allclose(getattr(back, name), getattr(P, name), rtol=1e-12)
    assert back.loop == "x"


def test_controllers(tmp_path: Path) -> None:
    other = ls.controller(ls.gain(0.5), rate_hz=1000.0, loop="y")
    for made in ([C], [C, other]):
        back = ls.read(ls.write(made, tmp_path / f"{len(made)}.toml"))
        assert [one.digest for one in back] == [one.digest for one in made]
        assert [(one.loop, one.rate_hz) for one in back] == [(one.loop, one.rate_hz) for one in made]
    assert ls.read(ls.write(C, tmp_path / "c.toml"))[0].digest == C.digest


def test_a_schedule(tmp_path: Path) -> None:
    soft, stiff = (ls.controller(ls.gain(k), rate_hz=1000.0, loop="x") for k in (10.0, 4.0))
    made = ls.schedules.gain_scheduled([soft, stiff], [{"p_bar": 0.8}, {"p_bar": 1.4}], {"p_bar": "p"})
    (back,) = ls.read(ls.write(made, tmp_path / "schedule.toml"))
    assert repr(back) == repr(made)
    np.testing.assert_array_equal([one.digest for one in back.controllers], [one.digest for one in made.controllers])


def test_a_run(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    u, y, n = rng.standard_normal((3, 500))
    run = ls.Run.from_arrays(u=u, y=y, excitation=n, rate_hz=1000.0)
    back = ls.read(ls.write(run, tmp_path / "run"))
    for one, other in zip(run.recordings, back.recordings, strict=True):
        for name in one.columns:
            np.testing.assert_array_equal(other.column(name), one.column(name))


def test_predictions(tmp_path: Path) -> None:
    made = ls.predict(plant(), C)
    (back,) = ls.read(ls.write(made, tmp_path / "predicted.npz"))
    np.testing.assert_array_equal(back.sensitivity.response, made[0].sensitivity.response)
    (again,) = ls.read(ls.write(made[0], tmp_path / "one.npz"))
    np.testing.assert_array_equal(again.sensitivity.response, made[0].sensitivity.response)


def test_requirements(tmp_path: Path) -> None:
    file = tmp_path / "requirements.toml"
    file.write_text('format = "loopshape-requirements/1"\n[[loop]]\nname = "x"\nphase_margin_deg = 45.0\n')
    (R,) = ls.read(file)
    assert (R.loop, R.phase_margin_deg) == ("x", 45.0)


@pytest.mark.parametrize("name", ["nothing.toml", "nothing.npz", "nothing.json", "nothing.csv", "nothing", "notes.txt"])
def test_what_holds_no_noun_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ls.errors.UnreadableInputError):
        ls.read(tmp_path / name)
