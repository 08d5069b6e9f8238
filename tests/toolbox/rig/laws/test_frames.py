"""Frames come back as they went, whatever is around them; no bytes make the receiver err, grow or hang."""

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

import loopshape as ls
from loopshape.toolbox.rig.target.frames import LONGEST_ENCODED, Frame, Receiver, opened, stuffed, unstuffed

frames = st.builds(Frame, st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=1000))
few_zeros = st.binary(max_size=600) | st.lists(st.sampled_from([0, 1, 255]), max_size=600).map(bytes)


@given(few_zeros)
def test_stuffing_leaves_no_zero_and_can_be_undone(data):
    assert 0 not in stuffed(data)
    assert unstuffed(stuffed(data)) == data


@pytest.mark.parametrize(
    ("data", "expected"),
    [  # by hand from the rule: a length, so many minus one bytes, a zero implied but after 254 or at the end
        (b"", b"\x01"),
        (b"\0", b"\x01\x01"),
        (b"\0\0", b"\x01\x01\x01"),
        (b"\x11\x22\x00\x33", b"\x03\x11\x22\x02\x33"),
        (b"\x11\0\0\0", b"\x02\x11\x01\x01\x01"),
        (bytes([7]) * 254, b"\xff" + bytes([7]) * 254),
        (bytes([7]) * 255, b"\xff" + bytes([7]) * 254 + b"\x02\x07"),
    ],
)
def test_stuffing_by_hand(data, expected):
    assert stuffed(data) == expected


@given(st.lists(frames, max_size=4), st.integers(1, 50))
def test_frames_come_back_however_the_bytes_are_cut(sent, size):
    stream = b"".join(frame.encoded for frame in sent)
    receiver = Receiver()
    got = [frame for k in range(0, len(stream), size) for frame in receiver.take(stream[k : k + size])]
    assert got == sent
    assert receiver.bad == 0


@given(st.binary(max_size=3000), frames)
def test_after_any_garbage_the_next_frame_is_whole(garbage, frame):
    receiver = Receiver()
    list(receiver.take(garbage + b"\0"))
    assert list(receiver.take(frame.encoded)) == [frame]
    assert len(receiver._pending) == 0


@given(frames, st.data())
def test_a_changed_frame_is_dropped_and_counted(frame, data):
    encoded = bytearray(frame.encoded[:-1])
    place = data.draw(st.integers(0, len(encoded) - 1))
    encoded[place] ^= data.draw(st.integers(1, 255))
    receiver = Receiver()
    assert frame not in list(receiver.take(bytes(encoded) + b"\0"))
    assert receiver.bad >= 1


def test_what_is_too_long_is_dropped_and_does_not_grow():
    receiver = Receiver()
    for _ in range(100):
        assert list(receiver.take(b"\x07" * 997)) == []
        assert len(receiver._pending) <= LONGEST_ENCODED
    assert list(receiver.take(b"\0" + Frame(1, 2, b"x").encoded)) == [Frame(1, 2, b"x")]
    assert receiver.bad == 1


def test_the_longest_payload_fits_and_one_byte_more_is_refused():
    assert opened(Frame(1, 2, b"\1" * 1000).encoded[:-1]) == Frame(1, 2, b"\1" * 1000)
    with pytest.raises(ls.errors.WrongUseError, match="at most 1000 bytes; received 1001"):
        _ = Frame(1, 2, b"\1" * 1001).encoded


@pytest.mark.parametrize("length", [0, 1, 6])
def test_a_body_without_room_for_head_and_check_is_dropped(length):
    assert opened(stuffed(b"\1" * length)) is None


def test_the_check_is_that_of_ethernet():
    assert zlib.crc32(b"123456789") == 0xCBF43926  # the value that catalogues of CRCs give for CRC-32/ISO-HDLC
