"""What simulations promised of their policies beside what happened, as a Rerun recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mcpilco.crossing import Crossing, Outcome
from mcpilco.show.scene import Scene
from mcpilco.show.side_by_side import Clip, Naming, write_side_by_side


def write_film(path: Path, legs: Mapping[str, Crossing], scene: Scene, name: str) -> Path:
    """The path of the recording written: an episode of each policy on the system and as promised.

    Args:
        path: where the .rrd file goes.
        legs: policies by the simulation that they were trained in.
        scene: how to draw a state in 3D.
        name: what the viewer calls the recording.

    Raises:
        RunFolderError: the file cannot be written.
    """
    first = next(iter(legs.values()))
    naming = Naming(states=dict(first.states), inputs=dict(first.inputs))
    clips = [_clip(leg, found) for leg, found in legs.items()]
    return write_side_by_side(path, clips, first.dt, naming, scene, name)


def _clip(leg: str, found: Crossing) -> Clip:
    """One policy."""
    note = (
        f"### Trained in the {leg} simulation\n\n"
        f"There: {_told(found.promised)}. On the system: {_told(found.happened)}.\n\n"
        "White: an episode on the system. Orange: what the simulation promised."
    )
    length = min(len(found.happened.states), len(found.promised.states))
    held = np.append(found.happened.inputs, found.happened.inputs[-1:], axis=0)
    return Clip(
        note=note,
        measured=found.happened.states[:length],
        inputs=held[:length],
        models={"promised": found.promised.states[:length]},
    )


def _told(outcome: Outcome) -> str:
    if outcome.success is None:
        return f"return **{outcome.returns:.1f}**"
    return f"success in **{100 * outcome.success:.0f} %**"
