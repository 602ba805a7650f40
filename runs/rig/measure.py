"""The loop's timing beside a training, what becomes of faults, and of packets that are none.

    python runs/rig/measure.py timing faults fuzz

Each writes a file into results/, and README.md anew. The port is 9700.
"""

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent), str(ROOT)]

import harness  # noqa: E402
import pages  # noqa: E402

import envs  # noqa: E402
from mcpilco.agent import MCPILCO  # noqa: E402
from mcpilco.machine import MACHINE, Frame, Kind, Mode, decode, encode, meeting  # noqa: E402
from mcpilco.recordings import read_for_plant  # noqa: E402
from mcpilco.typing import EnvError  # noqa: E402
from tests.mcpilco.machine.test_protocol import FRAME, fuzzed, inbox  # noqa: E402

PORT = 9700
ADDRESS = f"udp://127.0.0.1:{PORT}"
SIMULATION = "mcpilco/CartPoleSwingUp-v0"
OUT = ROOT / "runs/out/rig"


def started(*options):
    rig = [sys.executable, HERE / "rig.py", "--port", str(PORT), "--control", *options]
    made = subprocess.Popen(rig, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    made.stdout.readline()
    return made


def tell(rig, line):
    rig.stdin.write(line + "\n")
    rig.stdin.flush()


def ended(rig):
    return json.loads(rig.communicate("quit\n")[0].splitlines()[-1])


def keep(name, found):
    harness.keep(HERE / "results" / f"{name}.json", found, HERE.name)
    pages.write()
    print(name, json.dumps(found), flush=True)


def controller(rate):
    """A policy of 200 Gaussians in torch, which has learned nothing."""
    agent = MCPILCO("SumOfGaussians", gym.make(SIMULATION, dt=1.0 / rate))
    return agent.controller


def episode(env, act, steps):
    observed, info = env.reset()
    for _ in range(steps):
        observed, _, over, _, info = env.step(act(observed))
        if over:
            break
    return info["machine"]


# Timing -------------------------------------------------------------------------------------------


def timing(seconds=60.0):
    torch.set_num_threads(1)
    command = [sys.executable, "-m", "mcpilco.cli", "train", "--quiet", "--trials", "40", "--out"]
    beside = [
        subprocess.Popen([*command, OUT / f"beside-{time.time_ns()}", "--seed", str(k)], cwd=ROOT)
        for k in range(2)
    ]
    time.sleep(20.0)
    for rate in (100, 250):
        rig, begin = started(), controller(rate)
        steps, worst, watchdogs, load = 3 * rate, [], 0, os.getloadavg()[0]
        with meeting(ADDRESS):
            env = gym.make(MACHINE, simulation=SIMULATION, dt=1.0 / rate, rate=float(rate))
            for _ in range(round(seconds / 3.0)):
                try:
                    about = episode(env, begin(), steps)
                except EnvError as error:
                    print(error)
                    watchdogs += 1
                    continue
                worst.append(about["latency_s"])
            env.close()
        ended(rig)
        found = {"rate": rate, "steps": steps * len(worst)}
        found |= {"missed": about.get("missed", 0), "stale": about.get("stale", 0)}
        found |= {"latency_p50": float(np.median(worst)), "latency_max": max(worst)}
        found |= {"watchdog": env.unwrapped.settings.watchdog, "watchdogs": watchdogs}
        keep(f"timing-{rate}", {**found, "load": load})
    for process in beside:
        process.send_signal(signal.SIGINT)
        process.wait()


# Faults -------------------------------------------------------------------------------------------


def learner(log):
    """What is killed in one of the faults: it steps for ever."""
    with meeting(ADDRESS, log=log):
        env = gym.make(MACHINE, simulation=SIMULATION, dt=0.02)
        env.reset()
        for k in range(10**6):
            env.step(np.array([np.sin(0.1 * k)]))
            print(k, flush=True)


def faults(times=9):
    kinds = {}
    log = OUT / f"faults-{time.time_ns()}"
    rig = started()
    for kind in ("loss 0.05", "jitter 0.02", "jump", "kill rig", "kill learner", "kill loop"):
        told = went_on = lost = 0
        for number in range(times):
            folder = log / kind.replace(" ", "-") / str(number)
            said, rig = fault(kind, rig, folder)
            told += said
            with meeting(ADDRESS, log=folder / "after"):  # the same user goes on
                env = gym.make(MACHINE, simulation=SIMULATION, dt=0.02, silence=0.5, watchdog=0.5)
                episode(env, lambda x: np.array([0.5]), 10)
                env.close()
                went_on += 1
            plant = envs.plant_named("--sim", SIMULATION)
            for path in folder.rglob("episode-*.csv"):
                recordings, _ = read_for_plant(plant, [path])
                lost += np.isnan(recordings[0].inputs).any()
        kinds[kind] = [times, told, went_on, int(lost)]
        print(kind, kinds[kind], flush=True)
    ended(rig)
    keep("faults", {"kinds": kinds, "load": os.getloadavg()[0]})


def fault(kind, rig, folder):
    """Whether a fault was told, and the rig as it is then."""
    if kind == "kill learner":
        command = [sys.executable, __file__, "learner", folder]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            while int(child.stdout.readline()) < 40:
                pass
            child.kill()
        time.sleep(0.5)
        tell(rig, "state")
        return json.loads(rig.stdout.readline())["force"] == 0.0, rig  # the machine is safe
    with meeting(ADDRESS, log=folder):
        env = gym.make(MACHINE, simulation=SIMULATION, dt=0.02, silence=0.3, watchdog=0.5)
        episode(env, lambda x: np.array([0.5]), 20)
        word = kind.partition(" ")[0]
        try:
            if word in ("loss", "jitter"):
                tell(rig, kind)
                about = episode(env, lambda x: np.array([0.5]), 100)
                tell(rig, f"{word} 0")
                return about.get("lost" if word == "loss" else "late", 0) > 0, rig
            env.reset()
            for k in range(100):
                if k == 5 and word == "jump":
                    tell(rig, "jump 1.5")
                if k == 5 and kind == "kill rig":
                    rig.kill()
                    rig.communicate()
                if k == 5 and kind == "kill loop":
                    env.unwrapped._met.process.kill()
                env.step(np.array([0.5]))
            return False, rig
        except EnvError:
            return True, started() if kind == "kill rig" else rig


# Fuzzed packets -----------------------------------------------------------------------------------


def fuzz(count=100_000):
    box = inbox()
    box.take(encode(FRAME))
    packets = fuzzed(random.Random(32), count)
    changed = 0
    for _, packet in packets:
        changed += box.take(packet) is not None or box.last != FRAME.counter
    names = ["oversized", "malformed", "forged", "replayed"]
    sent = {name: sum(word == name for word, _ in packets) for name in names}
    found = {"total": count, "changed": changed, "sent": sent, "refused": dict(box.refused)}
    keep("fuzz", {**found, "names": names, "rig": on_rig(count)})


def on_rig(count):
    """The same against the rig's own code, over UDP, beside a session that is alive."""
    rig, rng = started(), random.Random(33)
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.connect(("127.0.0.1", PORT))
    line.settimeout(5.0)

    def asked(frame):
        line.send(encode(frame))
        return decode(line.recv(4096))

    session = asked(Frame(Kind.HELLO, 77, 1, 0, 0, Mode.SAFE, ())).session
    command = Frame(Kind.COMMAND, session, 5, 0, 0, Mode.RUN, (1.0,))
    asked(command)
    good = encode(command._replace(counter=10**6))
    for k in range(count):
        packet = bytearray(good)
        packet[rng.randrange(len(good))] ^= 1 << rng.randrange(8)
        choice = k % 4
        noise = [bytes(packet), encode(command), good[: rng.randrange(40)], good + bytes(2000)]
        line.send(noise[choice])
        if k % 20 == 19:
            time.sleep(0.002)
        if k % 1000 == 999:
            command = command._replace(counter=command.counter + 1)
            answer = asked(command)
            good = encode(command._replace(counter=10**6))
    counts = ended(rig)
    refused = {
        name: counts.get(name, 0) for name in ("oversized", "malformed", "forged", "replayed")
    }
    alive = answer.counter == 1 + count // 1000
    return {"sent": count, "refused": refused, "in all": sum(refused.values()), "alive": alive}


if __name__ == "__main__":
    if sys.argv[1:2] == ["learner"]:
        learner(sys.argv[2])
    with contextlib.suppress(KeyboardInterrupt):
        for part in sys.argv[1:]:
            {"timing": timing, "faults": faults, "fuzz": fuzz}[part]()
