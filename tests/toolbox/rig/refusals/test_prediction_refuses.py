"""What predictions and comparisons refuse, and the sentence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import INDICATORS, Block, Indicators, LoopSetup, RecordingInfo, Step
from plant_behind import plant_behind
from prediction_nouns import read_predictions, write_predictions

import loopshape as ls
from loopshape.toolbox.rig.verbs.machine import blocks_of
from loopshape.toolbox.validation.comparison import compare, estimate_sensitivity, sensitivity_of
from loopshape.toolbox.validation.predicted.predict import predict

GAIN = ls.Controller("a", (Block("gain", {"gain": 1.0}),), 1000.0)


def plant(loop: str = "a", rate_hz: float = 1000.0, valid: bool = True, held: ls.Controller | None = GAIN) -> ls.FRF:
    f = np.arange(1.0, 11.0)
    P = 1.0 / (2j * np.pi * f)
    return ls.FRF(
        f, P[:, None, None], (1e-4 * np.abs(P) ** 2)[:, None, None].astype(complex), np.full(10, valid), ("z_v",),
        ("a_rad",), "made", recording="r", loop=loop, rate_hz=rate_hz, recorded_under=held,
    )  # fmt: skip


def prediction() -> ls.Prediction:
    return ls.Prediction(sensitivity_of(plant()), "stable")


def test_another_controller_another_loop_and_another_rate_are_refused() -> None:
    other = ls.Controller("a", (Block("gain", {"gain": 1.01}),), 1000.0)
    with pytest.raises(ls.errors.WrongUseError, match="closed by another controller"):
        compare(prediction(), sensitivity_of(plant(held=other)))
    with pytest.raises(ls.errors.WrongUseError, match="not of the loop"):
        compare(prediction(), replace(sensitivity_of(plant()), loop="b"))
    with pytest.raises(ls.errors.WrongUseError, match="not of the loop"):
        compare(prediction(), replace(sensitivity_of(plant()), rate_hz=500.0))


def test_a_controller_that_is_not_known_is_noted_and_lines_that_nobody_trusts_tell_nothing() -> None:
    measured = replace(sensitivity_of(plant()), recorded_under=None)
    assert any("is assumed" in note for note in compare(prediction(), measured).notes)
    blind = compare(prediction(), replace(measured, valid=np.zeros(10, dtype=bool)))
    assert (blind.outcome, blind.lines, blind.worst) == ("cannot tell", 0, None)


def test_a_sensitivity_needs_its_controller_and_a_closed_loop() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="does not follow"):
        sensitivity_of(plant(held=None))
    with pytest.raises(ls.errors.WrongUseError, match="its controller"):
        plant_behind(plant(held=None), "z_v")
    info = RecordingInfo("r.parquet", "multisine", "control", excites="a", closed_loop=False)
    loop = LoopSetup("a", None, None, "z_v", "a_rad", None)
    with pytest.raises(ls.errors.BadSignalError, match="loop was open"):
        estimate_sensitivity(ls.Recording(info, 1000.0, {"z_v": np.ones(10), "a_rad": np.ones(10)}), loop)


def test_nothing_to_predict_from_and_nothing_that_belongs_are_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="no FRF of loop 'a'"):
        predict([], GAIN)
    run = ls.Run(1000.0, (LoopSetup("a", None, None, "z_v", "a_rad", GAIN),), ())
    with pytest.raises(ls.errors.WrongUseError, match="no recording of the run belongs"):
        ls.compare(run, [prediction()])


def test_damaged_and_foreign_prediction_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.npz"
    with pytest.raises(ls.errors.UnreadableInputError, match="does not exist"):
        read_predictions(path)
    path.write_bytes(b"half a file")
    with pytest.raises(ls.errors.UnreadableInputError, match="cannot be read as predictions"):
        read_predictions(path)
    np.savez(path, header=np.array('{"format": "other/1", "predictions": []}'))
    with pytest.raises(ls.errors.UnreadableInputError, match="not of the format"):
        read_predictions(path)
    with pytest.raises(ls.errors.WrongUseError, match="no prediction to write"):
        write_predictions(path, [])
    with pytest.raises(ls.errors.WrongUseError, match="two predictions"):
        write_predictions(path, [prediction(), prediction()])


@pytest.mark.parametrize("value", [0.0, 1e-30, 1e30, 1e49])
def test_a_prediction_file_with_sensitivities_that_no_loop_has_is_refused(tmp_path: Path, value: float) -> None:
    path, own = tmp_path / "p.npz", prediction()
    response = own.sensitivity.response.copy()
    response[3] = value
    write_predictions(path, [replace(own, sensitivity=replace(own.sensitivity, response=response))])
    with pytest.raises(ls.errors.UnreadableInputError, match=r"predicted \|S\| lies in"):
        read_predictions(path)


def test_a_prediction_file_with_a_step_that_is_not_of_numbers_is_refused(tmp_path: Path) -> None:
    rise, path = np.linspace(0.0, 1.0, 5), tmp_path / "p.npz"
    step = Step(rise, rise, rise, rise, Indicators(**dict.fromkeys(INDICATORS, 1.0), outcome="settled"), "fit")
    write_predictions(path, [replace(prediction(), step=step)])
    assert read_predictions(path)[0].step is not None
    for name in ("time_s", "response", "low", "high"):
        write_predictions(path, [replace(prediction(), step=replace(step, **{name: rise * np.nan}))])
        with pytest.raises(ls.errors.UnreadableInputError, match="step is of finite numbers"):
            read_predictions(path)


@pytest.mark.parametrize("tolerance_db", [np.inf, np.nan, -1.0, 1e5])
def test_a_tolerance_that_lets_everything_pass_is_refused(tolerance_db: float) -> None:
    with pytest.raises(ls.errors.WrongUseError, match=r"tolerance of \|S\|"):
        compare(prediction(), sensitivity_of(plant()), tolerance_db=tolerance_db)


@pytest.mark.parametrize(
    ("head", "word"),
    [("rate_hz = 500.0", "another rate"), ("rate_hz = 1000.0\nprewarp", "plain Tustin")],
)
def test_controllers_that_the_simulated_rig_does_not_run_are_refused(tmp_path: Path, head: str, word: str) -> None:
    rate, prewarp = head.split("\n")[0], "prewarp_hz = 5.0\n" if "prewarp" in head else ""
    path = tmp_path / "c.toml"
    path.write_text(
        f'format = "loopshape-controllers/1"\n{rate}\n[[loop]]\nname = "a"\n{prewarp}'
        'controller = [{ kind = "gain", gain = 1.0 }]\n'
    )
    with pytest.raises(ls.errors.WrongUseError, match=word):
        blocks_of(ls.read_controllers(path), 1000.0)
