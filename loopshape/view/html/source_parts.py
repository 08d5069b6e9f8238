"""What the report carries over and where it comes from: pictures, versions, inputs by SHA-256, files verbatim."""

from __future__ import annotations

from base64 import b64encode

from loopshape.data.result.run_report import RunReport, StoredFigure
from loopshape.view.html.markup import Content, Markup, joined, tag
from loopshape.view.html.words import Cell, count, definitions, details, figure, table

#: beginning of a picture's file name -> what it shows
_PICTURES = {
    "nichols": "Nichols plot of the open loop at all operating points",
    "loop": "Plant, controller and open loop with |S| and |T|",
    "sensitivities": "|S|, |T|, |CS| and |PS| with their limits",
    "margins": "Map of the margins over the operating points",
    "frf": "Frequency response with its uncertainty",
    "fit": "Fitted parameter over the operating points",
    "matrix": "Matrix of frequency responses",
    "interaction": "Interaction of the loops",
    "gap": "Gap between recordings and simulation",
    "step": "Step response",
    "atlas": "Sensitivity over the operating points",
}


def alt_text(name: str) -> str:
    """What a picture shows, from its file's name: `nichols_axis.png`."""
    stem = name.rsplit(".", 1)[0]
    kind, _, rest = stem.partition("_")
    return f"{_PICTURES.get(kind, f'Picture {stem}')}{f': {rest}' if rest and kind in _PICTURES else ''}"


def pictures(report: RunReport) -> Markup:
    """The pictures found in the run, those of single recordings folded away, and what was left out."""
    single = {f"frf_{one.loop}_{one.recording}" for one in report.frfs}
    shown = [one for one in report.figures if one.name.rsplit(".", 1)[0] not in single]
    pages = [one for one in report.figures if one.name.rsplit(".", 1)[0] in single]
    words = (
        "These lay in the run's folder figures as earlier commands left them, and may be older than the data. The plots"
        " and tables above are made from the data listed under provenance."
    )
    parts: list[Content] = [tag("p", words, class_="quiet"), tag("div", *map(_picture, shown), class_="pictures")]
    if pages:
        inside = tag("div", *map(_picture, pages), class_="pictures")
        parts.append(details(f"Pages of single recordings ({len(pages)})", inside, print_=len(pages) <= 4))
    if report.figures_left_out:
        left = [tag("li", f"{name}: {why}") for name, why in report.figures_left_out.items()]
        parts += [tag("p", "Left out:"), tag("ul", *left)]
    return joined(parts)


def _picture(one: StoredFigure) -> Markup:
    kind = {"png": "image/png", "svg": "image/svg+xml"}[one.kind]
    source = f"data:{kind};base64,{b64encode(one.data).decode('ascii')}"
    words = alt_text(one.name)
    image = tag("img", src=Markup(source), alt=words)
    return tag("figure", image, tag("figcaption", f"{words} ({one.name})"))


def provenance(report: RunReport) -> Markup:
    """Who computed when from what: versions, date, every input with its SHA-256, and the files of words verbatim."""
    facts: list[tuple[Content, Content]] = [("Made", report.date), ("Run", report.name)]
    if report.run is not None and report.run.plant:
        facts.append(("Plant", report.run.plant))
    facts += [(name, version) for name, version in report.versions.items()]
    rows: list[list[Cell | Content]] = [
        [
            one.name,
            figure(float(one.size_bytes), f"{one.size_bytes:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")),
            tag("code", one.sha256),
        ]
        for one in report.files
    ]
    parts: list[Content] = [definitions(facts)]
    inputs = table(f"Inputs ({count(len(rows), 'file')})", ["file", "bytes", "SHA-256"], rows)
    parts.append(
        details(
            f"Inputs and their SHA-256 ({count(len(rows), 'file')})", inputs, open_=(few := len(rows) <= 20), print_=few
        )
    )
    for one in report.texts:
        shown = tag("pre", tag("code", one.text), tabindex="0", aria_label=f"{one.what} {one.name}")
        parts.append(
            details(f"{one.what}: {one.name}, verbatim", shown, open_=(given := one.what != "run"), print_=given)
        )
    return joined(parts)
