"""Damaged and lying files: how the tests that break readers change bytes and words, and what they hold them to."""

import os
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

import loopshape as ls

#: names that lead out of a folder, or that no file can have
NAMES = (
    "../outside.parquet", "/etc/hostname", "..", ".", "", " ", "a/b.parquet", "a\\b.parquet", "C:a.parquet", "a\0.csv",
    "a\n.parquet", "~", "~/a.parquet", ".hidden.parquet", "x" * 250 + ".parquet", "é" * 190 + ".parquet", "x" * 5000,
    "a.b.c.parquet", "名前.parquet", "a\u202eb.parquet", "\ufeffa", "run.toml", "-rf", "$(x)", "%s%n", "a b.parquet",
    "link.parquet", "folder.parquet", "CON", "frf",
)  # fmt: skip
NUMBERS = (
    0, -1, 1, 2**31, 2**63 - 1, 2**63, -(2**63), 10**300, 10**400, 0.0, -0.0, 1e-320, 1e-300, 1e300, 1.7e308, -1e308,
    float("nan"), float("inf"), float("-inf"), 1e-9, 0.5, 3.0,
)  # fmt: skip

names = st.one_of(st.sampled_from(NAMES), st.text(max_size=12))
leaves = st.one_of(
    st.sampled_from(NUMBERS), names, st.booleans(), st.dates(), st.datetimes(), st.integers(), st.floats(),
)  # fmt: skip
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3), max_leaves=6
)


def places(table, path=()):
    """Every place in nested tables and lists, as the keys that lead there."""
    inner = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in inner:
        yield (*path, key)
        yield from places(value, (*path, key))


def changed(table, place, value):
    """A copy with another value at a place; None takes it out."""
    copy = dict(table) if isinstance(table, dict) else list(table)
    key, *rest = place
    if rest:
        copy[key] = changed(copy[key], rest, value)
    elif value is None:
        del copy[key]
    else:
        copy[key] = value
    return copy


@st.composite
def tables(draw, whole):
    """A valid file's table with one to three values replaced, removed or added."""
    table = whole
    for _ in range(draw(st.integers(1, 3))):
        there = list(places(table))
        place = draw(st.sampled_from(there)) if there else ()
        kind = draw(st.integers(0, 9))
        if not place:
            return table
        if kind == 0:
            table = changed(table, place, None)
        elif kind == 1:
            table = {**table, draw(names): draw(values)}
        else:
            table = changed(table, place, draw(values))
    return table


@st.composite
def damaged(draw, content):
    """Bytes of a file with some changed, cut out, doubled, or its end gone."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        kind = draw(st.integers(0, 5))
        if kind == 0:
            del data[at:]
        elif kind == 1:
            data[at : at + draw(st.integers(1, 16))] = b""
        elif kind == 2:
            data[at:at] = draw(st.binary(min_size=1, max_size=16))
        elif kind == 3 and data:
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == 4:  # a length that lies
            data[at : at + 4] = draw(
                st.sampled_from([b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\0\x80"])
            )
        elif data:
            data[at] = draw(st.integers(0, 255))
    return bytes(data)


def said(work):
    """Do it; gives the sentence that it ends in, "" for none. Whatever else it raises is the test's."""
    with np.errstate(all="ignore"):
        try:
            work()
        except ls.LoopshapeError as error:
            sentence = str(error)
            assert "\n" not in sentence, sentence
            assert len(sentence) < 3000, len(sentence)
            assert sentence.endswith(".")
            return sentence
    return ""


def tree(folder):
    """Every file below a folder, with its content and when it was written."""
    return {
        str(Path(top) / name): ((path := Path(top) / name).lstat().st_mtime_ns, path.lstat().st_size)
        for top, _, files in os.walk(folder)
        for name in files
    }
