"""The picture of a gap diagnosis: its blocks, bars, distances and traces say what the report says."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text

import loopshape as ls
from loopshape.toolbox.gap.nouns.gap_report import Ranked, Shrink, Submodel, Trace, Where
from loopshape.toolbox.gap.pictures.chain import chain, in_order, shares
from loopshape.toolbox.gap.pictures.distances import distances
from loopshape.toolbox.gap.pictures.report import errors, gap_figure, hypotheses, plainest, stretch, window
from loopshape.view.style import png

BLOCKS = ("valve", "supply", "controller", "sensor", "joint", "muscle", "body", "line", "gas")
PATHS = ("u -> p_a", "p -> theta2")
PAIR = "backlash+payload"


def trace(name: str, off: float) -> Trace:
    """A slow sine from which the nominal model leaves by a bump at 12 s."""
    t = np.arange(0.0, 20.0, 0.01)
    measured = 10.0 * np.sin(0.3 * t)
    bump = off * np.exp(-((t - 12.0) ** 2))
    return Trace(name, "theta2 [deg]", t, measured, measured + bump, measured + 0.05 * bump)


def rows(
    after: float | None, rival: float | None, roles: tuple[str, ...] = ("estimation", "validation")
) -> list[Submodel]:
    return [
        Submodel(f"{role[:3]}{k}", role, path, 4.0 * (k + 1), after, rival)
        for role in roles
        for k in range(2)
        for path in PATHS
    ]


def single() -> ls.gap.GapReport:
    """A payload, plainly."""
    return ls.gap.GapReport(
        run="r",
        plant="arm-1dof",
        verdict="payload",
        ranking=[
            Ranked("payload", 0.9, 61.2, (58.0, 64.4), "g", "point mass"),
            Ranked("base_tilt", 0.06, -2.3, (-3.0, -1.6), "deg", "gravity turned"),
            Ranked("unknown", 0.03),
            Ranked("none", 0.0099),
            Ranked("leak", 1e-4),
        ],
        ambiguity=[["payload"]],
        where=Where(
            "body", {"body": 0.96, "unknown": 0.03, "none": 0.0099} | {b: 0.0 for b in BLOCKS if b != "body"},
            "theta2", (0.2, 3.1), [{"theta2_deg": 0.0, "p_ab_bar": 1.0}],
        ),
        gap=Shrink("rms", 6.3, 1.2, 0.96, (0.9, 1.0), ("val0.parquet",), "base_tilt", 4.0),
        submodels=rows(1.1, 3.0),
        software=[],
        table=None,
        table_after=None,
        traces=[trace("r1", 1.0), trace("r2", 3.0)],
        sentence="r: payload 61.2 g (probability 90%) in body; with it the gap shrinks from 6.3 to 1.2 noise floors.",
    )  # fmt: skip


def pair() -> ls.gap.GapReport:
    ranking = [
        Ranked(
            PAIR, 0.8, form="a + b", parts={"backlash": (0.5, (0.4, 0.6), "deg"), "payload": (40.0, (30.0, 50.0), "g")}
        ),
        *(replace(r, probability=0.05) for r in single().ranking[:4]),
    ]
    where = replace(
        single().where, block="body+sensor", blocks=dict(single().where.blocks) | {"body+sensor": 0.8, "body": 0.1}
    )
    return replace(single(), verdict=PAIR, ranking=ranking, ambiguity=[[PAIR], ["payload"], ["none"]], where=where)


def none() -> ls.gap.GapReport:
    gap = Shrink("rms", 1.1, 1.1, None, None, ("val0.parquet",))
    where = replace(single().where, block="none", blocks=dict(single().where.blocks) | {"none": 0.9, "body": 0.05})
    ranking = [Ranked("none", 0.9), *(replace(r, probability=0.02) for r in single().ranking[:3])]
    return replace(
        single(), verdict="none", ranking=ranking, ambiguity=[["none"]], where=where, gap=gap,
        submodels=rows(None, None),
        traces=[replace(t, with_effect=t.nominal) for t in single().traces], sentence="r: no gap.",
    )  # fmt: skip


def unknown() -> ls.gap.GapReport:
    gap = Shrink("rms", 6.3, 6.3, 0.0, (0.0, 0.0), ("val0.parquet",))
    where = replace(single().where, block="unknown", blocks=dict(single().where.blocks) | {"unknown": 0.7, "body": 0.2})
    ranking = [Ranked("unknown", 0.7), *(r for r in single().ranking if r.effect != "unknown")]
    return replace(
        single(), verdict="unknown", ranking=ranking, where=where, gap=gap, submodels=rows(None, None),
        sentence="r: a gap that no known effect explains.",
    )  # fmt: skip


def without_validation() -> ls.gap.GapReport:
    return replace(single(), gap=None, submodels=rows(1.1, 3.0, ("estimation",)))


def of_ones_own() -> ls.gap.GapReport:
    """A machine of a user's own: long names, two sensors, places that are no chain."""
    both = "actuator_gain_error@drive+coulomb_friction@ring"
    parts = {"actuator_gain_error@drive": (0.0075, (0.003, 0.012), "1"),
             "coulomb_friction@ring": (4.02, (3.61, 4.44), "N m")}  # fmt: skip
    bent = "actuator_gain_error@drive+viscous_error@ring"
    long = {"actuator_gain_error@drive": (-0.121, (-0.179, -0.0631), "1"),
            "viscous_error@ring": (-0.0288, (-0.0421, -0.0155), "N m per speed")}  # fmt: skip
    ranking = [
        Ranked("coulomb_friction@ring", 0.62, 3.96, (3.55, 4.38), "N m", "bristles"),
        Ranked(both, 0.25, form="a + b", parts=parts), Ranked("unknown", 0.07),
        Ranked(bent, 0.05, form="a + b", parts=long, quantities={"actuator_gain_error@drive": "gain"}),
        Ranked("joint_flexibility@rail", 0.01, 2384.0, (2100.0, 2600.0), "N m/rad per travel"),
    ]  # fmt: skip
    blocks = {"ring": 0.62, "drive+ring": 0.3, "unknown": 0.07, "rail": 0.01, "none": 0.0, "encoder": 0.0, "hook": 0.0}
    where = replace(single().where, block="ring", blocks=blocks, channel="inclinometer", operating_points=[{}])
    own = [replace(s, path=f"inputs -> {name}") for s in rows(1.1, 3.0) for name in ("encoder", "inclinometer")]
    gap = Shrink("rms", 192.9, 12.2, 0.94, (0.9, 0.97), ("val0.parquet",))
    return replace(
        single(), verdict="coulomb_friction@ring", ranking=ranking, ambiguity=[["coulomb_friction@ring"], [both]],
        gap=gap, where=where, submodels=own,
    )  # fmt: skip


ALL = {"own": of_ones_own, "single": single, "pair": pair, "none": none, "unknown": unknown}
ALL |= {"no validation": without_validation}


def xs(ax: Axes, gid: str) -> list[float]:
    return [float(x) for line in ax.lines if line.get_gid() == gid for x in np.asarray(line.get_xdata())]


def ys(ax: Axes, gid: str) -> np.ndarray:
    return next(np.asarray(line.get_ydata()) for line in ax.lines if line.get_gid() == gid)


def boxes(ax: Axes) -> dict[str, Rectangle]:
    found = [p for p in ax.patches if isinstance(p, Rectangle) and str(p.get_gid()).startswith("block ")]
    return {str(p.get_gid()).removeprefix("block "): p for p in found}


def words(figure: Figure) -> str:
    texts = [t.get_text() for ax in figure.axes for t in (*ax.texts, ax.title, ax.xaxis.label, ax.yaxis.label)]
    return " | ".join([*texts, *(a.get_title(loc="left") for a in figure.axes)])


@pytest.mark.long
@pytest.mark.parametrize("make", ALL.values(), ids=list(ALL))
def test_every_verdict_gives_a_whole_figure_under_its_sentence(make) -> None:
    report = make()
    figure = gap_figure(report)
    assert " ".join(figure.get_suptitle().split()) == report.sentence
    assert len(figure.axes) == 5  # blocks, bars, distances, a stretch and its errors
    for word in ("Where", "Which", "How\\ far", "How\\ it\\ looks"):
        assert word in words(figure)
    assert png(figure).startswith(b"\x89PNG")


@pytest.mark.parametrize("make", ALL.values(), ids=list(ALL))
def test_no_text_is_cut_or_lies_on_another_of_its_panel(make) -> None:
    figure = gap_figure(make())
    FigureCanvasAgg(figure).draw()
    width, height = figure.bbox.size
    for ax in figure.axes:
        shown = [t.get_window_extent() for t in ax.texts if t.get_text()]
        for k, one in enumerate(shown):
            assert one.x0 >= 0.0
            assert one.y0 >= 0.0
            assert one.x1 <= width
            assert one.y1 <= height
            assert not any(one.shrunk(0.9, 0.75).overlaps(other.shrunk(0.9, 0.75)) for other in shown[k + 1 :])


@pytest.mark.parametrize("make", ALL.values(), ids=list(ALL))
def test_no_title_is_cut_or_lies_on_another(make) -> None:
    figure = gap_figure(make())
    FigureCanvasAgg(figure).draw()
    titles = [t.get_window_extent() for t in figure.findobj(Text) if "\\bf" in t.get_text()]
    assert len(titles) == 4
    for k, one in enumerate(titles):
        assert one.x0 >= 0.0
        assert one.x1 <= figure.bbox.width
        assert not any(one.overlaps(other) for other in titles[k + 1 :])


def test_places_that_nobody_says_how_to_connect_stand_apart_most_probable_first() -> None:
    ax = chain(of_ones_own().where)
    row = [name for name, box in boxes(ax).items() if box.get_y() == 0.0]
    assert row[:2] == ["ring", "drive"]
    assert not [line for line in ax.lines if line.get_gid() == "feedback"]
    assert [line for line in chain(single().where).lines if line.get_gid() == "feedback"]


def test_blocks_stand_in_the_signals_order_and_what_feeds_stands_above() -> None:
    assert in_order([*BLOCKS, "none", "unknown"]) == [
        "controller", "valve", "line", "gas", "muscle", "joint", "body", "sensor",
    ]  # fmt: skip
    assert in_order(["sensor", "crane", "controller"]) == ["controller", "crane", "sensor"]
    found = boxes(chain(single().where))
    assert found["supply"].get_x() == found["valve"].get_x()
    assert found["supply"].get_y() > found["valve"].get_y()


def test_the_blamed_block_is_framed_and_each_block_says_its_probability() -> None:
    ax = chain(single().where)
    found = boxes(ax)
    assert set(found) == {*BLOCKS, "none", "unknown"}
    assert [name for name, box in found.items() if box.get_linewidth() > 1.5] == ["body"]
    texts = [t.get_text() for t in ax.texts]
    assert texts.count("< 1 %") == len(BLOCKS)  # eight blocks and none
    assert "96 %" in texts
    assert "3 %" in texts
    assert any("0.2 to 3.1 Hz" in t and "1 bar" in t for t in texts)


def test_a_pair_blames_both_blocks_and_counts_for_both() -> None:
    found = boxes(chain(pair().where))
    assert {name for name, box in found.items() if box.get_linewidth() > 1.5} == {"body", "sensor"}
    assert shares(pair().where.blocks)["body"] == pytest.approx(0.9)
    assert shares({"body+body": 0.5, "none": 0.5}) == {"body": 0.5, "none": 0.5}


def test_bars_are_as_long_as_probabilities_with_sizes_and_units() -> None:
    ax = hypotheses(single())
    bars = {str(p.get_gid()): p.get_width() for p in ax.patches if str(p.get_gid()).startswith("probability")}
    assert bars == {
        "probability payload": 0.9, "probability base_tilt": 0.06, "probability unknown": 0.03,
        "probability none": 0.0099,
    }  # fmt: skip
    texts = [t.get_text() for t in ax.texts]
    assert "61.2 g (58 to 64.4)" in texts
    assert "\N{MINUS SIGN}2.3 deg (\N{MINUS SIGN}3 to \N{MINUS SIGN}1.6)" in texts
    assert ax.get_xlabel() == "probability"


def test_the_ambiguity_set_is_dark() -> None:
    ax = hypotheses(pair())
    colours = {str(p.get_gid()).removeprefix("probability "): p.get_facecolor() for p in ax.patches if p.get_gid()}
    assert colours[PAIR] == colours["payload"] == colours["none"]
    assert colours["base_tilt"] != colours[PAIR]
    assert any(t.get_text() == "0.5 deg (0.4 to 0.6);  40 g (30 to 50)" for t in ax.texts)


def test_distances_are_rms_over_the_recordings_held_out_beside_the_floor() -> None:
    ax = distances(single())
    rms = float(np.sqrt((4.0**2 + 8.0**2) / 2.0))
    assert xs(ax, "before") == pytest.approx([rms] * 3)  # all paths, then each
    assert xs(ax, "after") == pytest.approx([1.1] * 3)
    assert xs(ax, "rival") == pytest.approx([3.0] * 3)
    assert xs(ax, "before each") == [4.0, 8.0] * 2
    assert set(xs(ax, "floor")) == {1.0}
    assert ax.get_xscale() == "log"
    assert [t.get_text() for t in ax.get_yticklabels()] == ["all paths", "u → $p_{A}$", "p → $\\theta_{2}$"]
    assert "rms relative to the noise floor" in ax.get_xlabel()
    assert [t for t in ax.get_legend_handles_labels()[1] if t.startswith("with")] == ["with payload", "with base tilt"]


@pytest.mark.parametrize("make", [none, unknown])
def test_without_an_effect_only_the_nominal_model_has_a_distance(make) -> None:
    ax = distances(make())
    assert len(xs(ax, "before")) == 3
    assert xs(ax, "after") == xs(ax, "rival") == []


def test_without_validation_the_fitted_recordings_are_shown_and_said() -> None:
    assert xs(distances(without_validation()), "before each") == [4.0, 8.0] * 2
    assert "fitted recordings, none held out" in words(gap_figure(without_validation()))
    assert "held out: 6.3 to 1.2 × noise floor" in words(gap_figure(single()))


def test_the_stretch_is_where_the_nominal_model_is_plainest_off() -> None:
    report = single()
    shown = plainest(report)
    assert shown.recording == "r2"
    part, off = window(report, shown)
    times = shown.t_s[part]
    assert times[0] < 12.0 < times[-1]
    assert 3.0 <= times[-1] - times[0] <= 10.0
    assert off > 0.5
    ax = stretch(report, shown)
    assert np.array_equal(ys(ax, "measured"), shown.measured[part])
    assert np.array_equal(ys(ax, "nominal"), shown.nominal[part])
    assert np.array_equal(ys(ax, "with effect"), shown.with_effect[part])
    assert ax.get_ylabel() == "$\\theta_{2}$ [deg]"
    below = errors(report, shown)
    assert np.allclose(ys(below, "nominal off"), shown.measured[part] - shown.nominal[part])
    assert below.get_xlabel() == "time [s]"


def test_a_healthy_machine_has_one_model_in_its_stretch() -> None:
    report = none()
    ax = stretch(report, plainest(report))
    assert {line.get_gid() for line in ax.lines} == {"measured", "nominal"}


def test_without_traces_there_is_no_stretch() -> None:
    assert len(gap_figure(replace(single(), traces=[])).axes) == 3


def test_a_short_trace_is_shown_whole() -> None:
    short = trace("r1", 1.0)
    cut = replace(short, **{k: getattr(short, k)[:100] for k in ("t_s", "measured", "nominal", "with_effect")})
    assert window(single(), cut)[0] == slice(0, 100)


def test_a_dollar_in_a_runs_name_is_no_mathematics() -> None:
    assert png(gap_figure(replace(single(), sentence="a$b$c: no gap.")))


def test_a_size_without_a_unit_says_what_it_is() -> None:
    one = Ranked("gas_law", 1.0, 0.9, (0.8, 1.0), "1", "share", quantities={"gas_law": "gas absolute share"})
    ax = hypotheses(replace(single(), ranking=[one, *single().ranking]))
    assert "gas absolute share 0.9 (0.8 to 1)" in [t.get_text() for t in ax.texts]
    assert one.to_dict()["quantities"] == {"gas_law": "gas absolute share"}
    assert one.to_dict()["unit"] == "1"
    pair = Ranked("gas_law+payload", 1.0, parts={"payload": (40.0, None, "g"), "gas_law": (0.9, None, "1")})
    pair = replace(pair, quantities={"gas_law": "gas absolute share"})
    assert [size for size, _ in pair.sizes.values()] == ["40 g", "gas absolute share 0.9"]
