"""The report's lower half: FRFs, controllers, fits, recordings, pictures, provenance, and what is missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.core.units import db
from loopshape.data.response.frf import FRF
from loopshape.toolbox.pages.markup import Content, Markup, joined, tag
from loopshape.toolbox.pages.report.run_report import Envelope, Missing, RecordingSheet
from loopshape.toolbox.pages.report.words import (
    DASH,
    Cell,
    count,
    details,
    figure,
    named,
    number,
    point,
    table,
    together,
)
from loopshape.view.labels import methods_by_loop

SPARK_WIDTH, SPARK_HEIGHT = 240, 34


def missing(parts: Sequence[Missing]) -> Markup:
    """What the run does not have, and the commands that would make it."""
    rows = [tag("li", joined([f"{one.what} ", tag("code", one.command) if one.command else None])) for one in parts]
    return joined([tag("p", "RUN stands for this run's folder."), tag("ul", *rows)])


def responses(frfs: Sequence[FRF], matrices: Sequence[FRF]) -> Markup:
    """Each FRF with its band, spread and method, and its warnings."""
    columns = [
        "recording", "loop", "valid from [Hz]", "to [Hz]", "valid frequencies", "of",
        "median std [dB]",
    ]  # fmt: skip
    rows = [_response(one) for one in frfs]
    parts: list[Content] = []
    if rows:
        parts.append(table("Frequency responses", columns, rows, sortable=len(rows) > 1))
    if matrices:
        names = ["recordings", "outputs", "inputs", "lines", "from [Hz]", "to [Hz]"]
        parts.append(table("Plants of several channels", names, [_matrix(one) for one in matrices]))
    every = [*frfs, *matrices]
    methods = [tag("li", line) for line in methods_by_loop(every)]
    parts += [tag("p", "Methods of the estimates:"), tag("ul", *methods)] if methods else []
    notes = [(one.recording, note) for one in every for note in one.notes]
    parts += [tag("p", "Notes and warnings of the estimates:"), tag("ul", *together(notes))] if notes else []
    return joined(parts)


def _response(one: FRF) -> list[Cell | Content]:
    lines = one.select(one.valid) if one.valid.any() else one
    std = lines.modulus_std[:, 0, 0]
    spread = float(db(1.0 + np.median(std)))
    low, high = one.valid_band_hz
    return [
        named(one.recording, point(one.operating_point, one.parameters)),
        one.loop,
        figure(low),
        figure(high),
        figure(float(one.valid.sum())),
        figure(float(one.frequency_hz.size)),
        figure(spread, number(spread, 3)),
    ]


def _matrix(one: FRF) -> list[Cell | Content]:
    f = one.frequency_hz
    names = ", ".join(one.recordings) or one.recording
    return [names, ", ".join(one.outputs), ", ".join(one.inputs), figure(float(f.size)), figure(f[0]), figure(f[-1])]


def recordings(sheets: Sequence[RecordingSheet], notes: Sequence[str]) -> Markup:
    """Each recording with what was done, its faults, and the shape of its signals."""
    columns = [
        "recording",
        "excitation",
        "excites",
        "injected at",
        "length [s]",
        "samples",
        "role",
        "faults",
    ]
    rows = [_recording(one) for one in sheets]
    rate = f" at {sheets[0].rate_hz:g} Hz" if sheets else ""
    parts: list[Content] = [table(f"Recordings{rate}", columns, rows, sortable=len(rows) > 1)]
    if notes:
        parts += [tag("p", "Notes of the run:"), tag("ul", *(tag("li", note) for note in notes))]
    drawn = [one for one in sheets if one.envelopes]
    if drawn:
        sheetsful = tag("div", *(_sparks(one) for one in drawn), class_="sparks")
        words = "Signals over time: the least and greatest value in each of the strip's columns"
        parts.append(
            details(
                f"{words} ({count(len(drawn), 'recording')})", sheetsful, open_=(few := len(drawn) <= 4), print_=few
            )
        )
    return joined(parts)


def _recording(one: RecordingSheet) -> list[Cell | Content]:
    info = one.info
    notes = [*one.faults, *([f"ended early: {info.ended_early}"] if info.ended_early else [])]
    faults = tag("ul", *(tag("li", words) for words in notes)) if notes else "none found"
    excites = ", ".join(info.excited) or DASH
    where = info.injection.replace("_", " ") if info.closed_loop else f"{info.injection}, loop open"
    head = named(info.name, point(info.operating_point, info.parameters))
    period = "" if info.period_s is None else f", period {number(info.period_s)} s"
    length = figure(one.samples / one.rate_hz)
    count_ = figure(float(one.samples), str(one.samples))
    cell = Cell(faults, kind="faults" if notes else None)
    return [head, f"{info.kind}{period}", excites, where, length, count_, info.role, cell]


def _sparks(one: RecordingSheet) -> Markup:
    strips = [
        tag(
            "figure",
            tag("figcaption", f"{e.column}: {number(float(e.low.min()))} … {number(float(e.high.max()))}"),
            _spark(e),
        )
        for e in one.envelopes
    ]
    return tag(
        "div", tag("h3", f"{one.info.name} ({number(one.samples / one.rate_hz)} s)"), *strips, class_="spark-sheet"
    )


def _spark(e: Envelope) -> Markup:
    low, high = float(e.low.min()), float(e.high.max())
    room = (high - low) or 1.0
    x = np.linspace(0.0, SPARK_WIDTH, e.low.size + 1)
    top = SPARK_HEIGHT - 2 - (SPARK_HEIGHT - 4) * (e.high - low) / room
    bottom = SPARK_HEIGHT - 2 - (SPARK_HEIGHT - 4) * (e.low - low) / room
    columns = (
        f"M{a:.1f} {t:.1f}H{b:.1f}V{u + 0.8:.1f}H{a:.1f}Z"
        for a, b, t, u in zip(x[:-1], x[1:], top, bottom, strict=True)
    )
    path = tag("path", d="".join(columns))
    words = f"{e.column} over time, from {number(low)} to {number(high)}"
    return tag(
        "svg", tag("title", words), path, viewBox=f"0 0 {SPARK_WIDTH} {SPARK_HEIGHT}", role="img", class_="spark"
    )
