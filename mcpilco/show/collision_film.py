"""An arm that is pushed, and what its currents tell of it, as a Rerun recording (.rrd)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Bool, Float

from mcpilco.bodies import Chain
from mcpilco.identification.collision import Detection, Event
from mcpilco.recordings import ArmSamples
from mcpilco.show.blueprint import ABOUT, TIMELINE, WORLD, build_watch, entity
from mcpilco.show.entities import RGB, Track, log_dots, log_line, log_scene
from mcpilco.show.recording import new_recording
from mcpilco.show.scene import chain_scene

CURRENTS, RESIDUALS = "currents", "residuals"
"""top-level entities, besides those of all recordings"""
_MEASURED: RGB = (245, 245, 245)
_EXPECTED: RGB = (70, 150, 255)
_RESIDUAL: RGB = (240, 170, 60)
_LIMIT: RGB = (110, 115, 125)
_ALARM: RGB = (255, 60, 60)
_PUSH: RGB = (120, 220, 140)
_ALARM_SIZE = 0.11
"""radius of the ball about a link whose joint raises an alarm [m]"""
_METRES_PER_NEWTON = 0.008
"""length of a push's arrow"""
IN_WORDS = (
    "White: the arm and its currents. Blue: the currents expected without contact. Orange: what is "
    "left over; grey: its thresholds. Red: an alarm, about the links whose joints raise it. Green: "
    "the push, where it is known."
)


@dataclass(frozen=True, kw_only=True)
class _Timed(Track):
    """Entities along samples that need not be evenly spaced."""

    times: np.ndarray
    """of the samples [s]"""
    steps: np.ndarray
    """their numbers"""

    def moving(self, path: str, first: int, rows: int, columns: rr.ComponentColumnList) -> None:
        index = [
            rr.TimeColumn(TIMELINE, duration=self.times[first : first + rows]),
            rr.TimeColumn("step", sequence=self.steps[first : first + rows]),
        ]
        self.rec.send_columns(path, index, columns, strict=True)


def write_collision_film(
    path: Path,
    name: str,
    chain: Chain,
    samples: ArmSamples,
    found: Detection,
    told: Sequence[Event],
    push: Float[np.ndarray, "N 3"] | None = None,
) -> Path:
    """The path of the recording written: the arm, its currents, and the alarms, over `sim_time`.

    Missing folders are made, an existing file is replaced. `push` is the true force at the end of
    the arm, in the world, where it is known [N].

    Raises:
        RunFolderError: the file cannot be written.
    """
    scene = chain_scene(chain)
    states = np.stack([samples.q, samples.dq], axis=2).reshape(len(samples), -1)
    poses = scene.poses(states)
    links = np.stack([poses[body.name].translation for body in chain.bodies], axis=1)
    extent = np.concatenate([links.reshape(-1, 3), scene.marker(states)])
    dt = float(np.median(np.diff(samples.time)))
    kinds = {CURRENTS: "current", RESIDUALS: "residual"}
    titles = {entity(k, j): f"{j}: {word} [A]" for j in chain.joints for k, word in kinds.items()}
    with new_recording(path, name, (samples.i, found.expected)) as rec:
        rec.send_blueprint(build_watch(titles, extent))
        rec.send_recording_name(name)
        track = _Timed(rec, dt, times=samples.time, steps=np.arange(len(samples)))
        track.still(ABOUT, rr.TextDocument(_notes(name, told), media_type="text/markdown"))
        log_scene(track, scene, states)
        _log_alarms(track, links, found.joints)
        if push is not None:
            _log_push(track, scene.marker(states), push)
        for j, joint in enumerate(chain.joints):
            _log_joint(track, joint, j, samples, found)
    return path


def _notes(name: str, told: Sequence[Event]) -> str:
    lines = [
        f"- {event.start_s:.2f} s: {', '.join(event.joints)}, {event.excess:.1f} thresholds"
        for event in told
    ]
    return "\n".join([f"### {name}: {len(told)} alarms", "", IN_WORDS, "", *lines])


def _log_alarms(
    track: Track, links: Float[np.ndarray, "N J 3"], alarms: Bool[np.ndarray, "N J"]
) -> None:
    """A ball about each link whose joint raises an alarm."""
    path = entity(WORLD, "alarm")
    track.still(path, rr.Points3D.from_fields(colors=[_ALARM], radii=_ALARM_SIZE))
    points = rr.Points3D.columns(positions=links[alarms]).partition(alarms.sum(axis=1).tolist())
    track.moving(path, 0, len(alarms), points)


def _log_push(track: Track, tips: Float[np.ndarray, "N 3"], push: Float[np.ndarray, "N 3"]) -> None:
    acts = np.abs(push).max(axis=1) > 0.0
    vectors = _METRES_PER_NEWTON * push[acts]
    path = entity(WORLD, "push")
    track.still(path, rr.Arrows3D.from_fields(colors=[_PUSH], radii=0.015))
    arrows = rr.Arrows3D.columns(vectors=vectors, origins=tips[acts] - vectors)
    track.moving(path, 0, len(push), arrows.partition(acts.astype(int).tolist()))


def _log_joint(track: _Timed, joint: str, j: int, samples: ArmSamples, found: Detection) -> None:
    log_line(track, entity(CURRENTS, joint, "expected"), 0, found.expected[:, j], _EXPECTED)
    log_line(track, entity(CURRENTS, joint, "measured"), 0, samples.i[:, j], _MEASURED)
    log_line(track, entity(RESIDUALS, joint, "residual"), 0, found.residual[:, j], _RESIDUAL)
    for side, sign in (("upper", 1.0), ("lower", -1.0)):
        path = entity(RESIDUALS, joint, side)
        log_line(track, path, 0, sign * found.threshold[:, j], _LIMIT)
    rows = np.flatnonzero(found.joints[:, j])
    if len(rows):
        some = replace(track, times=track.times[rows], steps=track.steps[rows])
        log_dots(some, entity(RESIDUALS, joint, "alarm"), found.residual[rows, j], _ALARM)
