"""How many samples a second the collision detector takes, at six joints; a robot sends 125.

    python runs/speed_collision.py
    python runs/speed_collision.py --points 500 1500 3000

CPU time of one thread, over a pushed motion, behind some samples for warming up. The longest single
call counts too: a detector that is late once is late. Rule `deviations` asks for the posterior's
variance at each sample, in addition to its mean.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
import tyro
from threadpoolctl import threadpool_limits

from envs.arms.motions import waypoints
from envs.arms.sticky_arm import MODEL, SAMPLING_S, ArmLog, Push, StickyArm
from mcpilco.identification import RigidBody
from mcpilco.identification.collision import (
    CURRENT_TERMS,
    CollisionDetector,
    CurrentConfig,
    Sample,
    ThresholdConfig,
    fit_currents,
    thresholds,
)
from mcpilco.recordings import arm_samples

WARM = 100
"""samples that are not timed"""


@dataclass(frozen=True)
class Arguments:
    """What is timed."""

    points: tuple[int, ...] = (500, 1000, 1500)
    """samples that the model keeps"""
    samples: int = 2000
    """of the pushed motion"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)
    print("points   rule          samples/s   longest call [ms]   times 125 Hz")
    with threadpool_limits(1):
        rng = np.random.default_rng(0)
        arm = StickyArm.drawn(rng)
        free, held = (arm_samples(arm.follow(waypoints(30, rng), rng)) for _ in range(2))
        told = list(stream(arm.follow(waypoints(12, rng), rng, [Push(4.0, 40.0)])))
        body = RigidBody.of(mujoco.MjModel.from_xml_path(str(MODEL)), terms=CURRENT_TERMS)
        for points in arguments.points:
            config = CurrentConfig(points=points, iterations=30)
            model, _ = fit_currents(free, body, SAMPLING_S, config)
            for rule in ("current", "deviations"):
                limits = thresholds(model, held, ThresholdConfig(rule=rule))
                spent = times(CollisionDetector(model, limits), told[: arguments.samples])
                rate = len(spent) / sum(spent)
                print(
                    f"{points:6d}   {rule:10s} {rate:12.0f} {1000 * max(spent):19.2f} "
                    f"{rate / 125:14.1f}"
                )


def stream(log: ArmLog) -> list[Sample]:
    columns = (
        log.time.tolist(),
        log.position,
        log.current,
        log.target_position,
        log.target_velocity,
        log.target_current,
        log.velocity,
    )
    return [Sample(*row) for row in zip(*columns, strict=True)]


def times(detector: CollisionDetector, samples: list[Sample]) -> list[float]:
    """CPU time of each call [s]."""
    spent = []
    for sample in samples:
        begun = time.thread_time()
        detector.update(sample)
        spent.append(time.thread_time() - begun)
    return spent[WARM:]


if __name__ == "__main__":
    main()
