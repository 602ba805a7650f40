"""Whether recordings can teach the currents of an arm, and what to record instead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mcpilco.identification.base_parameters import base_parameters
from mcpilco.identification.collision.features import CurrentFeatures
from mcpilco.recordings import ArmSamples
from mcpilco.typing import InputError

FEWEST = 500
"""samples to learn from"""
_SHARE = 0.01
"""of the samples in which each joint must move, and must rest [-]"""
_REPEATED = 0.05
"""share of samples that may be those before once more [-]"""
_TOLD = 1e-2
"""what is left of a feature, relative to its size, where the others tell it [-]"""


def check_free(
    samples: ArmSamples, joints: Sequence[str], speed: float, rests: bool = True
) -> None:
    """Raises InputError where a model of the currents cannot be learned from these samples.

    Args:
        samples: of all recordings.
        joints: names.
        speed: below which a joint is quasi-static [rad/s or m/s].
        rests: whether the model is to learn rests too.
    """
    if len(samples) < FEWEST:
        raise InputError(
            f"currents need at least {FEWEST} samples to be learned from, got {len(samples)}; "
            "record some minutes of motions and rests."
        )
    _check_repeats(samples)
    for j, joint in enumerate(joints):
        if np.ptp(samples.i[:, j]) == 0.0:
            raise InputError(
                f"the current of {joint} is the same in all samples; log the measured current of "
                "its motor."
            )
        slow = np.abs(samples.dq[:, j]) < speed
        if slow.mean() > 1.0 - _SHARE:
            raise InputError(
                f"{joint} is slower than {speed:g} rad/s in {100 * slow.mean():.0f} % of the "
                "samples, so that its friction and inertia cannot be told; record motions of all "
                "joints."
            )
        if rests and slow.mean() < _SHARE:
            raise InputError(
                f"{joint} rests (slower than {speed:g} rad/s) in {100 * slow.mean():.1f} % of the "
                f"samples, of which at least {100 * _SHARE:g} % are needed to learn what stuck "
                "joints do; record rests between the motions, or choose the kind PP."
            )


def _check_repeats(samples: ArmSamples) -> None:
    """A log that is faster than the robot repeats what the robot said."""
    rows = np.hstack([samples.q, samples.i])
    share = float((np.diff(rows, axis=0) == 0.0).all(axis=1).mean())
    if share > _REPEATED:
        raise InputError(
            f"{100 * share:.0f} % of the samples repeat the positions and currents of those "
            "before; log at the rate of the robot's controller, or bring the log to it with --dt."
        )


def unidentified(samples: ArmSamples, features: CurrentFeatures) -> tuple[str, ...]:
    """Features of joints that the samples do not tell from the others, as `joint: parameter`."""
    phi = features(samples.q, samples.dq, samples.ddq)
    joints = features.body.chain.joints
    return tuple(
        f"{joints[j]}: {features.names(j)[k]}"
        for j in range(features.joints)
        for k in base_parameters(phi[j], tolerance=_TOLD).dependent
    )


def about_unidentified(names: Sequence[str]) -> tuple[str, ...]:
    """Sentences for a person."""
    if not names:
        return ()
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return (
        f"The motions do not tell {shown}: postures or motions that differ from those recorded "
        "may raise false alarms; move several joints at once, farther and at different speeds.",
    )
