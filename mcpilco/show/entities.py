"""The system, the particles and their curves, as entities of Rerun."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import rerun as rr
from jaxtyping import Float

from mcpilco.data import Prediction, Rollout
from mcpilco.gp import evenly_spaced
from mcpilco.show.blueprint import COST, INPUTS, STATES, TIMELINE, WORLD, entity
from mcpilco.show.scene import Scene, Shape
from mcpilco.task import TaskSpec

RGB = tuple[int, int, int]


@dataclass(frozen=True)
class Colors:
    """How a run is drawn. Opaque: Rerun does not blend lines in 3D."""

    system: RGB = (245, 245, 245)
    """the rollout on the system"""
    observed: RGB | None = (240, 170, 60)
    """what the agent saw of it; None leaves it out"""
    estimated: RGB | None = (225, 95, 160)
    """what it made of that, where it saw a part; None leaves it out"""
    model: RGB = (70, 150, 255)
    """the median of the particles"""
    particles: RGB = (110, 115, 125)
    """in the plots"""
    tails: RGB = (66, 72, 88)
    """latest paths of the particles"""
    markers: RGB = (150, 156, 168)
    """the particles in the scene"""
    bodies: RGB | None = None
    """all bodies; None keeps each one's own colour"""


OVERLAID = (
    Colors(observed=None, estimated=None, bodies=(200, 205, 215)),
    Colors(
        system=(255, 160, 50),
        observed=None,
        estimated=None,
        model=(255, 95, 95),
        particles=(125, 100, 70),
        tails=(86, 66, 44),
        markers=(180, 140, 95),
        bodies=(225, 140, 50),
    ),
)
"""of two runs in one picture"""

_TARGET = (90, 210, 120)

_MODEL_IN_WORDS = "Blue: the median of the particles, for the cost their mean. Grey: the particles."
COLORS_IN_WORDS = (
    "White: the system. Orange: what the agent saw of it. "
    "Pink: what it made of that, where it saw a part: dots by then, a line afterwards. "
    f"{_MODEL_IN_WORDS}"
)
FILM_IN_WORDS = f"White: the system. {_MODEL_IN_WORDS}"
OVERLAID_IN_WORDS = (
    "White: the system in the first run, blue the median of its particles. "
    "Orange: the system in the second run, red the median of its particles."
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
    start_s: float = 0.0
    """when it begins on the timeline [s]"""
    first: int = 0
    """step at which it begins"""
    colors: Colors = Colors()
    gap: bool = False
    """break the curves after the last step, for another rollout follows on the timeline"""
    group: str = ""
    """sets the entities of one run apart from those of another"""

    def under(self, *parts: str) -> str:
        """The path of these parts; the group's name follows what a view shows all of."""
        root = 2 if parts[0] in (STATES, INPUTS) else 1
        groups = (self.group,) if self.group else ()
        return entity(*parts[:root], *groups, *parts[root:])

    def still(self, path: str, *what: rr.AsComponents) -> None:
        """Show this at all times."""
        self.rec.log(path, *what, static=True, strict=True)

    def moving(self, path: str, first: int, rows: int, columns: rr.ComponentColumnList) -> None:
        """Show one row at each of the steps first, first + 1, ..."""
        steps = np.arange(first, first + rows)
        index = [
            rr.TimeColumn(TIMELINE, duration=self.start_s + steps * self.dt),
            rr.TimeColumn("step", sequence=self.first + steps),
        ]
        self.rec.send_columns(path, index, columns, strict=True)


def log_scene(track: Track, scene: Scene, states: Float[np.ndarray, "T X"]) -> None:
    """The bodies, the target and the latest path of the marker on the system."""
    track.still(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    for i, (shape, position) in enumerate(scene.fixed):
        track.still(
            track.under(WORLD, "fixed", str(i)),
            _solid(shape, shape.color),
            rr.Transform3D(translation=position),
        )
    for name, pose in scene.poses(states).items():
        path = track.under(WORLD, "bodies", name)
        motion = rr.Transform3D.columns(translation=pose.translation, quaternion=pose.quaternion)
        shape = scene.shapes[name]
        track.still(path, _solid(shape, track.colors.bodies or shape.color))
        track.moving(path, 0, len(states), motion)
    if scene.target is not None:
        target = rr.Points3D([scene.target], colors=[_TARGET], radii=rr.Radius.ui_points(7))
        track.still(track.under(WORLD, "target"), target)
    log_tails(
        track, track.under(WORLD, "tail"), scene.marker(states)[:, None], track.colors.system, 1.0
    )


def log_particles(track: Track, scene: Scene, prediction: Prediction) -> None:
    """The marker of every particle at each step, and the latest paths of some."""
    markers = scene.marker(prediction.states)  # (T + 1, P, 3)
    rows, particles, _ = markers.shape
    path = track.under(WORLD, "particles")
    track.still(
        path, rr.Points3D.from_fields(colors=[track.colors.markers], radii=rr.Radius.ui_points(2.5))
    )
    points = rr.Points3D.columns(positions=markers.reshape(-1, 3)).partition([particles] * rows)
    track.moving(path, 0, rows, points)
    shown = markers[:, evenly_spaced(particles, _TAILS)]
    log_tails(track, track.under(WORLD, "particle_tails"), shown, track.colors.tails, 0.5)


def log_tails(
    track: Track, path: str, markers: Float[np.ndarray, "T P 3"], color: RGB, width: float
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
    track: Track,
    task: TaskSpec,
    rollout: Rollout,
    prediction: Prediction | None,
    costs: Float[np.ndarray, " T"] | None,
) -> None:
    """States between steps, inputs held through each step, costs at the end of each."""
    for i, name in enumerate(task.state_names):
        if prediction is not None:
            _log_spread(track, track.under(STATES, name), prediction.states[:, :, i])
        if rollout.states is not None or track.colors.observed is None:
            log_line(track, track.under(STATES, name, "system"), 0, rollout.shown_states[:, i])
        _log_perceived(track, task, rollout, i)
    for i, name in enumerate(task.input_names):
        if prediction is not None:
            particles = prediction.inputs[:, :, i]
            _log_spread(track, track.under(INPUTS, name), particles, hold="StepAfter")
        path = track.under(INPUTS, name, "system")
        log_line(track, path, 0, rollout.inputs[:, i], hold="StepAfter")
    if prediction is not None:
        _log_spread(track, track.under(COST), prediction.costs, np.mean, first=1)
    if costs is not None:
        log_line(track, track.under(COST, "system"), 1, costs)


def _log_perceived(track: Track, task: TaskSpec, rollout: Rollout, i: int) -> None:
    colors, name = track.colors, task.state_names[i]
    if colors.observed is not None and i in task.measured_states:
        seen = rollout.observations[:, task.measured_states.index(i)]
        log_dots(track, track.under(STATES, name, "observed"), seen, colors.observed)
    if colors.estimated is not None and rollout.estimates is not None:
        path = track.under(STATES, name, "estimated")
        log_dots(track, path, rollout.estimates[:, i], colors.estimated)
    if colors.estimated is not None and rollout.smoothed is not None:
        path = track.under(STATES, name, "smoothed")
        log_line(track, path, 0, rollout.smoothed[:, i], colors.estimated)


def _log_spread(
    track: Track,
    path: str,
    particles: Float[np.ndarray, "T P"],
    middle: Callable[..., np.ndarray] = np.median,
    first: int = 0,
    hold: Hold = "Linear",
) -> None:
    """Some of the particles, as many series of one entity, and a line in their middle."""
    shown = _ended(track, particles[:, evenly_spaced(particles.shape[1], _LINES)])
    rows, series = shown.shape
    style = rr.SeriesLines(
        colors=[track.colors.particles] * series,
        widths=[0.8] * series,
        names=[f"particle {i}" for i in range(series)],
        interpolation_mode=hold,
    )
    columns = rr.Scalars.columns(scalars=shown.reshape(-1)).partition([series] * rows)
    track.still(f"{path}/particles", style)
    track.moving(f"{path}/particles", first, rows, columns)
    line = middle(particles, axis=1)
    log_line(track, f"{path}/predicted", first, line, track.colors.model, hold)


def log_line(
    track: Track,
    path: str,
    first: int,
    values: Float[np.ndarray, " T"],
    color: RGB | None = None,
    hold: Hold = "Linear",
) -> None:
    """A line from step `first` on, called as its path ends."""
    name = path.rsplit("/", 1)[-1]
    style = rr.SeriesLines(
        colors=color or track.colors.system, widths=2.5, names=name, interpolation_mode=hold
    )
    track.still(path, style)
    values = _ended(track, values)
    track.moving(path, first, len(values), rr.Scalars.columns(scalars=values))


def _ended(track: Track, values: Float[np.ndarray, T * b]) -> Float[np.ndarray, rows * b]:
    """The values, with a row that Rerun draws as a gap where another rollout follows."""
    gap = np.full((int(track.gap), *values.shape[1:]), np.nan)
    return np.concatenate([values, gap])


def log_dots(
    track: Track, path: str, values: Float[np.ndarray, " T"], color: RGB, size: float = 2.0
) -> None:
    """Dots at the steps from 0 on, called as their path ends."""
    name = path.rsplit("/", 1)[-1]
    style = rr.SeriesPoints(colors=color, markers="circle", marker_sizes=size, names=name)
    track.still(path, style)
    track.moving(path, 0, len(values), rr.Scalars.columns(scalars=values))


def _solid(shape: Shape, color: RGB) -> rr.AsComponents:
    """The shape, centred at its own origin."""
    if shape.kind == "box":
        return rr.Boxes3D(half_sizes=[shape.size], colors=[color], fill_mode="solid")
    if shape.kind == "sphere":
        return rr.Ellipsoids3D(radii=[shape.size[0]], colors=[color], fill_mode="solid")
    radius, half_length = shape.size
    return rr.Capsules3D(
        lengths=[2 * half_length],
        radii=[radius],
        translations=[(0.0, 0.0, -half_length)],  # Rerun's capsule runs from its origin along +z
        colors=[color],
        fill_mode="solid",
    )
