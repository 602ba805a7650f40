"""What a recording shows: the system, the particles and their curves, as entities of Rerun."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import rerun as rr
from jaxtyping import Float, Int

from mcpilco.costs import costs_along
from mcpilco.data import Prediction, Rollout
from mcpilco.task import TaskSpec
from mcpilco.visual.blueprint import COST, INPUTS, STATES, TIMELINE, WORLD, entity
from mcpilco.visual.scene import Scene, Shape

# Opaque colours: Rerun does not blend lines in 3D.
_SYSTEM = (245, 245, 245)
_OBSERVED = (240, 170, 60)
_ESTIMATED = (225, 95, 160)
_MODEL = (70, 150, 255)
_PARTICLES = (110, 115, 125)
_DIM = (66, 72, 88)
_MARKERS = (150, 156, 168)
_TARGET = (90, 210, 120)

COLORS_IN_WORDS = (
    "White: the system. Orange: what the agent saw of it. "
    "Pink: what it made of that, where it saw a part: dots by then, a line afterwards. "
    "Blue: the median of the particles, for the cost their mean. Grey: the particles."
)

_LINES = 30
"""particles drawn in a plot"""
_TAILS = 50
"""particles whose latest path is drawn in the scene"""
_TAIL_S = 0.8
"""how much of a path is drawn: all of it hides the rest where a pole turns over and over [s]"""

Hold = Literal["Linear", "StepAfter"]


@dataclass(frozen=True)
class Track:
    """Entities along the steps of one rollout."""

    rec: rr.RecordingStream
    dt: float
    """sampling time [s]"""

    def still(self, path: str, *what: rr.AsComponents) -> None:
        """Show this at all times."""
        self.rec.log(path, *what, static=True, strict=True)

    def moving(self, path: str, first: int, rows: int, columns: rr.ComponentColumnList) -> None:
        """Show one row at each of the steps first, first + 1, ..."""
        steps = np.arange(first, first + rows)
        index = [
            rr.TimeColumn(TIMELINE, duration=steps * self.dt),
            rr.TimeColumn("step", sequence=steps),
        ]
        self.rec.send_columns(path, index, columns, strict=True)


def log_scene(track: Track, scene: Scene, rollout: Rollout) -> None:
    """The bodies, the target and the latest path of the marker on the system."""
    states = rollout.shown_states
    track.still(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    for i, (shape, position) in enumerate(scene.fixed):
        track.still(
            entity(WORLD, "fixed", str(i)), _solid(shape), rr.Transform3D(translation=position)
        )
    for name, pose in scene.poses(states).items():
        path = entity(WORLD, "bodies", name)
        motion = rr.Transform3D.columns(translation=pose.translation, quaternion=pose.quaternion)
        track.still(path, _solid(scene.shapes[name]))
        track.moving(path, 0, len(states), motion)
    if scene.target is not None:
        target = rr.Points3D([scene.target], colors=[_TARGET], radii=rr.Radius.ui_points(7))
        track.still(entity(WORLD, "target"), target)
    _log_tails(track, entity(WORLD, "tail"), scene.marker(states)[:, None], _SYSTEM, 1.0)


def log_particles(track: Track, scene: Scene, prediction: Prediction) -> None:
    """The marker of every particle at each step, and the latest paths of some."""
    markers = scene.marker(prediction.states)  # (T + 1, P, 3)
    rows, particles, _ = markers.shape
    path = entity(WORLD, "particles")
    track.still(path, rr.Points3D.from_fields(colors=[_MARKERS], radii=rr.Radius.ui_points(2.5)))
    points = rr.Points3D.columns(positions=markers.reshape(-1, 3)).partition([particles] * rows)
    track.moving(path, 0, rows, points)
    shown = markers[:, _some(particles, _TAILS)]
    _log_tails(track, entity(WORLD, "particle_tails"), shown, _DIM, 0.5)


def _log_tails(
    track: Track,
    path: str,
    markers: Float[np.ndarray, "T P 3"],
    color: tuple[int, int, int],
    width: float,
) -> None:
    """At each step, where each marker has lately been; the first points repeat."""
    rows, strips, _ = markers.shape
    length = max(round(_TAIL_S / track.dt), 1)
    steps = np.maximum(np.arange(rows)[:, None] + np.arange(-length, 1), 0)  # (T, length + 1)
    tails = markers[steps].swapaxes(1, 2).reshape(rows * strips, length + 1, 3)
    track.still(path, rr.LineStrips3D.from_fields(colors=[color], radii=rr.Radius.ui_points(width)))
    columns = rr.LineStrips3D.columns(strips=tails).partition([strips] * rows)
    track.moving(path, 0, rows, columns)


def log_curves(
    track: Track, task: TaskSpec, rollout: Rollout, prediction: Prediction | None
) -> None:
    """States between steps, inputs held through each step, costs at the end of each."""
    for i, name in enumerate(task.state_names):
        if prediction is not None:
            particles = prediction.states[:, :, i]
            _log_spread(track, entity(STATES, name), 0, particles, np.median(particles, axis=1))
        if rollout.states is not None:
            _log_line(track, entity(STATES, name, "system"), 0, rollout.states[:, i])
        if i in task.observed:
            seen = rollout.observations[:, task.observed.index(i)]
            _log_dots(track, entity(STATES, name, "observed"), 0, seen)
        if rollout.estimates is not None:
            path = entity(STATES, name, "estimated")
            _log_dots(track, path, 0, rollout.estimates[:, i], _ESTIMATED)
        if rollout.smoothed is not None:
            path = entity(STATES, name, "smoothed")
            _log_line(track, path, 0, rollout.smoothed[:, i], _ESTIMATED)
    for i, name in enumerate(task.input_names):
        if prediction is not None:
            particles = prediction.inputs[:, :, i]
            median = np.median(particles, axis=1)
            _log_spread(track, entity(INPUTS, name), 0, particles, median, "StepAfter")
        _log_line(track, entity(INPUTS, name, "system"), 0, rollout.inputs[:, i], hold="StepAfter")
    if prediction is not None:
        _log_spread(track, COST, 1, prediction.costs, prediction.costs.mean(axis=1))
    costs = costs_along(task.cost, rollout.shown_states[1:], rollout.inputs)
    _log_line(track, entity(COST, "system"), 1, costs)


def _log_spread(
    track: Track,
    path: str,
    first: int,
    particles: Float[np.ndarray, "T P"],
    middle: Float[np.ndarray, " T"],
    hold: Hold = "Linear",
) -> None:
    """Some of the particles, as many series of one entity, and a line in their middle."""
    shown = particles[:, _some(particles.shape[1], _LINES)]
    rows, series = shown.shape
    style = rr.SeriesLines(
        colors=[_PARTICLES] * series,
        widths=[0.8] * series,
        names=[f"particle {i}" for i in range(series)],
        interpolation_mode=hold,
    )
    columns = rr.Scalars.columns(scalars=shown.reshape(-1)).partition([series] * rows)
    track.still(f"{path}/particles", style)
    track.moving(f"{path}/particles", first, rows, columns)
    _log_line(track, f"{path}/predicted", first, middle, _MODEL, hold)


def _log_line(
    track: Track,
    path: str,
    first: int,
    values: Float[np.ndarray, " T"],
    color: tuple[int, int, int] = _SYSTEM,
    hold: Hold = "Linear",
) -> None:
    name = path.rsplit("/", 1)[-1]
    track.still(path, rr.SeriesLines(colors=color, widths=2.5, names=name, interpolation_mode=hold))
    track.moving(path, first, len(values), rr.Scalars.columns(scalars=values))


def _log_dots(
    track: Track,
    path: str,
    first: int,
    values: Float[np.ndarray, " T"],
    color: tuple[int, int, int] = _OBSERVED,
) -> None:
    name = path.rsplit("/", 1)[-1]
    style = rr.SeriesPoints(colors=color, markers="circle", marker_sizes=2.0, names=name)
    track.still(path, style)
    track.moving(path, first, len(values), rr.Scalars.columns(scalars=values))


def _solid(shape: Shape) -> rr.AsComponents:
    """The shape, centred at its own origin."""
    if shape.kind == "box":
        return rr.Boxes3D(half_sizes=[shape.size], colors=[shape.color], fill_mode="solid")
    if shape.kind == "sphere":
        return rr.Ellipsoids3D(radii=[shape.size[0]], colors=[shape.color], fill_mode="solid")
    radius, half_length = shape.size
    return rr.Capsules3D(
        lengths=[2 * half_length],
        radii=[radius],
        translations=[(0.0, 0.0, -half_length)],  # Rerun's capsule runs from its origin along +z
        colors=[shape.color],
        fill_mode="solid",
    )


def _some(count: int, at_most: int) -> Int[np.ndarray, " S"]:
    """Indices of at most so many of the particles, evenly spread."""
    return np.linspace(0, count - 1, min(count, at_most)).round().astype(int)
