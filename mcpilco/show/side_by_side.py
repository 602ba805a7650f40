"""Motions side by side, as Rerun recordings (.rrd): measured, and as models predict them.

`write_side_by_side` writes any such clips; `write_gap_film` the held-out windows of a gap, and
`write_crossing_film` episodes on the system beside those that simulations promised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Float

from mcpilco.crossing import Crossing, Outcome
from mcpilco.gap import Comparison, Gap, scaled_errors, squares_at_end, three_digits
from mcpilco.recordings import bridged
from mcpilco.show.blueprint import INPUTS, STATES, WORLD, build_side_by_side, entity
from mcpilco.show.entities import RGB, Colors, Track, log_dots, log_line, log_scene, log_tails
from mcpilco.show.model_scene import scene_of
from mcpilco.show.recording import log_note, new_recording
from mcpilco.show.scene import Scene
from mcpilco.typing import InputError

MEASURED = "measured"
_COLORS: tuple[RGB, ...] = ((240, 150, 50), (70, 150, 255), (110, 200, 120))
"""of the models, in turn"""
_WHITE: RGB = (245, 245, 245)
_PAUSE_S = 0.5
"""between two clips, to see how the first one ended [s]"""


@dataclass(frozen=True)
class Clip:
    """T samples of a recording, and what models make of them."""

    note: str
    """Markdown that is shown beside it"""
    measured: Float[np.ndarray, "T X"]
    """states; NaN where there is no measurement"""
    inputs: Float[np.ndarray, "T U"]
    """each held until the next sample"""
    models: Mapping[str, Float[np.ndarray, "T X"]]
    """states of each model, by its name"""


@dataclass(frozen=True)
class Naming:
    """Names of the curves in a recording."""

    states: Mapping[str, str]
    """units, by name, in the order of the columns"""
    inputs: Mapping[str, str]
    """likewise"""


def write_side_by_side(
    path: Path, clips: Sequence[Clip], dt: float, naming: Naming, scene: Scene, name: str
) -> Path:
    """The path of the recording written: clips one after another, over `sim_time` and `step`.

    Each model has a scene of its own, in which the measured marker's path is white.

    All clips are of the same models. Missing folders are made, an existing file is replaced.
    """
    arrays = (a for clip in clips for a in (clip.measured, clip.inputs, *clip.models.values()))
    with new_recording(path, name, arrays) as rec:
        rec.send_blueprint(_blueprint(clips, naming, scene))
        rec.send_recording_name(name)
        first = 0
        for clip in clips:
            _log(Track(rec, dt, start_s=first * dt, first=first, gap=True), clip, naming, scene)
            first += len(clip.measured) + max(round(_PAUSE_S / dt), 2)
    return path


def _log(track: Track, clip: Clip, naming: Naming, scene: Scene) -> None:
    seen = _whole(clip.measured)
    shown = {MEASURED: seen, **clip.models}
    colors = dict(zip(shown, (_WHITE, *_COLORS), strict=False))
    for name, states in shown.items():
        own = replace(track, group=name, colors=Colors(system=colors[name], bodies=colors[name]))
        log_scene(own, scene, _whole(states))  # one that runs away stays where it was last
        if name != MEASURED:
            path = entity(WORLD, name, MEASURED)
            log_tails(track, path, scene.marker(seen)[:, None], _WHITE, 1.0)
    for x, state in enumerate(naming.states):
        log_dots(track, entity(STATES, state, MEASURED), clip.measured[:, x], _WHITE, 1.2)
        for name, states in clip.models.items():
            log_line(track, entity(STATES, state, name), 0, states[:, x], colors[name])
    for u, command in enumerate(naming.inputs):
        path = entity(INPUTS, command, MEASURED)
        log_line(track, path, 0, clip.inputs[:, u], _WHITE, "StepAfter")
    log_note(track.rec, clip.note, track.start_s, track.first)


def _whole(states: Float[np.ndarray, "T X"]) -> Float[np.ndarray, "T X"]:
    """States with their gaps bridged, for a picture; 0 where nothing is known."""
    whole = bridged(states)
    return np.where(np.isfinite(whole), whole, 0.0)


def _blueprint(clips: Sequence[Clip], naming: Naming, scene: Scene) -> rr.blueprint.Blueprint:
    titles = {entity(STATES, name): f"{name} [{unit}]" for name, unit in naming.states.items()}
    titles |= {
        entity(INPUTS, name): f"{name} [{unit}]" if unit else name
        for name, unit in naming.inputs.items()
    }
    states = np.concatenate([_whole(clip.measured) for clip in clips])
    points = [*(pose.translation for pose in scene.poses(states).values()), scene.marker(states)]
    points += [np.array([position]) for _, position in scene.fixed]
    names = (MEASURED, *clips[0].models)
    return build_side_by_side(
        titles, {entity(WORLD, name): name for name in names}, np.concatenate(points)
    )


CLIPS = 12
"""windows at most"""


def write_gap_film(gap: Gap, path: Path) -> Path:
    """The path of the recording written; the window that is missed most comes first.

    Raises:
        InputError: the recordings were too poor to compare anything.
        RunFolderError: the file cannot be written.
    """
    if gap.comparison is None or gap.models is None:
        raise InputError("a film needs models that were compared; the recordings are too poor.")
    found, names = gap.comparison, gap.models.shown
    errors = {
        name: np.sqrt(np.nanmean(squares_at_end(scaled_errors(found.windows, y)), axis=1))
        for name, y in found.runs.items()
    }
    order = sorted(_apart(found), key=lambda w: -errors[names[0]][w])
    clips = [_window_clip(gap, found, w, names, errors) for w in order[:CLIPS]]
    layout = gap.plant.layout
    naming = Naming(
        states=dict(zip(layout.states, layout.units, strict=True)),
        inputs={n: layout.unit_of(layout.actuator(u))[1] for u, n in enumerate(layout.inputs)},
    )
    name = gap.plant.name
    return write_side_by_side(path, clips, found.windows.dt, naming, scene_of(gap.plant), name)


def _window_clip(
    gap: Gap, found: Comparison, w: int, names: tuple[str, ...], errors: dict[str, np.ndarray]
) -> Clip:
    windows = found.windows
    start = float(windows.start_s[w])
    title = f"### {gap.compared[windows.recording[w]]}, from {start:.1f} s"
    away = {name: found.runs_away_s(name)[w] for name in names}
    told = ", ".join(
        f"{name} **{three_digits(errors[name][w])}**"
        if np.isinf(after)
        else f"{name} **none: it runs away after {after:.2g} s**"
        for name, after in away.items()
    )
    colors = ", ".join(f"{c}: {n}" for c, n in zip(("Orange", "blue"), names, strict=False))
    words = f"White: measured. {colors}, in free runs."
    return Clip(
        note=f"{title}\n\nError at the end, in noise std: {told}\n\n{words}",
        measured=windows.y[w].T,
        inputs=windows.commands[w, windows.lead :],
        models={name: found.runs[name][w].T for name in names},
    )


def _apart(found: Comparison) -> list[int]:
    windows, chosen = found.windows, []
    length = windows.y.shape[2] * windows.dt
    end, last = -np.inf, -1
    for w, (n, start) in enumerate(zip(windows.recording, windows.start_s, strict=True)):
        if n != last or start >= end - 1e-9:
            chosen.append(w)
            end, last = start + length, n
    return chosen


def write_crossing_film(path: Path, legs: Mapping[str, Crossing], scene: Scene, name: str) -> Path:
    """The path of the recording written: an episode of each policy on the system and as promised.

    Raises:
        RunFolderError: the file cannot be written.
    """
    first = next(iter(legs.values()))
    naming = Naming(states=dict(first.states), inputs=dict(first.inputs))
    clips = [_episode_clip(leg, found) for leg, found in legs.items()]
    return write_side_by_side(path, clips, first.dt, naming, scene, name)


def _episode_clip(leg: str, found: Crossing) -> Clip:
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
