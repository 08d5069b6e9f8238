"""Profiles: the limits of standards, the stricter of two, and zones with their probability."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import loopshape as ls
from loopshape.data.requirement.profile import zone_shares
from loopshape.io.requirements import OWN, profile_of, read_profiles
from loopshape.view.verdict.tables import zone_sentence

DOCS = Path(__file__).parents[3] / "docs" / "profiles.md"
F = np.geomspace(0.5, 200.0, 120)


def verdict_at(gain, relative_std=0.01):
    """A loop gain/(s (s/60 + 1)) whose peak |S| follows from the response itself."""
    P = ls.FRF.from_arrays(
        F, 1.0 / (1j * F / 5.0 * (1.0 + 1j * F / 10.0)), relative_std=relative_std, rate_hz=1000.0
    )  # fmt: skip
    R = ls.Requirements(unstable_poles=0, integrators=1)
    return ls.check(P, ls.controller(ls.gain(gain), rate_hz=1000.0), R)


def test_the_zones_of_iso_14839_3_end_at_peaks_of_3_4_and_5():
    zones = ls.profiles()["iso-14839-3"].zones
    assert [zone.name for zone in zones] == ["A", "B", "C", "D"]
    ends = [zone.up_to_db for zone in zones[:3]]
    np.testing.assert_allclose(ends, 20.0 * np.log10([3.0, 4.0, 5.0]), atol=0.06)


def test_the_shares_of_zones_are_those_of_a_normal_error_in_dB():
    profile = ls.profiles()["iso-14839-3"]
    verdict = verdict_at(14.0, 0.05)
    (found,) = verdict.margins.values()
    low, high = found.intervals["sensitivity_peak_db"]
    draws = found.sensitivity_peak_db + (high - low) / 3.92 * np.random.default_rng(3).standard_normal(200_000)
    edges = [-np.inf, *(zone.up_to_db for zone in profile.zones)]
    counted = np.histogram(draws, edges)[0] / draws.size
    shares = zone_shares(verdict, profile)
    assert sum(shares.values()) == pytest.approx(1.0)
    np.testing.assert_allclose([shares[name] for name in "ABCD"], counted, atol=0.005)
    assert re.search(r"zone [ABCD], peak \|S\| \d+\.\d dB", zone_sentence(verdict, profile))


def test_a_sharper_loop_moves_from_zone_A_to_zone_D():
    profile = ls.profiles()["iso-14839-3"]
    best = [max(s, key=s.get) for s in (zone_shares(verdict_at(g), profile) for g in (1.0, 4.0, 100.0))]
    assert best[0] == "A"
    assert best[-1] == "D"


def test_of_two_limits_the_stricter_holds():
    R = ls.Requirements(phase_margin_deg=30.0, sensitivity_peak_db=3.0, gain_margin_db=10.0)
    both = ls.profiles()["ecss-e-st-60-10"].joined(R)
    assert (both.phase_margin_deg, both.sensitivity_peak_db, both.gain_margin_db) == (30.0, 3.0, 10.0)
    both = ls.profiles()["mil-dtl-9490"].joined(R)
    assert (both.phase_margin_deg, both.sensitivity_peak_db, both.gain_reduction_margin_db) == (45.0, 3.0, 6.0)


def test_every_profile_says_its_source_and_who_confirms():
    for one in ls.profiles().values():
        assert re.search("have to confirm|has to confirm|have to agree", one.confirm)
        assert one.standard.startswith("practice") or set(one.unread) <= set(one.limits)
        assert any(one.clause in sentence for sentence in one.sentences())


def test_a_profile_of_one_s_own(tmp_path):
    text = OWN.read_text(encoding="utf-8").replace(
        "limits = { sensitivity_peak_db = 6.0 }", "limits = { sensitivity_peak_db = 4.5 }"
    )
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    assert profile_of(f"{tmp_path / 'mine.toml'}:drone").limits == {"sensitivity_peak_db": 4.5}
    (tmp_path / "mine.toml").write_text(
        text.replace("limits = { gain_margin_db = 6.0, phase_margin_deg = 45.0 }", "limits = { gain_marg_db = 6.0 }"),
        encoding="utf-8",
    )
    with pytest.raises(ls.LoopshapeError, match=r"gain_marg_db.*gain_margin_db"):
        read_profiles(tmp_path / "mine.toml")


def test_the_table_of_the_docs_is_that_of_the_file():
    rows = [line for line in DOCS.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    written = {row.split("`")[1]: row for row in rows}
    assert set(written) == set(ls.profiles())
    for name, one in ls.profiles().items():
        for quantity, value in one.limits.items():
            mark = " (not read)" if quantity in one.unread else ""
            assert f"{quantity} {value:g}{mark}" in written[name], name
        assert one.edition in written[name]


def test_check_under_a_profile_says_zone_and_clause(tmp_path, capsys):
    from run_files import write_frfs

    from loopshape.cli.output import Output
    from loopshape.cli.verify.check import check_run

    P = ls.FRF.from_arrays(
        F, 1.0 / (1j * F / 5.0 * (1.0 + 1j * F / 10.0)), relative_std=0.01, rate_hz=1000.0, loop="x", recording="r",
        open_loop=True,
    )  # fmt: skip
    write_frfs(tmp_path / "run", [P])
    ls.write(ls.controller(ls.gain(1.0), rate_hz=1000.0, loop="x"), tmp_path / "c.toml")
    passed, _ = check_run(tmp_path / "run", tmp_path / "c.toml", None, Output(), figures=False, profile="iso-14839-3")
    said = " ".join(capsys.readouterr().out.split())
    assert passed
    assert [word for word in ("zone A", "ISO 14839-3", "have to agree", "Not read") if word not in said] == []
    check_run(tmp_path / "run", tmp_path / "c.toml", None, Output(True), figures=False, profile="iso-14839-3")
    told = json.loads(capsys.readouterr().out)["profile"]
    assert told["zones"]["x"]["A"] > 0.99
    assert told["unread"] == ["sensitivity_peak_db"]
