"""How many samples a second the regressor of a robot takes, beside MuJoCo's inverse dynamics.

    python runs/speed_regressor.py                  # 1, 2, 7 and 10 joints, 2000 and 20000 samples
    python runs/speed_regressor.py --joints 7

CPU time of one thread, median of some repeats after one for warming up. `mj_inverse` is called in a
loop of Python's and finds forces only; the regressor holds what each of 13 parameters a joint adds.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import tyro
from threadpoolctl import threadpool_limits

from mcpilco.identification import RigidBody, random_motions


@dataclass(frozen=True)
class Arguments:
    """What is timed."""

    joints: tuple[int, ...] = (1, 2, 7, 10)
    """of chains of hinges"""
    samples: tuple[int, ...] = (2000, 20000)
    """in one call"""
    repeats: int = 5
    """calls that are timed"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    print("joints  samples   regressor [1/s]   mj_inverse [1/s]   ratio")
    with threadpool_limits(1):
        for joints in arguments.joints:
            for samples in arguments.samples:
                ours, theirs = rates(joints, samples, arguments.repeats)
                print(f"{joints:6d} {samples:8d} {ours:17.0f} {theirs:18.0f} {ours / theirs:7.2f}")


def rates(joints: int, samples: int, repeats: int) -> tuple[float, float]:
    """Samples a CPU second of both."""
    model = mujoco.MjModel.from_xml_string(chain(joints))
    data, body = mujoco.MjData(model), RigidBody.of(model)
    q, dq, ddq = random_motions(body, samples, np.random.default_rng(0))

    def inverse() -> None:
        for n in range(samples):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[n], dq[n], ddq[n]
            mujoco.mj_inverse(model, data)

    times = (median_s(call, repeats) for call in (lambda: body.regressor(q, dq, ddq), inverse))
    ours, theirs = times
    return samples / ours, samples / theirs


def median_s(call: Callable[[], object], repeats: int) -> float:
    """CPU time of a call [s]."""

    def timed() -> float:
        begun = time.process_time()
        call()
        return time.process_time() - begun

    timed()
    return statistics.median(timed() for _ in range(repeats))


def chain(joints: int) -> str:
    """Hinges about x, y, z in turn, 0.2 m apart."""
    axes = ("1 0 0", "0 1 0", "0 0 1")
    opened = "".join(
        f'<body pos="0 0 0.2"><joint axis="{axes[j % 3]}" damping="0.1"/>'
        '<geom type="capsule" fromto="0 0 0 0.03 0.02 0.2" size="0.03" '
        'contype="0" conaffinity="0"/>'
        for j in range(joints)
    )
    return f"<mujoco><worldbody>{opened}{'</body>' * joints}</worldbody></mujoco>"


if __name__ == "__main__":
    main()
