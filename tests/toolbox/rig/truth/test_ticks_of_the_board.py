"""Instructions of a tick on the Cortex-M4F, counted by the emulator: the page's table says them, and what fits."""

import re
import struct
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cortex_m_cases import BY_INSTRUCTIONS_ALONE, armed, board, configuration, session

from loopshape.toolbox.rig.cortex_m import NS_OF_AN_INSTRUCTION
from loopshape.toolbox.rig.target.blocks import Block
from loopshape.toolbox.rig.target.messages import Reason, Request, Response, State, rows, start_payload
from loopshape.toolbox.rig.target.scheduling import Scheduling
from loopshape.toolbox.rig.target.trial import Trial, Watch

PAGE = (Path(__file__).parents[4] / "docs" / "board.md").read_text()
ROWS = dict(re.findall(r"^\| (\d+ .*?) \| ([\d ]+) \| [\d.]+ ms \|", PAGE, re.M))
HCLK_HZ = 168e6
SECTION = np.array([[0.5, 0.2, 0.1, -0.4, 0.1]])
NODE = np.array([1.0, 0.1, 0.1, 1.0, -0.4, 0.1])


def sections(count):
    return np.repeat(SECTION, count, 0)


def schedule(loop, variables):
    """32 sections over so many variables of two knots each, which the noisy angle moves every tick."""
    at = tuple((2 + loop, 1.0 + k, (-0.5, 0.5)) for k in range(variables))
    return Scheduling(0.5, 32, at, np.tile(NODE, (2**variables * 32, 1)))


def diagram():
    """Blocks that fill the room for them."""
    return tuple(Block(tuple((j % 4, 0.1) for j in range(12)), sections(16)) for _ in range(16))


CASES = {
    "1 loop of 8": [sections(8)],
    "2 loops of 8": [sections(8)] * 2,
    "2 loops of 32": [sections(32)] * 2,
    "16 blocks": [sections(32)] * 2,
    "2 schedules": [schedule(0, 3), schedule(1, 1)],
    "8 sections on trial": [sections(8)],
}


#: a busy host lets emulated time jump past timer periods, which only adds to lateness: the best of so many counts
TRIES = 6


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_a_tick_takes_what_the_page_says(case):
    (said,) = (int(count.replace(" ", "")) for row, count in ROWS.items() if row.startswith(case))
    made = diagram() if case == "16 blocks" else ()
    for _ in range(TRIES):
        asked = configuration(*CASES[case], watchdog_ms=60_000, blocks=made)
        found, status = watched(replace(asked, trial=Trial(0, sections(8), 0.01)) if "trial" in case else asked)
        if found.longest >= HCLK_HZ / 1000.0 or found.latest < 168 * 150:
            break
    instructions = found.longest * 1e9 / (HCLK_HZ * NS_OF_AN_INSTRUCTION)
    print(f"{case}: {instructions:.0f} instructions, a tick begins up to {found.latest / 168:.0f} us late")
    assert instructions == pytest.approx(said, rel=0.05)
    if found.longest < HCLK_HZ / 1000.0:
        assert status.state is State.ARMED
        assert found.latest < 168 * 150
    else:
        assert (status.state, status.fault) == (State.FAULT, Reason.MACHINE)


def watched(asked):
    """What 200 ticks take at 1 kHz, and how the board stands then."""
    with board(*BY_INSTRUCTIONS_ALONE, rate_hz=1000.0) as (port, monitor), session(port) as one:
        armed(one, asked)
        if asked.trial:
            one.ask(Request.BLEND, Watch(0.5, 100, 10**6, 50, 1.0, -1.0, 1.0, 1.0, 2.0).payload())
        begun = monitor.watched().ticks
        while (found := monitor.watched()).ticks < begun + 200:
            time.sleep(0.01)
        return found, one.status()


@pytest.mark.long
@pytest.mark.parametrize(("frames_come", "late_ms"), [(False, 0.03), (True, 0.4)])
def test_a_tick_begins_no_later_than_the_page_says(frames_come, late_ms):
    """Armed, at 5 kHz, two loops of 8 sections: while samples are sent, and while full frames come from the host."""
    late = []
    while len(late) < TRIES and (not late or late[-1] > late_ms):
        late.append(latest_ms(frames_come))
    print(f"a tick begins up to {late[-1]:.3f} ms late")
    assert min(late) <= late_ms


def latest_ms(frames_come):
    """How late a tick begins at most, from the arming to the end of a recording."""
    with board(*BY_INSTRUCTIONS_ALONE, rate_hz=5000.0) as (port, monitor), session(port) as one:
        armed(one, configuration(*CASES["2 loops of 8"], watchdog_ms=60_000))
        one.ask(Request.BEGIN, start_payload(1, 2000, 0, 2 if frames_come else 0, 0, False))
        for first in range(0, 960 if frames_come else 0, 240):
            one.ask(Request.ROWS, rows(1, first, np.zeros((240, 1)), "<f4"))
        ends = []
        one.unasked = lambda frame: frame.type == Response.ENDED and ends.append(one.ended(frame))
        one.ask(Request.GO, struct.pack("<I", 1))
        while not ends:
            one.listen(0.1)
        found = monitor.watched()
    assert ends[0].ticks == (960 if frames_come else 2000)
    return found.latest / 168e3


def test_the_worst_case_of_sections_fits_where_the_page_says():
    """The table's own arithmetic."""
    for row, fits in re.findall(r"^\| (\d+ .*?) \| [\d ]+ \| [\d.]+ ms \| ([\d.]+) kHz", PAGE, re.M):
        ns = int(ROWS[row].replace(" ", "")) * NS_OF_AN_INSTRUCTION
        assert float(fits) * 1e3 <= 1.02e9 / ns, row
