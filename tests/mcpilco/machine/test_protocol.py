"""Frames go through unchanged; whatever else comes changes nothing and is counted."""

from __future__ import annotations

import random
import struct
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.machine import (
    LARGEST,
    Frame,
    Inbox,
    Kind,
    RefusedError,
    decode,
    encode,
    stuffed,
    unstuffed,
)

FRAME = Frame(Kind.MEASUREMENT, 7 | 9 << 32, 3, 2, 1_000_000, 1, (0.5, -1.0, 2.0))
SMALL = st.integers(0, 2**32 - 1)


@given(
    st.sampled_from(Kind),
    st.integers(0, 2**64 - 1),
    SMALL,
    SMALL,
    st.integers(0, 2**64 - 1),
    st.integers(0, 4),
    st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), max_size=32),
    st.binary(max_size=32),
)
def test_a_frame_comes_out_as_it_went_in(kind, session, counter, echo, time, mode, values, key):
    frame = Frame(kind, session, counter, echo, time, mode, tuple(values))
    packet = encode(frame, key)
    assert len(packet) <= LARGEST
    assert decode(packet, key) == frame


def test_the_layout_is_the_one_of_the_page() -> None:
    packet = encode(FRAME)
    assert len(packet) == 32 + 3 * 4 + 8
    assert packet[:4] == b"MP\x01\x04"
    assert struct.unpack_from("<QIIQBB", packet, 4) == (7 | 9 << 32, 3, 2, 1_000_000, 1, 3)
    assert struct.unpack_from("<3f", packet, 32) == FRAME.values


@given(st.binary(max_size=200))
def test_stuffing_leaves_no_zero_but_the_last_and_is_undone(content: bytes) -> None:
    line = stuffed(content)
    assert line.index(0) == len(line) - 1
    assert unstuffed(line[:-1]) == content


@given(st.binary(max_size=LARGEST + 20))
def test_a_line_of_noise_makes_no_frame(line: bytes) -> None:
    with pytest.raises(RefusedError):
        decode(unstuffed(line.replace(b"\0", b"")))


# What is refused ----------------------------------------------------------------------------------


def inbox(key: bytes = b"") -> Inbox:
    made = Inbox(Kind.MEASUREMENT, 3, key)
    made.open(FRAME.session)
    return made


def test_a_frame_is_taken_once() -> None:
    box = inbox()
    assert box.take(encode(FRAME)) == FRAME
    assert box.take(encode(FRAME)) is None
    assert box.take(encode(FRAME._replace(counter=2))) is None
    assert dict(box.refused) == {"replayed": 2}


def test_a_frame_of_an_earlier_session_is_refused() -> None:
    box = inbox()
    box.open(FRAME.session + 1)
    assert box.take(encode(FRAME)) is None
    assert dict(box.refused) == {"forged": 1}


def test_who_does_not_know_the_key_is_refused() -> None:
    box = inbox(b"secret")
    assert box.take(encode(FRAME)) is None
    assert box.take(encode(FRAME, b"other")) is None
    assert dict(box.refused) == {"forged": 2}
    assert box.take(encode(FRAME, b"secret")) == FRAME


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_that_are_not_finite_are_refused(value: float) -> None:
    box = inbox()
    assert box.take(encode(FRAME._replace(values=(0.0, value, 0.0)))) is None
    assert dict(box.refused) == {"malformed": 1}


class Fuzz(NamedTuple):
    """A packet that is none, by the word that it must be counted by."""

    word: str
    packet: bytes


def fuzzed(rng: random.Random, count: int, key: bytes = b"") -> list[Fuzz]:
    """Packets of every kind that must change nothing of an inbox that has taken FRAME."""
    good = encode(FRAME._replace(counter=10**6), key)

    def forged() -> bytes:
        packet = bytearray(good)
        packet[rng.randrange(4, 29)] ^= 1 << rng.randrange(8)  # within the fields that are free
        return bytes(packet)

    makers = {
        "oversized": lambda: good + rng.randbytes(rng.randrange(LARGEST - len(good) + 1, 2000)),
        "malformed": lambda: good[: rng.randrange(len(good))],
        "forged": forged,
        "replayed": lambda: encode(FRAME._replace(counter=rng.randrange(FRAME.counter + 1)), key),
    }
    words = [rng.choice(list(makers)) for _ in range(count)]
    return [Fuzz(word, makers[word]()) for word in words]


def test_fuzzed_packets_change_nothing_and_are_counted() -> None:
    box = inbox()
    box.take(encode(FRAME))
    packets = fuzzed(random.Random(0), 2000)
    for number, (word, packet) in enumerate(packets, start=1):
        if word == "forged" and packet[28] > 4:
            word = "malformed"
        before = box.refused[word]
        assert box.take(packet) is None
        assert (box.session, box.last) == (FRAME.session, FRAME.counter)
        assert (box.refused[word], box.refused.total()) == (before + 1, number)
    assert box.take(encode(FRAME._replace(counter=4))) is not None
