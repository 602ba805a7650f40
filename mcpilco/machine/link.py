"""Links to a machine: datagrams of UDP, or a serial port."""

from __future__ import annotations

import contextlib
import socket
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any
from urllib.parse import parse_qs, urlsplit

from mcpilco.machine.protocol import LARGEST, lines_of, stuffed, unstuffed
from mcpilco.typing import EnvError, InputError

BAUD = 115200
"""of a serial port where the address names none"""


class Link(ABC):
    """Carries packets; never waits."""

    @abstractmethod
    def fileno(self) -> int:
        """To be waited for."""

    @abstractmethod
    def send(self, packet: bytes) -> None:
        """Send one; where that is not possible now it is lost."""

    @abstractmethod
    def receive(self) -> Iterable[bytes]:
        """All that have come."""

    @abstractmethod
    def close(self) -> None:
        """Give it back."""


class Udp(Link):
    """Datagrams to and from one address: those of others do not arrive."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((host, port))

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, packet: bytes) -> None:
        with contextlib.suppress(OSError):  # nobody listens there now
            self._socket.send(packet)

    def receive(self) -> Iterable[bytes]:
        packets: list[bytes] = []
        while len(packets) < 1000:
            try:
                packets.append(self._socket.recv(LARGEST + 1))
            except BlockingIOError:
                break
            except OSError:  # nobody listened when the last one was sent
                continue
        return packets

    def close(self) -> None:
        self._socket.close()


class Serial(Link):
    """Lines on a serial port, by pyserial."""

    def __init__(self, path: str, baud: int) -> None:
        import serial

        self._port: Any = serial.Serial(path, baud, timeout=0, write_timeout=0)
        self._stream = bytearray()

    def fileno(self) -> int:
        return self._port.fileno()

    def send(self, packet: bytes) -> None:
        with contextlib.suppress(OSError):
            self._port.write(stuffed(packet))

    def receive(self) -> Iterable[bytes]:
        with contextlib.suppress(OSError):  # it was unplugged: the machine is silent
            self._stream += self._port.read(4096)
        return [unstuffed(line) for line in lines_of(self._stream)]

    def close(self) -> None:
        self._port.close()


def parsed(address: str) -> tuple[str, str, int]:
    """Scheme, host or device, and port or baud rate of an address.

    Raises:
        InputError: it is none.
    """
    with contextlib.suppress(ValueError):
        parts = urlsplit(address)
        if parts.scheme == "udp" and parts.hostname and parts.port and not parts.path.strip("/"):
            return "udp", parts.hostname, parts.port
        if parts.scheme == "serial" and parts.path and not parts.netloc:
            return "serial", parts.path, int(parse_qs(parts.query).get("baud", [str(BAUD)])[0])
    raise InputError(
        "--machine must be udp://HOST:PORT or serial:///dev/NAME?baud=115200, "
        f"got {address!r}; type the address of your machine."
    )


def open_link(address: str) -> Link:
    """The link to a machine.

    Raises:
        InputError: the address is none.
        EnvError: it cannot be opened.
    """
    scheme, where, number = parsed(address)
    try:
        return Udp(where, number) if scheme == "udp" else Serial(where, number)
    except ImportError:
        raise InputError(
            "A serial port needs pyserial: pip install mcpilco[machine]; or use udp://HOST:PORT."
        ) from None
    except (OSError, ValueError) as error:
        raise EnvError(f"Cannot open {address}: {error}; check name, cable and rights.") from None
