"""A study's signals out to other programs: what each experiment injects and where its setpoints go, sample by sample.

<experiment>.csv    a header and a row a sample
<experiment>.mat    t and a matrix [t value] a column, as Simulink's From Workspace block takes it
<experiment>.h      C99: each column that moves as an array of float, beside rate and length
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from loopshape import __version__
from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import Array
from loopshape.data.signal.experiment import Experiment
from loopshape.io.files import make_folder, short, write_text_whole, write_whole

_A_LINE = 6  # numbers in a line of C


def export_signals(folder: Path, experiments: Sequence[Experiment], to: str) -> tuple[Path, ...]:
    """Write the signals of each experiment as "csv", "mat" or "c"; gives the files. Refuses an unknown format."""
    refuse_unknown("a format for signals is not known", to, WRITERS)
    ending, write = WRITERS[to]
    if to == "c":
        _refuse_alike([_identifier(e.name) for e in experiments])
    make_folder(folder)
    paths = []
    for e in experiments:
        path = folder / f"{e.name}{ending}"
        write(path, e)
        paths.append(path)
    return tuple(paths)


def _refuse_alike(names: Sequence[str]) -> None:
    """Two headers of one name could not be included together: the second would be passed over in silence."""
    if twice := next((name for name in names if names.count(name) > 1), ""):
        raise WrongUseError(
            "two experiments have one name in C", twice, "tell their names apart in letters from a to z and digits"
        )


def signals(e: Experiment) -> dict[str, Array]:
    """Columns (n,) of an experiment, as a run names them: time, references, and what is injected."""
    columns: dict[str, Array] = {"t_s": np.arange(e.samples) / e.rate_hz}
    for k, loop in enumerate(e.loops):
        place = loop.control if e.injection == "control" else loop.injected
        columns |= {
            name: values[:, k] for name, values in ((loop.reference, e.references), (place, e.injected)) if name
        }
    return columns


def _csv(path: Path, e: Experiment) -> None:
    columns = signals(e)
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    write_text_whole(path, "\n".join(lines) + "\n")


def _mat(path: Path, e: Experiment) -> None:
    from scipy.io import savemat

    columns = signals(e)
    t = columns.pop("t_s")
    if bad := [name for name in columns if not re.fullmatch(r"[A-Za-z]\w{0,62}", name, re.ASCII)]:
        raise WrongUseError(
            "a column's name is none that MATLAB takes", short(", ".join(bad)), "use csv, or name it in letters a to z"
        )
    data = {"t_s": t[:, None]} | {name: np.column_stack((t, values)) for name, values in columns.items()}
    words = {"rate_hz": e.rate_hz, "injection": e.injection, "made_by": f"loopshape {__version__}"}
    write_whole(path, lambda part: savemat(str(part), data | words, appendmat=False, do_compression=True))


def _c(path: Path, e: Experiment) -> None:
    write_text_whole(path, c_signals(e))


def c_signals(e: Experiment) -> str:
    """The header: columns that move as arrays, those that stand still as macros."""
    name = _identifier(e.name)
    upper = name.upper()
    still = {k: v for k, v in signals(e).items() if k != "t_s" and np.all(v == v[0])}
    moving = {k: v for k, v in signals(e).items() if k != "t_s" and k not in still}
    head = [
        f"/* Signals of experiment {e.name}, injection {e.injection}; loopshape {__version__}. */",
        f"#ifndef {upper}_SIGNALS_H", f"#define {upper}_SIGNALS_H", "",
        f"#define {upper}_RATE_HZ {float(e.rate_hz)!r}", f"#define {upper}_SAMPLES {e.samples}",
        *(f"#define {upper}_{_identifier(k).upper()} {float(v[0])!r}" for k, v in still.items()), "",
    ]  # fmt: skip
    arrays = [_array(f"{name}_{_identifier(k)}", v) for k, v in moving.items()]
    return "\n".join([*head, *arrays, "#endif", ""])


def _array(name: str, values: Array) -> str:
    if np.abs(values).max() > np.finfo(np.float32).max:
        raise WrongUseError(f"{name} does not fit in a float of C", f"{np.abs(values).max():g}", "use csv or mat")
    words = [_float(v) for v in values.astype(np.float32)]
    lines = [", ".join(words[k : k + _A_LINE]) for k in range(0, len(words), _A_LINE)]
    return f"static const float {name}[{len(words)}] = {{\n    " + ",\n    ".join(lines) + "\n};\n"


def _identifier(name: str) -> str:
    """A name in letters, digits and underscores, not beginning with a digit."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name)
    return f"x{plain}" if plain[:1].isdigit() else plain


def _float(value: np.float32) -> str:
    """The shortest decimal that reads back as the value."""
    text = str(value)
    return text + ("f" if any(c in text for c in ".en") else ".0f")


#: format -> ending of the file, and what writes it
WRITERS: dict[str, tuple[str, Callable[[Path, Experiment], None]]] = {
    "csv": (".csv", _csv),
    "mat": (".mat", _mat),
    "c": (".h", _c),
}
