"""A cart-pole that MuJoCo simulates in real time, behind UDP: a machine to try things on.

    python runs/rig/rig.py                         # udp://127.0.0.1:9000
    python runs/rig/rig.py --seed 7                # with effects that nobody is told
    python runs/rig/rig.py --loss 0.05 --jitter 0.02 --spikes 0.2

It shares no code with the learner: the protocol is written down in docs/machine.md. Commands on
its standard input change its faults while it runs: `loss 0.3`, `jitter 0.02`, `spikes 0.2`,
`jump 1.5`, `mute 0.4`, `freeze 0.1`, `counts`, `state`, `quit`.
"""

import argparse
import contextlib
import hashlib
import heapq
import json
import math
import os
import secrets
import select
import socket
import struct
import sys
import time
from collections import Counter, deque

import mujoco
import numpy as np

XML = """
<mujoco>
  <option timestep="0.001" gravity="0 0 -9.82" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="0.1"/>
      <geom type="box" size="0.1 0.05 0.05" mass="0.5" contype="0" conaffinity="0"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 -1 0"/>
        <inertial pos="0 0 -0.25" mass="0.5" diaginertia="0.0104167 0.0104167 0.0001"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
FORCE = 10.0
"""largest force of the motor [N]"""
WATCHDOG = 0.3
"""without a command for so long the motor is off [s]"""
HOMING = 0.4
"""time in which the cart is brought back and the pole stilled [s]"""
HEADER = struct.Struct("<2sBBQIIQBBH")
HELLO, WELCOME, COMMAND, MEASUREMENT = 1, 2, 3, 4
SAFE, RUN, HOME, STOP, READY = 0, 1, 2, 3, 4
LARGEST = 32 + 4 * 32 + 8


def hidden(seed):
    """The effects that a seed hides: none without one."""
    if seed is None:
        return {}
    rng = np.random.default_rng([seed, 32])

    def drawn(low, high):
        return round(float(rng.uniform(low, high)), 4)

    kinds = [
        lambda: {"friction": drawn(0.8, 2.0), "lag": drawn(0.03, 0.08)},
        lambda: {"friction": drawn(0.6, 1.6), "delay": drawn(0.03, 0.09)},
        lambda: {
            "tilt": float(rng.choice([-1, 1])) * drawn(1.0, 2.5),
            "drag": drawn(0.3, 1.0),
            "mass": drawn(0.1, 0.25),
        },
        lambda: {"gain": drawn(0.7, 0.85), "friction": drawn(0.5, 1.2), "drag": drawn(0.3, 0.8)},
    ]
    return kinds[seed % len(kinds)]()


class CartPole:
    """The machine itself: forces in, motion out, at the pace of the clock."""

    def __init__(self, effects, rng):
        self.effects, self.rng = effects, rng
        self.model = mujoco.MjModel.from_xml_string(XML)
        pole = self.model.body("pole").id
        self.model.body_mass[pole] += effects.get("mass", 0.0)
        self.model.body_inertia[pole, :2] *= self.model.body_mass[pole] / 0.5
        self.model.dof_frictionloss[0] = effects.get("friction", 0.0)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_setConst(self.model, self.data)
        self.begun, self.steps = time.monotonic(), 0
        self.late, self.motor = deque(), 0.0
        self.rest()

    def rest(self):
        """Hanging near the origin."""
        self.data.qpos[:] = 0.02 * self.rng.standard_normal(2)
        self.data.qvel[:] = 0.0
        self.late.clear()
        self.motor = 0.0

    def advance(self, now, force):
        """Until now, with the command that has held since the last call."""
        e, h = self.effects, self.model.opt.timestep
        while self.steps * h < now - self.begun:
            self.late.append(force * e.get("gain", 1.0))
            wait = round(e.get("delay", 0.0) / h)
            asked = self.late.popleft() if len(self.late) > wait else 0.0
            lag = e.get("lag", 0.0)
            self.motor += (asked - self.motor) * (1.0 - math.exp(-h / lag) if lag else 1.0)
            v = self.data.qvel[0]
            drag = e.get("drag", 0.0) * v * abs(v)
            self.data.qfrc_applied[0] = self.motor + e.get("tilt", 0.0) - drag
            mujoco.mj_step(self.model, self.data)
            self.steps += 1

    def states(self):
        q, v = self.data.qpos, self.data.qvel
        return np.array([q[0], v[0], q[1], v[1]])


class Rig:
    """The protocol, and faults of the line and of the encoder on request."""

    def __init__(self, options):
        self.options = options
        self.rng = np.random.default_rng(options.fault_seed)
        self.machine = CartPole(hidden(options.seed), np.random.default_rng(options.fault_seed + 1))
        self.key = options.key.encode()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((options.host, options.port))
        self.socket.setblocking(False)
        self.session = self.pending = self.peer = None
        self.counts, self.outbox, self.order = Counter(), [], 0
        self.counter = self.last = 0
        self.mode, self.force, self.heard = SAFE, 0.0, 0.0
        self.homed = self.home_until = None
        self.shift, self.mute, self.burst = 0.0, 0.0, 0.0

    # frames

    def tag(self, content):
        return hashlib.blake2s(content, digest_size=8, key=self.key).digest()

    def frame(self, kind, session, counter, echo, mode, values):
        stamp = time.monotonic_ns() // 1000
        head = HEADER.pack(b"MP", 1, kind, session, counter, echo, stamp, mode, len(values), 0)
        content = head + struct.pack(f"<{len(values)}f", *values)
        return content + self.tag(content)

    def refuse(self, why):
        self.counts[why] += 1

    def hear(self, packet, peer, now):
        """Answer a packet, or count why not."""
        if len(packet) > LARGEST:
            return self.refuse("oversized")
        if len(packet) < 40:
            return self.refuse("malformed")
        magic, version, kind, session, counter, _, _, mode, n, zero = HEADER.unpack_from(packet)
        if (magic, version, zero) != (b"MP", 1, 0) or len(packet) != 40 + 4 * n or mode > STOP:
            return self.refuse("malformed")
        if self.tag(packet[:-8]) != packet[-8:]:
            return self.refuse("forged")
        if kind == HELLO and n == 0 and 0 < session < 2**32:
            live = self.session is not None and now - self.heard < WATCHDOG
            if live and self.mode != STOP:
                return self.refuse("busy")
            if self.pending is None or self.pending % 2**32 != session:
                self.pending = session | secrets.randbits(32) << 32
            self.counts["hello"] += 1
            return self.post(peer, self.frame(WELCOME, self.pending, 1, 1, SAFE, (4, 1, WATCHDOG)))
        values = struct.unpack_from(f"<{n}f", packet, 32)
        if kind != COMMAND or n != 1 or not math.isfinite(values[0]):
            return self.refuse("malformed")
        if session == self.pending:
            self.session, self.pending, self.last, self.counter = session, None, 0, 0
            self.mode, self.shift = SAFE, 0.0
        if session != self.session or session is None:
            return self.refuse("forged")
        if counter <= self.last:
            return self.refuse("replayed")
        self.last, self.heard, self.peer = counter, now, peer
        self.counts["commands"] += 1
        self.obey(mode, values[0], now)
        self.counter += 1
        states = self.sensed()
        status = READY if mode == HOME and self.homed else mode
        answer = (*states, self.force)
        self.post(peer, self.frame(MEASUREMENT, session, self.counter, counter, status, answer))

    def obey(self, mode, force, now):
        if self.mode == STOP:
            mode = STOP
        if mode == HOME and self.mode != HOME:
            self.homed, self.home_until = False, now + HOMING
        self.mode = mode
        self.force = max(-FORCE, min(FORCE, force)) if mode == RUN else 0.0

    # the machine and its faults

    def sensed(self):
        o = self.options
        noise = o.noise * self.rng.standard_normal(4)
        if self.rng.random() < o.spikes:
            noise[2] += self.rng.choice([-1.0, 1.0]) * self.rng.uniform(0.5, 3.0)
            self.counts["spikes"] += 1
        noise[2] += self.shift
        return self.machine.states() + noise

    def post(self, peer, packet):
        now = time.monotonic()
        if self.rng.random() < self.options.loss or now < self.mute:
            self.counts["lost"] += 1
            return
        if self.options.jitter and now > self.burst and self.rng.random() < 0.02:
            self.burst = now + 0.1
        late = self.rng.uniform(0.0, self.options.jitter) if now < self.burst else 0.0
        self.order += 1
        heapq.heappush(self.outbox, (now + late, self.order, peer, packet))
        self.flush(now)

    def flush(self, now):
        while self.outbox and self.outbox[0][0] <= now:
            _, _, peer, packet = heapq.heappop(self.outbox)
            try:
                self.socket.sendto(packet, peer)
            except OSError:
                self.counts["unsent"] += 1

    def told(self, line):
        """A fault by its name and size; whether to go on."""
        word, _, value = line.strip().partition(" ")
        number = float(value or 0.0)
        if word in ("loss", "jitter", "spikes", "noise"):
            setattr(self.options, word, number)
        elif word == "jump":
            self.shift += number
        elif word == "mute":
            self.mute = time.monotonic() + number
        elif word == "freeze":
            time.sleep(number)
        elif word == "counts":
            print(json.dumps(self.counts), flush=True)
        elif word == "state":
            print(json.dumps({"mode": self.mode, "force": self.force}), flush=True)
        return word != "quit"

    def tick(self, now):
        self.machine.advance(now, self.force)
        if now - self.heard > WATCHDOG and self.mode not in (SAFE, STOP):
            self.mode, self.force = SAFE, 0.0
            self.counts["watchdog"] += 1
        if self.mode == HOME and not self.homed and now > self.home_until:
            self.machine.rest()
            self.shift, self.homed = 0.0, True

    def run(self):
        waits = [self.socket, *([sys.stdin] if self.options.control else [])]
        while True:
            now = time.monotonic()
            due = self.outbox[0][0] - now if self.outbox else 0.01
            ready, _, _ = select.select(waits, [], [], max(0.0, min(due, 0.01)))
            now = time.monotonic()
            self.tick(now)
            if sys.stdin in ready:
                line = os.read(0, 4096).decode()
                if not line or not all(map(self.told, line.splitlines())):
                    break
            for _ in range(100 if self.socket in ready else 0):
                try:
                    packet, peer = self.socket.recvfrom(LARGEST + 1)
                except OSError:
                    break
                self.machine.advance(now, self.force)
                self.hear(packet, peer, now)
            self.flush(now)
        print(json.dumps(self.counts), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=9000)
    parser.add_argument("--host", default="127.0.0.1", help="0.0.0.0: whoever reaches this machine")
    parser.add_argument("--key", default="", help="that both sides know, up to 32 bytes")
    parser.add_argument("--seed", type=int, help="of hidden effects; without it there are none")
    parser.add_argument("--fault-seed", type=int, default=0, help="of noise and faults")
    parser.add_argument("--noise", type=float, default=0.003, help="std of each measurement")
    parser.add_argument("--loss", type=float, default=0.0, help="share of measurements lost")
    parser.add_argument("--jitter", type=float, default=0.0, help="longest delay in a burst [s]")
    parser.add_argument("--spikes", type=float, default=0.0, help="share of false angles")
    parser.add_argument("--control", action="store_true", help="read faults from standard input")
    options = parser.parse_args()
    with contextlib.suppress(OSError):  # a microcontroller is disturbed by no other program
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(3))
    rig = Rig(options)
    where = "{}:{}".format(*rig.socket.getsockname())
    print(f"A cart-pole at udp://{where}; Ctrl-C ends it.", flush=True)
    try:
        rig.run()
    except KeyboardInterrupt:
        print(json.dumps(rig.counts))


if __name__ == "__main__":
    main()
