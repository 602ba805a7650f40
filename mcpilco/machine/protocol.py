"""Frames between a learner and a machine, and which of them are refused.

A frame is little-endian: a header of 32 bytes, n numbers of 4 bytes (float32), a tag of 8 bytes.

    offset  type      field
    0       2 bytes   "MP"
    2       uint8     version, 1
    3       uint8     kind: 1 hello, 2 welcome, 3 command, 4 measurement
    4       uint64    session: the learner's nonce, and above 2^32 the machine's
    12      uint32    counter of the sender's frames in this session, from 1
    16      uint32    echo: the largest counter that the sender has received; of a hello 0
    20      uint64    time by the sender's clock [us]
    28      uint8     mode of a command, or status of a machine
    29      uint8     n, at most 32
    30      uint16    0
    32      float32   the n numbers
    ...     8 bytes   BLAKE2s of all before, 8 bytes long, with the key that both sides know, if any

A hello opens a session: the machine answers with a welcome, whose numbers are how many states it
measures, how many inputs it takes, and its own watchdog [s]. From then on each command, which holds
the inputs, is answered by one measurement: the states, and the inputs that act now. The frames are
datagrams of UDP; on a serial port each is stuffed (COBS) and ends with a zero byte.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections import Counter
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

VERSION = 1
MOST = 32
"""numbers in a frame"""
_HEADER = struct.Struct("<2sBBQIIQBBH")
_TAG = 8
LARGEST = _HEADER.size + 4 * MOST + _TAG
"""bytes of a frame"""
NONCE = 2**32
"""of a session: the learner's is below, the machine's is a multiple"""


class Kind(IntEnum):
    """The kinds of frames."""

    HELLO = 1
    WELCOME = 2
    COMMAND = 3
    MEASUREMENT = 4


class Mode(IntEnum):
    """The requests of a command."""

    SAFE = 0
    """the machine's own safe output, whatever the inputs"""
    RUN = 1
    """the inputs"""
    HOME = 2
    """go back to the start, by the machine's own routine"""
    STOP = 3
    """the safe output, until another session is opened"""


class Status(IntEnum):
    """The states of a machine."""

    SAFE = 0
    RUN = 1
    HOMING = 2
    STOPPED = 3
    READY = 4
    """it stands at its start, its output safe"""


class Frame(NamedTuple):
    """One message; its fields are those of the table above."""

    kind: Kind
    session: int
    counter: int
    echo: int
    time_us: int
    mode: int
    values: tuple[float, ...]


class RefusedError(ValueError):
    """A packet that is no frame of the session; the message is the word that it is counted by."""


def tag(content: bytes, key: bytes = b"") -> bytes:
    """The 8 bytes by which the receiver knows that a frame is whole, and of a sender with the key.

    Reference: RFC 7693, BLAKE2s.
    """
    return hashlib.blake2s(content, digest_size=_TAG, key=key).digest()


def encode(frame: Frame, key: bytes = b"") -> bytes:
    """The bytes of a frame."""
    head = b"MP", VERSION, *frame[:6], len(frame.values), 0
    content = _HEADER.pack(*head) + struct.pack(f"<{len(frame.values)}f", *frame.values)
    return content + tag(content, key)


def decode(packet: bytes, key: bytes = b"") -> Frame:
    """The frame in a packet.

    Raises:
        RefusedError: oversized; malformed, which is of another length, version or kind, or has
            numbers that are not finite; forged, where the tag is not of these bytes and this key.
    """
    if len(packet) > LARGEST:
        raise RefusedError("oversized")
    if len(packet) < _HEADER.size + _TAG:
        raise RefusedError("malformed")
    magic, version, kind, session, counter, echo, time_us, mode, n, zero = _HEADER.unpack_from(
        packet
    )
    right = (magic, version, zero) == (b"MP", VERSION, 0) and kind in list(Kind) and n <= MOST
    if not right or len(packet) != _HEADER.size + 4 * n + _TAG or mode > max(Status):
        raise RefusedError("malformed")
    if tag(packet[:-_TAG], key) != packet[-_TAG:]:
        raise RefusedError("forged")
    values = struct.unpack_from(f"<{n}f", packet, _HEADER.size)
    if not all(map(math.isfinite, values)):
        raise RefusedError("malformed")
    return Frame(Kind(kind), session, counter, echo, time_us, mode, values)


class Inbox:
    """The frames of one session, each once and in order; what is refused is counted."""

    def __init__(self, kind: Kind, width: int, key: bytes = b"") -> None:
        """For frames of one kind with so many numbers; no session is open."""
        self._kind, self._width, self._key = kind, width, key
        self.session: int | None = None
        self.last = 0
        """the largest counter so far"""
        self.refused: Counter[str] = Counter()
        """packets by why: oversized, malformed, forged, replayed (or overtaken by a later one)"""

    def open(self, session: int) -> None:
        """Begin a session."""
        self.session, self.last = session, 0

    def take(self, packet: bytes) -> Frame | None:
        """The frame in a packet, or None: then nothing but a count has changed."""
        try:
            frame = decode(packet, self._key)
            if frame.session != self.session:
                raise RefusedError("forged")
            if frame.kind is not self._kind or len(frame.values) != self._width:
                raise RefusedError("malformed")
            if frame.counter <= self.last:
                raise RefusedError("replayed")
        except RefusedError as error:
            self.refused[str(error)] += 1
            return None
        self.last = frame.counter
        return frame


# Serial ports -------------------------------------------------------------------------------------


def stuffed(frame: bytes) -> bytes:
    """A frame without zero bytes, and one zero behind it.

    Reference: Cheshire and Baker 1999, Consistent Overhead Byte Stuffing.
    """
    parts = frame.split(b"\0")
    assert all(len(part) < 254 for part in parts), "a frame is shorter"
    return b"".join(bytes([len(part) + 1]) + part for part in parts) + b"\0"


def unstuffed(line: bytes) -> bytes:
    """The frame in what came before a zero byte; empty where it is none."""
    parts: list[bytes] = []
    while line:
        length = line[0]
        parts.append(line[1:length])
        if len(parts[-1]) != length - 1:
            return b""
        line = line[length:]
    return b"\0".join(parts)


def lines_of(stream: bytearray) -> Iterable[bytes]:
    """Takes the whole lines from the front of a stream of bytes, and bounds what is left of it."""
    *lines, rest = bytes(stream).split(b"\0")
    stream[:] = rest[-2 * LARGEST :]
    return [line for line in lines if line]
