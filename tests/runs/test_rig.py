"""The sketch for a microcontroller speaks the protocol, and the tables of the rig are drawn."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import tty
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import envs  # noqa: F401  registers the simulation
from mcpilco.machine import MACHINE, Kind, Mode, encode, meeting, stuffed
from mcpilco.machine.protocol import Frame

SKETCH = Path(__file__).parents[2] / "runs" / "rig" / "sketch"


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sketch, compiled with a stub of its hardware."""
    if shutil.which("g++") is None:
        pytest.skip("needs g++")
    program = tmp_path_factory.mktemp("board") / "sketch"
    strict = ["-std=c++11", "-O1", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["g++", *strict, "-o", program, SKETCH / "sketch_test.cpp"], check=True)
    return program


@pytest.mark.slow
def test_the_sketch_is_a_machine_at_a_serial_port(board: Path, tmp_path: Path) -> None:
    pytest.importorskip("serial")
    line, device = os.openpty()
    tty.setraw(line)
    tty.setraw(device)
    with subprocess.Popen([board], stdin=line, stdout=line) as sketch:
        address = f"serial://{os.ttyname(device)}"
        simulation = {"simulation": "mcpilco/CartPoleSwingUp-v0", "dt": 0.05}
        with meeting(address, log=tmp_path):
            patient = {"watchdog": 2.0, "silence": 2.0}
            with contextlib.closing(gym.make(MACHINE, **simulation, **patient)) as env:
                os.write(line, b"noise\0" + os.urandom(40).replace(b"\0", b"") + b"\0")
                first, _ = env.reset()
                assert np.abs(first).max() < 0.05
                for _ in range(10):
                    observed, *_ = env.step(np.array([2.0]))
                assert observed[0] > 0.02
                env.reset()
        sketch.kill()
    rows = np.loadtxt(tmp_path / "episode-0000.csv", delimiter=",", skiprows=1)
    assert rows[-1, -1] == pytest.approx(2.0)


def test_what_is_no_frame_gets_no_answer_from_the_sketch(board: Path) -> None:
    hello = encode(Frame(Kind.HELLO, 5, 1, 0, 0, Mode.SAFE, ()))
    forged = encode(Frame(Kind.HELLO, 5, 1, 0, 0, Mode.SAFE, ()), b"another key")
    command = encode(Frame(Kind.COMMAND, 5 | 1 << 32, 1, 0, 0, Mode.RUN, (1.0,)))
    noise = [forged, command, hello[:-1], hello + b"\1", b"\1" * 300, b"MP\1\1"]
    sent = b"".join(stuffed(packet) if len(packet) < 250 else packet + b"\0" for packet in noise)
    done = subprocess.run([board], input=sent, capture_output=True, timeout=60, check=True)
    assert done.stdout == b""
    done = subprocess.run([board], input=sent + stuffed(hello), capture_output=True, check=True)
    assert done.stdout.count(b"\0") == 1
