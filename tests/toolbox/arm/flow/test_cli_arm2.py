"""A study of the 2-DoF arm through the commands: `measure` records its four loops and estimates an FRF of each."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import loopshape

ROOT = Path(__file__).parents[4]
STUDY = ROOT / "examples" / "arm2" / "study.toml"
LOOPS = {"theta1": "rad", "theta2": "rad", "p_a": "bar", "p_c": "bar"}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The example, as it stands."""
    folder = tmp_path_factory.mktemp("arm2") / "run"
    done = loopshape("measure", STUDY, "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


def test_the_example_gives_a_frf_of_each_loop(measured: tuple[Path, dict]) -> None:
    folder, said = measured
    assert said["warnings"] == []
    assert [frf["loop"] for frf in said["frfs"]] == list(LOOPS)
    for frf in said["frfs"]:
        assert frf["valid_from_hz"] <= 0.5
        assert frf["valid_to_hz"] >= 5.0
    assert sorted(p.name for p in folder.glob("*.parquet")) == [
        "p_a.parquet",
        "p_c.parquet",
        "theta1.parquet",
        "theta2.parquet",
    ]


def test_its_tables_have_the_columns_of_the_2_dof_arm(measured: tuple[Path, dict]) -> None:
    table = pd.read_parquet(measured[0] / "theta1.parquet")
    columns = ["t_s"]
    for loop, unit in LOOPS.items():
        columns += [f"r_{loop}_{unit}", f"n_{loop}_v", f"z_{loop}_v", f"{loop}_{unit}"]
    assert list(table.columns) == [*columns, "p_b_bar", "p_d_bar", "u_a_v", "u_b_v", "u_c_v", "u_d_v"]
    assert len(table) == 64_000
    assert table.n_theta1_v.std() > 0.05
    np.testing.assert_array_equal(table.n_theta2_v, 0.0)
    z = table.z_theta1_v + table.n_theta1_v
    np.testing.assert_allclose(table.u_d_v, z, atol=1e-12)
    np.testing.assert_allclose(table.u_c_v, table.z_p_c_v - z, atol=1e-12)


def test_a_gap_of_this_plant_is_refused_in_a_sentence(measured: tuple[Path, dict]) -> None:
    done = loopshape("gap", measured[0])
    assert done.returncode == 2
    assert "no catalogue of effects" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("effect", ["payload=0.2", "joint_friction"])
def test_an_effect_on_it_is_refused_in_a_sentence(tmp_path: Path, effect: str) -> None:
    name, _, size = effect.partition("=")
    text = STUDY.read_text().replace("seed = 1\n", f"seed = 1\neffects = {{ {name} = {size or 1.0} }}\n", 1)
    (tmp_path / "study.toml").write_text(text)
    done = loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "the plant arm-2dof has no catalogue of effects" in " ".join(done.stderr.split())
    assert not (tmp_path / "run").exists()
