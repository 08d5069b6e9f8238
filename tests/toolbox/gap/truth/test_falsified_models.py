"""Models of real machines falsified on purpose: the size that a label states undoes the falsification."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.gap.own.plant import OwnMachine

STUDY = Path(__file__).parents[4] / "experiments" / "falsified"
SHOWN = 1.25  # of what the honest model leaves: below it the recordings hardly show what was falsified
NEAR = 0.03  # of what the honest model leaves: a delay is taken between samples, a lost tick at the ends
MACHINES = ("emps", "qube", "tokyo", "double_pendulum")


@pytest.fixture(scope="module")
def study():
    sys.path[:0] = [str(STUDY), str(STUDY.parent / "lab")]
    yield runpy.run_path(str(STUDY / "run.py"))
    sys.path.remove(str(STUDY))


def undone(machine, model, label, size):
    """Moves that bring in what the label says, written out here and nowhere else."""
    kind, _, place = label.partition("@")
    mine = [p for p in model.parameters if p.effect == label and p.value]
    if mine:
        return {f"change.{mine[0].name}": size}
    slides = sys.modules[machine.model.__module__].SLIDES
    return {
        "actuator_gain_error": {f"input.{place}.gain": size},
        "actuator_delay": {f"input.{place}.delay_ms": size},
        "sensor_gain": {f"output.{place}.gain": size},
        "sensor_delay": {f"output.{place}.delay_ms": size},
        "sensor_offset": {f"output.{place}.offset": size},
        "coulomb_friction": {f"port.{place}.coulomb": size, f"port.{place}.coulomb_speed": slides},
        "viscous_error": {f"port.{place}.viscous": size},
    }[kind]


def there(study, name):
    """A machine of the study, where its recordings are."""
    machine = study["MACHINES"][name]
    if not machine.there:
        pytest.skip(f"the recordings of {name} are absent: set LOOPSHAPE_DATA to their folder")
    return machine


def floors(model, run, moves):
    """Rms over the estimation pieces, in floors."""
    plant = OwnMachine(model)
    ready = [plant.prepare(r, run, None) for r in run.recordings if r.info.role == "estimation"]
    return np.sqrt(np.mean(np.concatenate([np.concatenate(list(plant.paths(f, moves).values())) for f in ready]) ** 2))


@pytest.mark.long
@pytest.mark.parametrize("name", MACHINES)
def test_the_size_of_a_label_undoes_what_was_falsified(study, name):
    machine = there(study, name)
    numbers = study["honest"](machine)
    good = floors(*study["false"](machine, numbers, study["HONEST"]), {})
    for case in machine.cases(numbers):
        model, run = study["false"](machine, numbers, case)
        assert floors(model, run, {}) > SHOWN * good, f"{case.name} is hardly shown by these recordings"
        if case.size is not None:
            healed = floors(model, run, undone(machine, model, case.label, case.size))
            assert healed == pytest.approx(good, rel=NEAR), f"{case.name}: {case.label} {case.size:g}"


def mapped(model, run):
    """What is looked at before anything is fitted."""
    return OwnMachine(model).readied(run, [r.info.name for r in run.recordings if r.info.role == "estimation"])


@pytest.mark.long
@pytest.mark.parametrize("name", MACHINES)
def test_no_falsified_model_is_refused_for_its_units(study, name):
    machine = there(study, name)
    numbers = study["honest"](machine)
    for case in (study["HONEST"], *machine.cases(numbers)):
        plant, _, names = mapped(*study["false"](machine, numbers, case))
        assert plant.effects, case.name  # it is ready to be diagnosed
        assert names, case.name


@pytest.mark.long
@pytest.mark.parametrize("factor", [57.29577951308232, 1.0 / 57.29577951308232, -1.0, 1000.0])
@pytest.mark.parametrize("name", ["emps", "qube", "double_pendulum"])
def test_a_column_of_a_real_recording_that_is_wrong_by_a_plain_factor_is_named(study, name, factor):
    machine = there(study, name)
    model, run = study["false"](machine, study["honest"](machine), study["HONEST"])
    for column in model.columns:
        changed = [
            ls.Recording(r.info, r.rate_hz, {k: factor * v if k == column else v for k, v in r.columns.items()})
            for r in run.recordings
        ]
        with pytest.raises(ls.errors.WrongUseError, match="mapped wrongly") as refused:
            mapped(model, ls.Run(run.rate_hz, (), tuple(changed)))
        assert f'column = "{column}" by {1.0 / factor:.6g}' in str(refused.value)


@pytest.mark.long
def test_the_least_squares_peer_takes_steps_on_the_pendulum_drive(study):
    there(study, "qube")
    row = study["answered"]("", "qube", "gain_less", True)
    assert row["verdict"] not in ("refused", "none"), row["why"]
    assert float(row["after"]) < 0.3 * float(row["before"])


@pytest.mark.long
def test_a_window_that_runs_away_says_nothing_of_the_forces_at_a_port(study):
    """Upright a push at the pivot ends in a fall: some windows run far off and stay finite."""
    machine = there(study, "qube")
    numbers = study["honest"](machine)
    cases = {c.name: c for c in (study["HONEST"], *machine.cases(numbers))}
    forces = []
    for name in ("honest", "gain_less", "encoder_late"):
        model, run = study["false"](machine, numbers, cases[name])
        plant = OwnMachine(model)
        ready = [plant.prepare(r, run, None) for r in run.recordings if r.info.role == "estimation"]
        forces.append(plant._scales(ready).port["pivot"].force)
    assert max(forces) < 2.0 * min(forces)  # the pivot is the same; with windows that ran away 1e-120 N m
    assert 1e-4 < min(forces) < 0.1  # m g l is 0.02 N m
