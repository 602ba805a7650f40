"""Addresses are what they look like, and a serial port carries the same frames as UDP."""

from __future__ import annotations

import os
import select
import socket

import pytest

from mcpilco.machine import stuffed
from mcpilco.machine.link import open_link, parsed
from mcpilco.typing import EnvError, InputError


@pytest.mark.parametrize(
    ("address", "parts"),
    [
        ("udp://127.0.0.1:9000", ("udp", "127.0.0.1", 9000)),
        ("serial:///dev/ttyACM0", ("serial", "/dev/ttyACM0", 115200)),
        ("serial:///dev/ttyACM0?baud=9600", ("serial", "/dev/ttyACM0", 9600)),
    ],
)
def test_an_address_is_read(address: str, parts: tuple[str, str, int]) -> None:
    assert parsed(address) == parts


@pytest.mark.parametrize(
    "address", ["", "udp://host", "udp://host:x", "http://host:1", "serial://x", "udp://h:1/path"]
)
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="udp://HOST:PORT"):
        parsed(address)


def test_datagrams_of_others_do_not_arrive() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as machine,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        machine.bind(("127.0.0.1", 0))
        link = open_link("udp://{}:{}".format(*machine.getsockname()))
        link.send(b"hello")
        _, learner = machine.recvfrom(100)
        other.sendto(b"forged", learner)
        machine.sendto(b"welcome", learner)
        select.select([link], [], [], 5.0)
        assert list(link.receive()) == [b"welcome"]
        assert learner[0] == "127.0.0.1"
        link.close()


def test_a_serial_port_carries_frames_whatever_comes_between() -> None:
    pytest.importorskip("serial")
    machine, device = os.openpty()
    link = open_link(f"serial://{os.ttyname(device)}")
    link.send(b"\0a\0")
    assert os.read(machine, 100) == stuffed(b"\0a\0")
    os.write(machine, b"noise\0" + stuffed(b"one") + stuffed(b"\0two")[:3])
    select.select([link], [], [], 5.0)
    assert list(link.receive())[-1] == b"one"
    os.write(machine, stuffed(b"\0two")[3:])
    select.select([link], [], [], 5.0)
    assert list(link.receive()) == [b"\0two"]
    link.close()


def test_a_port_that_is_not_there_is_told() -> None:
    pytest.importorskip("serial")
    with pytest.raises(EnvError, match="Cannot open"):
        open_link("serial:///dev/no-such-port")
