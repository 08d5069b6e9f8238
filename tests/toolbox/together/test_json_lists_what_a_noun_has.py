"""What a noun's answer in JSON lists exists in the noun; a file that is read back holds its fields and nothing else."""

import importlib
from dataclasses import dataclass, fields

import pytest

from loopshape.core.json_ready import Plain, json_ready, keys

for name in (
    "toolbox.validation.kept.against",
    "toolbox.limits.bound",
    "toolbox.schedules.schedule",
    "design.turns",
    "toolbox.planning.plan",
    "toolbox.validation.remeasured",
):
    importlib.import_module(f"loopshape.{name}")
importlib.import_module("loopshape.io.write.check_files")


def nouns(of=Plain):
    return [noun for one in of.__subclasses__() for noun in (one, *nouns(one)) if noun.__module__.startswith("loops")]


@dataclass(frozen=True)
class Inner(Plain):
    ALSO = keys("double")

    value: float

    @property
    def double(self):
        return 2.0 * self.value


@dataclass(frozen=True)
class Outer(Plain):
    IN_JSON = keys("missing", low_hz="band_hz.0", of_it="inner.value", of_none="missing.value", inner="inner")

    inner: Inner
    band_hz: tuple[float, float] = (1.0, float("nan"))
    missing: Inner | None = None


@pytest.mark.parametrize("noun", nouns(), ids=lambda noun: noun.__name__)
def test_every_key_is_of_the_noun(noun):
    known = {f.name for f in fields(noun)} | set(dir(noun))
    assert {path.split(".")[0] for path in (*noun.IN_JSON.values(), *noun.ALSO.values())} <= known


def test_paths_lead_through_nouns_and_end_at_none():
    made = Outer(Inner(float("nan"))).to_dict()
    assert made == {
        "missing": None, "low_hz": 1.0, "of_it": None, "of_none": None, "inner": {"value": None, "double": None},
    }  # fmt: skip


def test_a_file_holds_the_fields_alone():
    assert json_ready([Inner(float("nan"))]) == [{"value": "nan"}]
    assert json_ready([Inner(2.0)], None) == [{"value": 2.0, "double": 4.0}]
