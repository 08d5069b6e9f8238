"""Logs of Betaflight written by the format's rules (a writer of this test's own) are read back number for number."""

import numpy as np
import pytest
from run_files import CsvShape

import loopshape as ls
from loopshape.toolbox.formats.drafts.draft_map import draft_map, write_draft
from loopshape.toolbox.formats.logs.blackbox import _Bytes, _four, _three, read_blackbox
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.sources import open_source

N = 3000
NAMES = (
    "loopIteration", "time", "axisP[0]", "axisI[0]", "axisD[0]", "setpoint[0]", "setpoint[1]", "setpoint[2]",
    "setpoint[3]", "gyroADC[0]", "gyroADC[1]", "gyroADC[2]", "motor[0]", "motor[1]",
)  # fmt: skip
SIGNED = (0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0)
I_PREDICTOR, I_ENCODING = (*[0] * 12, 11, 5), (1, 1, *[0] * 10, 1, 0)
P_PREDICTOR, P_ENCODING = (6, 2, 1, 1, 1, 1, 1, 1, 1, 3, 3, 3, 3, 3), (9, 0, 7, 7, 7, 8, 8, 8, 8, 6, 6, 6, 6, 6)


def frames(seed=1):
    """A rate loop: setpoint, terms, gyro, one row a loop, whole numbers."""
    rng = np.random.default_rng(seed)
    x, table, y, integral = 150.0 * rng.standard_normal(N), np.zeros((N, 14), dtype=int), 0.0, 0.0
    for k in range(N):
        gyro = round(y)
        p, integral = round(3.0 * (x[k] - gyro)), integral + 0.02 * (x[k] - gyro)
        terms, rates = (p, round(integral), -gyro // 9), (round(x[k]), 3, -40, 1000, gyro, -2, 70)
        table[k] = (k, 36_000_000 + 500 * k, *terms, *rates, 300 + abs(p), 310)
        y = 0.9 * y + 0.03 * (p + round(integral) - gyro // 9)
    return table


def unsigned(value):
    out = bytearray()
    value &= 0xFFFFFFFF
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def signed(value):
    return unsigned((value << 1) ^ (value >> 31))


def three(values):
    """TAG2_3S32 as the firmware writes it: 2, 4 or 6 bits each, else whole bytes of their own size."""
    for bits, low in ((2, 0), (4, 0x40), (6, 0x80)):
        if all(-(1 << bits - 1) <= v < 1 << bits - 1 for v in values):
            a, b, c = (v & (1 << bits) - 1 for v in values)
            return bytes(
                [a << 4 | b << 2 | c] if bits == 2 else [low | a, b << 4 | c] if bits == 4 else [low | a, b, c]
            )
    sizes = [next(n for n in range(1, 5) if -(1 << 8 * n - 1) <= v < 1 << 8 * n - 1) for v in values]
    lead = 0xC0 | sum(size - 1 << 2 * k for k, size in enumerate(sizes))
    return bytes([lead]) + b"".join(v.to_bytes(n, "little", signed=True) for v, n in zip(values, sizes, strict=True))


def four(values):
    """TAG8_4S16 of version 2: a byte of sizes, then half bytes, the higher first."""
    tag, nibbles = 0, []
    for k, v in enumerate(values):
        size = 0 if v == 0 else 1 if -8 <= v < 8 else 2 if -128 <= v < 128 else 3
        tag |= size << 2 * k
        count = (0, 1, 2, 4)[size]
        nibbles += [v >> 4 * place & 0xF for place in range(count - 1, -1, -1)]
    nibbles += [0] * (len(nibbles) % 2)
    return bytes([tag]) + bytes(a << 4 | b for a, b in zip(nibbles[::2], nibbles[1::2], strict=True))


def eight(values):
    return bytes([sum((v != 0) << k for k, v in enumerate(values))]) + b"".join(signed(v) for v in values if v)


def intra(row):
    first = unsigned(row[0]) + unsigned(row[1])
    rest = b"".join(signed(int(v)) for v in row[2:12])
    return b"I" + first + rest + unsigned(int(row[12]) - 158) + signed(int(row[13]) - int(row[12]))


def inter(row, last, older):
    d = [int(v) for v in row - last]
    mean = [int(row[k]) - int((int(last[k]) + int(older[k])) / 2) for k in range(9, 14)]
    line = int(row[1]) - (2 * int(last[1]) - int(older[1]))
    return b"P" + signed(line) + three(d[2:5]) + four(d[5:9]) + eight(mean)


def log_of(table, every=1, scale="0x3f800000"):
    heads = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock", "Data version:2", "I interval:32",
        f"P interval:1/{every}", f"gyro_scale:{scale}", "motorOutput:158,2047", "minthrottle:1070",
        f"Field I name:{','.join(NAMES)}",
        *(f"Field {key}:{','.join(map(str, row))}" for key, row in (
            ("I signed", SIGNED), ("I predictor", I_PREDICTOR), ("I encoding", I_ENCODING),
            ("P predictor", P_PREDICTOR), ("P encoding", P_ENCODING), ("S signed", (0, 0)), ("S predictor", (0, 0)),
            ("S encoding", (1, 1)))),
        "Field S name:flightModeFlags,stateFlags",
    ]  # fmt: skip
    out, last, older = "".join(f"H {line}\n" for line in heads).encode(), None, None
    kept = []
    for k, row in enumerate(table):
        if k % 32 == 0:
            out, last, older = out + intra(row) + b"S" + unsigned(1) + unsigned(8), row, row
        elif k % 32 % every == 0:
            out, last, older = out + inter(row, last, older), row, last
        else:
            continue
        kept.append(k)
    return out + b"E\xffEnd of log\x00", kept


@pytest.mark.parametrize("every", [1, 2])
def test_each_field_of_each_frame_comes_back(every, tmp_path):
    table = frames()
    data, kept = log_of(table, every)
    (tmp_path / "a.BBL").write_bytes(data)
    source = open_source(tmp_path / "a.BBL", CsvShape())
    for k, name in enumerate(NAMES):
        if name != "time":
            np.testing.assert_array_equal(source.load(name), table[kept, k], err_msg=name)
    np.testing.assert_allclose(source.load("time of log1"), 5e-4 * np.array(kept), atol=1e-9)
    np.testing.assert_array_equal(source.load("axisSum[0]"), table[kept, 2:5].sum(axis=1))


def test_the_draft_takes_the_roll_axis_in_deg_per_second(tmp_path):
    table = frames()
    (tmp_path / "LOG00001.BFL").write_bytes(log_of(table, scale="0x3dcccccd")[0])  # 0.1 deg/s a count
    draft = draft_map(tmp_path / "LOG00001.BFL")
    assert draft.rate_hz == 2000.0
    assert draft.roles == {"setpoint[0]": "reference", "axisSum[0]": "control", "gyroADC[0]": "output"}
    write_draft(tmp_path / "m.toml", draft, tmp_path / "LOG00001.BFL")
    run = import_file(tmp_path / "LOG00001.BFL", tmp_path / "m.toml", accept_draft=True)
    np.testing.assert_allclose(run.recordings[0].column(run.loops[0].output), np.radians(0.1 * table[:, 9]), rtol=1e-6)


def test_two_logs_of_one_file_keep_their_names(tmp_path):
    (tmp_path / "a.bbl").write_bytes(log_of(frames())[0] + log_of(frames(2)[:900])[0])
    source = open_source(tmp_path / "a.bbl", CsvShape())
    assert (source.load("log1.gyroADC[0]").size, source.load("log2.gyroADC[0]").size) == (N, 900)


def test_lost_bytes_cost_their_frames_alone(tmp_path):
    table = frames()
    data, _ = log_of(table)
    at = len(data) // 2
    (tmp_path / "a.bbl").write_bytes(data[:at] + data[at + 57 :])
    source = open_source(tmp_path / "a.bbl", CsvShape())
    got, iteration = source.load("gyroADC[0]"), source.load("loopIteration").astype(int)
    assert N - 70 < got.size < N
    np.testing.assert_array_equal(got, table[iteration, 9])


def test_what_holds_no_frames_is_refused(tmp_path):
    for content in (b"", b"no log", log_of(frames())[0][:300], b"H Product:Blackbox flight\nH Field I name:a\nI"):
        (tmp_path / "a.bbl").write_bytes(content)
        with pytest.raises(ls.LoopshapeError, match="blackbox log"):
            open_source(tmp_path / "a.bbl", CsvShape())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"Field P encoding:9,", b"Field P encoding:"), (b"Field I predictor:0,", b"Field I predictor:0,0,"),
        (b"I interval:32", b"I interval:3232323232"), (b"P interval:1/1", b"P interval:0/9"),
        (b"gyro_scale:0x3f8", b"gyro_scale:0x3g8"), (b"gyro_scale:0x3f8", b"gyro_scale:0x7f8"),
        (b",time,", b",axisP[0],"),
    ],
)  # fmt: skip
def test_headers_by_which_no_frame_can_be_read_are_refused(old, new, tmp_path):
    data = log_of(frames()[:100])[0]
    assert old in data
    (tmp_path / "a.bbl").write_bytes(data.replace(old, new, 1))
    with pytest.raises(ls.LoopshapeError, match="blackbox log"):
        read_blackbox(tmp_path / "a.bbl")


@pytest.mark.timeout(60)  # s; a header can make a reader run for ever
def test_a_damaged_header_ends_in_a_sentence_or_in_signals_of_one_length(tmp_path):
    rng, data = np.random.default_rng(4), log_of(frames()[:100])[0]
    heads, refused = data.index(b"H Field S signed"), 0
    for _ in range(150):
        damaged = bytearray(data)
        at = rng.integers(heads)
        damaged[at : at + rng.integers(0, 3)] = bytes(rng.choice(list(b"0123456789,-/xaH:\n"), rng.integers(1, 4)))
        (tmp_path / "a.bbl").write_bytes(bytes(damaged))
        try:
            found = read_blackbox(tmp_path / "a.bbl")
            assert len({values.shape for values in found.values()}) == 1
        except ls.LoopshapeError:
            refused += 1
    assert 0 < refused < 150


def test_groups_of_every_size():
    rng = np.random.default_rng(3)
    for bits in (1, 3, 5, 7, 12, 22, 30):
        values = [int(v) for v in rng.integers(-(1 << bits), 1 << bits, 4)]
        assert _three(_Bytes(three(values[:3]), 0), False) == values[:3]
        if bits < 15:
            assert _four(_Bytes(four(values), 0), 2) == values
