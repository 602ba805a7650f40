"""The process that keeps a machine's time: commands, watchdog, limits, emergency stop and log.

A learner starts it and talks to it through a socket, in messages of JSON, so that nothing that the
learner computes delays a command. Time is that of the monotonic clock [s]. When the learner is
gone, the machine gets its safe command and the process ends.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import secrets
import select
import signal
import socket
import sys
import termios
import time
import tty
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from mcpilco.machine.link import Link, open_link
from mcpilco.machine.protocol import (
    NONCE,
    Frame,
    Inbox,
    Kind,
    Mode,
    RefusedError,
    Status,
    decode,
    encode,
)
from mcpilco.typing import McPilcoError

STOP_KEY = b" "
"""stops the machine where the process has a terminal"""
GREETING_S = 0.2
"""between two hellos [s]"""
GRACE = 0.25
"""share of a period for which a step waits for a measurement of its own"""
DRIFT = 2e-4
"""rate at which the two clocks may drift apart [-]"""
SEEN, CONFIRMING = 5, 3
"""measurements before one that can confirm it, and how many must: two false ones in a row agree by
chance now and then, and an episode that begins with a false one refuses all true ones"""


class Loop:
    """One machine, from the greeting to the end of the learner."""

    def __init__(self, told: dict[str, Any], link: Link, learner: socket.socket) -> None:
        self.told, self.link, self.learner = told, link, learner
        self.key = bytes.fromhex(told["key"])
        self.h = 1.0 / told["rate"]
        """period of commands [s]"""
        self.states, self.inputs = len(told["states"]), len(told["safe"])
        self.inbox = Inbox(Kind.MEASUREMENT, self.states + self.inputs, self.key)
        self.counts: Counter[str] = Counter()
        self.counter = 0
        self.mode, self.command = Mode.SAFE, list(told["safe"])
        self.stopped = self.gone = False
        self.offset = 0.0
        """our clock less the machine's [s]"""
        self.log: TextIO | None = None
        self.sample: list[float] | None = None
        """the newest measurement that is credible, and its `stamp` by the machine's clock [s]"""
        self.stamp, self.answered = 0.0, 0
        self.seen: deque[tuple[list[float], float]] = deque(maxlen=SEEN)
        """the measurements before, credible or not, and their times by the machine's clock [s]"""
        self.status = int(Status.SAFE)
        self.episode: float | None = None
        """when the episode began; `step` of it began at `due` [s]"""
        self.homing: float | None = None
        """when the machine must be back at its start [s]"""
        self.unanswered: float | None = None
        """since when a command is waited for [s]"""
        self.asked: int | None = None
        """command whose answer the step waits for"""
        self.began: float | None = None
        self.ready, self.worst = False, 0.0
        self.path: list[list[float]] = []
        self._over()

    # The link -------------------------------------------------------------------------------------

    def greet(self) -> None:
        """Open a session; McPilcoError where the machine does not answer, or is another one."""
        nonce, until = secrets.randbelow(NONCE), time.monotonic() + self.told["patience"]
        while time.monotonic() < until and not self.gone:
            hello = Frame(Kind.HELLO, nonce, 1, 0, _micros(), Mode.SAFE, ())
            self.link.send(encode(hello, self.key))
            for packet in self._packets(time.monotonic() + GREETING_S):
                with contextlib.suppress(RefusedError):
                    frame = decode(packet, self.key)
                    if frame.kind is Kind.WELCOME and frame.session % NONCE == nonce:
                        return self._welcomed(frame)
        raise McPilcoError(
            f"No machine answers at {self.told['address']} within {self.told['patience']:g} s; "
            "start it, or check address, cable and key. One that was left without a goodbye "
            "answers after its own watchdog."
        )

    def _welcomed(self, frame: Frame) -> None:
        widths = tuple(round(value) for value in frame.values[:2])
        if widths != (self.states, self.inputs):
            raise McPilcoError(
                f"The machine at {self.told['address']} expected to measure "
                f"{', '.join(self.told['states'])} and to take {self.inputs} inputs, says that it "
                f"has {widths} of them; name the simulation of this machine."
            )
        self.inbox.open(frame.session)
        self.counter, self.offset = 0, time.monotonic() - 1e-6 * frame.time_us
        self.heard = self.trusted = time.monotonic()
        self.sample = None
        self.seen.clear()

    def _packets(self, until: float) -> list[bytes]:
        """Those of the link, once there are some; learner and keys are served too."""
        waits = [self.link, self.learner, *self.told["keys"]]
        ready, _, _ = select.select(waits, [], [], max(until - time.monotonic(), 0.0))
        if self.learner in ready:
            self._hear_learner()
        if any(key in ready for key in self.told["keys"]) and STOP_KEY in os.read(0, 64):
            self.stop()
        return list(self.link.receive()) if self.link in ready else []

    def send(self) -> None:
        """The command that holds now."""
        self.counter += 1
        mode = Mode.STOP if self.stopped else self.mode
        session, echo = self.inbox.session or 0, self.inbox.last
        frame = Frame(
            Kind.COMMAND, session, self.counter, echo, _micros(), mode, tuple(self.command)
        )
        self.link.send(encode(frame, self.key))

    def stop(self, *_: object) -> None:
        """Emergency stop: the machine is safe until the learner comes back with a new process."""
        self.stopped = True
        for _again in range(3):
            self.send()

    # Measurements ---------------------------------------------------------------------------------

    def _measured(self, packet: bytes) -> None:
        last, frame = self.inbox.last, self.inbox.take(packet)
        if frame is None:
            return
        now, stamp = time.monotonic(), 1e-6 * frame.time_us
        self.counts["lost"] += frame.counter - last - 1
        elapsed, self.heard = now - self.heard, now
        self.status = frame.mode
        self.offset = min(self.offset + DRIFT * elapsed, now - stamp)
        if now - stamp - self.offset > self.h:
            self.counts["late"] += 1
        values = list(frame.values[: self.states])
        if not self._credible(values, stamp):
            return
        self.trusted, self.sample, self.stamp = now, values, stamp
        self.answered = frame.echo
        if self.episode is not None:
            self.path.append(values)
            self._write(stamp, frame.values)
            if why := self._beyond(values):
                self.end(why, kind="limit")

    def _credible(self, values: list[float], stamp: float) -> bool:
        """Whether each position has moved as its velocity says.

        Moved from the newest credible measurement; while there is none, and while the machine is
        brought to its start, from `CONFIRMING` of the measurements before.
        """
        if self.sample is not None and self.mode is not Mode.HOME:
            credible = self._follows(values, stamp, self.sample, self.stamp)
        else:
            confirming = sum(self._follows(values, stamp, *before) for before in self.seen)
            credible = confirming >= CONFIRMING
            self.seen.append((values, stamp))
        self.counts["jumps"] += not credible and self.sample is not None
        return credible

    def _follows(self, values: list[float], stamp: float, sample: list[float], then: float) -> bool:
        return all(
            abs(values[q] - sample[q] - 0.5 * (values[v] + sample[v]) * (stamp - then))
            <= self.told["jump"]
            for q, v in self.told["pairs"]
        )

    def _beyond(self, values: list[float]) -> str | None:
        for name, (low, high) in self.told["limits"].items():
            value = values[self.told["states"].index(name)]
            if not low <= value <= high:
                return f"{name} was {value:.4g}, beyond its limits {low:g} to {high:g}"
        return None

    def _write(self, stamp: float, values: tuple[float, ...]) -> None:
        if self.log is not None:
            self.began = stamp if self.began is None else self.began
            cells = (stamp - self.began, *values)
            self.log.write(",".join(f"{cell:.7g}" for cell in cells) + "\n")

    # Episodes -------------------------------------------------------------------------------------

    def _hear_learner(self) -> None:
        try:
            message = self.learner.recv(65536)
        except OSError:
            message = b""
        if not message:
            self.gone = True
            return
        told = json.loads(message)
        getattr(self, f"_on_{told.pop('do')}")(**told)

    def _on_begin(self, ticks: int, log: str | None) -> None:
        """Bring the machine to its start; an episode begins with the first command after that."""
        self._over()
        self.ticks, self.wanted = ticks, log
        self.homing = time.monotonic() + self.told["homing"]
        self.mode, self.command = Mode.HOME, list(self.told["safe"])
        self.sample = None
        self.seen.clear()
        self.status = Status.SAFE

    def _on_act(self, step: int, inputs: list[float]) -> None:
        now = time.monotonic()
        if not self.ready or self.stopped:
            return
        if self.episode is None:
            self.episode, self.step, self.due = now, 0, now
            self.mode, self.path, self.tick = Mode.RUN, [], now + self.h
            self._open_log()
            urge(self.told["thread"], 1)
        self.worst = max(self.worst, now - self.episode - step * self.ticks * self.h)
        if now >= self.episode + (step + 1) * self.ticks * self.h:
            self.counts["missed"] += 1
        if step == self.step:
            self.command, self.unanswered = inputs, None
            self.send()

    def _on_end(self) -> None:
        self._over()

    def _over(self) -> None:
        """No episode: the safe command, and a learner that learns is not urgent."""
        urge(self.told["thread"], 0)
        self.mode, self.command = Mode.SAFE, list(self.told["safe"])
        self.episode = self.homing = self.unanswered = self.asked = self.began = None
        self.ready, self.worst, self.path = False, 0.0, []
        if self.log is not None:
            self.log.close()
            self.log = None

    def _open_log(self) -> None:
        if self.wanted is not None:
            # a line at a time, so that who kills this process loses none
            self.log = Path(self.wanted).open("x", 1, encoding="utf-8")  # noqa: SIM115
            self.log.write(",".join(("time", *self.told["states"], *self.told["names"])) + "\n")

    def end(self, why: str, kind: str) -> None:
        """The safe command at once; then the learner is told."""
        sample = self.sample or [0.0] * self.states
        worst = self.worst
        path = self.path
        self._over()
        self.send()
        self.counts[kind] += 1
        self._tell(kind, why=why, values=sample, path=path, worst=worst)

    def _tell(self, what: str, **about: Any) -> None:
        counts = dict(self.counts + self.inbox.refused)
        with contextlib.suppress(OSError):
            self.learner.send(json.dumps({"is": what, "counts": counts, **about}).encode())

    def _serve_step(self, now: float) -> None:
        """Hand out the measurement of a step, its own or the newest."""
        own = self.asked is not None and self.answered >= self.asked
        if self.asked is None or not (own or now > self.due + GRACE * self.h):
            return
        age = max(self.due - (self.stamp + self.offset), 0.0)
        values = list(self.sample or ())
        for q, v in self.told["pairs"]:
            values[q] += values[v] * age
        self.asked, path = None, self.path
        self.path = []
        if not own:
            self.counts["stale"] += 1
        self._tell("step", values=values, path=path, age=age, worst=self.worst)

    # The loop -------------------------------------------------------------------------------------

    def run(self) -> None:
        """Until the learner is gone."""
        self.tick = time.monotonic()
        """when the next command goes out"""
        parent = os.getppid()
        while not self.gone and os.getppid() == parent:
            until = min(self.tick, *self._alarms())
            for packet in self._packets(until):
                self._measured(packet)
            now = time.monotonic()
            self._guard(now)
            if now >= self.tick:
                behind = int((now - self.tick) / self.h)
                self.counts["ticks"] += 1
                self.counts["late ticks"] += behind
                self.tick += self.h * (behind + 1)
                self._advance(now)
                self.send()
            if self.homing is not None:
                self._home(now)
            self._serve_step(now)
        self._over()
        for mode in (Mode.SAFE, Mode.SAFE, Mode.STOP):
            self.mode = mode
            self.send()

    def _alarms(self) -> Iterator[float]:
        if self.unanswered is not None:
            yield self.unanswered + self.told["watchdog"]
        if self.asked is not None:
            yield self.due + GRACE * self.h
        yield time.monotonic() + 1.0

    def _advance(self, now: float) -> None:
        """To the next step, where it is due: its measurement is asked for."""
        if self.episode is None:
            return
        step = int((now - self.episode) / (self.ticks * self.h) + 1e-6)
        while self.step < step:
            self._serve_step(now + 1.0)  # of the step before, if it still waits
            self.step += 1
            self.due = self.episode + self.step * self.ticks * self.h
            self.asked = self.counter + 1
            self.unanswered = self.due if self.unanswered is None else self.unanswered

    def _guard(self, now: float) -> None:
        """End what has gone wrong."""
        if self.stopped:
            if self.episode is not None or self.homing is not None:
                self.end("it was stopped by hand", kind="stopped")
        elif self.unanswered is not None and now > self.unanswered + self.told["watchdog"]:
            self.worst = max(self.worst, now - self.unanswered)
            late = f"no command came within the watchdog's {self.told['watchdog']:g} s"
            self.end(late, kind="watchdog")
        elif self.episode is not None and now - self.heard > self.told["silence"]:
            self.end(f"the machine was silent for {self.told['silence']:g} s", kind="silent")
        elif self.episode is not None and now - self.trusted > self.told["silence"]:
            self.end("a sensor jumped, and did not come back", kind="jumped")
        elif self.episode is not None and self.status == Status.STOPPED:
            self.end("the machine has stopped itself", kind="halted")

    def _home(self, now: float) -> None:
        newest = self.sample is not None and self.trusted == self.heard
        if self.status == Status.READY and newest:
            self.homing, self.ready, self.mode = None, True, Mode.SAFE
            self._tell("ready", values=self.sample)
        elif self.homing is not None and now > self.homing:
            self.end("it did not come back to its start in time", kind="homing")
        elif now - self.heard > self.told["patience"]:
            self.end("the machine was silent while it was brought to its start", kind="silent")


def _micros() -> int:
    return time.monotonic_ns() // 1000


def urge(thread: int, level: int) -> bool:
    """Put a thread before all that is not urgent, where the system lets us; level 0 takes it back.

    One with nothing to do but to wait and to answer delays others by microseconds.
    """
    policy = os.SCHED_FIFO if level else os.SCHED_OTHER
    with contextlib.suppress(OSError):  # no right to, or the thread has ended
        os.sched_setscheduler(thread, policy, os.sched_param(level))
        return True
    return False


@contextlib.contextmanager
def _keys() -> Iterator[list[int]]:
    """The terminal, if this process has one: it gives each key at once, and is put back."""
    try:
        usual = termios.tcgetattr(0) if os.tcgetpgrp(0) == os.getpgrp() else None
    except (OSError, termios.error):
        usual = None
    if usual is None:
        yield []
        return
    tty.setcbreak(0)
    try:
        yield [0]
    finally:
        termios.tcsetattr(0, termios.TCSADRAIN, usual)


def main(descriptor: int) -> None:
    """Serve the learner at the other end of a socket."""
    learner = socket.socket(fileno=descriptor)
    told = json.loads(learner.recv(65536))
    gc.freeze()
    gc.disable()
    with _keys() as keys, contextlib.suppress(OSError):
        try:
            link = open_link(told["address"])
            loop = Loop({**told, "keys": keys}, link, learner)
            signal.signal(signal.SIGINT, loop.stop)
            signal.signal(signal.SIGTERM, loop.stop)
            loop.greet()
        except McPilcoError as error:
            learner.send(json.dumps({"is": "refused", "why": str(error)}).encode())
            return
        learner.send(json.dumps({"is": "open", "urgent": urge(0, 2)}).encode())
        with contextlib.closing(link):
            loop.run()


if __name__ == "__main__":
    main(int(sys.argv[1]))
