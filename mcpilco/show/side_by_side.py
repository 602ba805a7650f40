"""A measured motion beside those that models make of it, as a Rerun recording (.rrd)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rerun as rr
from jaxtyping import Float

from mcpilco.show.blueprint import (
    ABOUT,
    INPUTS,
    STATES,
    TIMELINE,
    WORLD,
    build_side_by_side,
    entity,
)
from mcpilco.show.entities import (
    RGB,
    Colors,
    Track,
    log_dots,
    log_line,
    log_scene,
    log_tails,
)
from mcpilco.show.recording import write_file
from mcpilco.show.scene import Scene

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

    Args:
        path: where the .rrd file goes; missing folders are made, an existing file is replaced.
        clips: at least one, all of the same models.
        dt: sampling time [s].
        naming: of states and inputs.
        scene: how to draw a state in 3D.
        name: what the viewer calls the recording.

    Raises:
        RunFolderError: the file cannot be written.
    """
    rec = rr.RecordingStream("mcpilco", recording_id=_identity(name, clips), send_properties=False)
    content = rr.binary_stream(rec)
    rec.send_blueprint(_blueprint(clips, naming, scene))
    rec.send_recording_name(name)
    first = 0
    for clip in clips:
        _log(Track(rec, dt, start_s=first * dt, first=first, gap=True), clip, naming, scene)
        first += len(clip.measured) + max(round(_PAUSE_S / dt), 2)
    written = content.read()
    rec.disconnect()
    return write_file(path, written or b"")


def _log(track: Track, clip: Clip, naming: Naming, scene: Scene) -> None:
    """One clip."""
    seen = _whole(clip.measured)
    shown = {MEASURED: seen, **clip.models}
    colors = dict(zip(shown, (_WHITE, *_COLORS), strict=False))
    for name, states in shown.items():
        own = replace(track, group=name, colors=Colors(system=colors[name], bodies=colors[name]))
        log_scene(own, scene, states)
        if name != MEASURED:
            path = entity(WORLD, name, MEASURED)
            log_tails(track, path, scene.marker(seen)[:, None], _WHITE, 1.0)
    for x, state in enumerate(naming.states):
        log_dots(track, entity(STATES, state, MEASURED), 0, clip.measured[:, x], _WHITE, 1.2)
        for name, states in clip.models.items():
            log_line(track, entity(STATES, state, name), 0, states[:, x], colors[name])
    for u, command in enumerate(naming.inputs):
        path = entity(INPUTS, command, MEASURED)
        log_line(track, path, 0, clip.inputs[:, u], _WHITE, "StepAfter")
    index = [
        rr.TimeColumn(TIMELINE, duration=[track.start_s]),
        rr.TimeColumn("step", sequence=[track.first]),
    ]
    note = rr.TextDocument.columns(text=[clip.note], media_type=["text/markdown"])
    track.rec.send_columns(ABOUT, index, note)


def _whole(states: Float[np.ndarray, "T X"]) -> Float[np.ndarray, "T X"]:
    """States with their gaps bridged, for a picture; 0 where nothing was measured."""
    rows = np.arange(len(states))
    whole = np.zeros_like(states)
    for x, values in enumerate(states.T):
        known = np.isfinite(values)
        if known.any():
            whole[:, x] = np.interp(rows, rows[known], values[known])
    return whole


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


def _identity(name: str, clips: Sequence[Clip]) -> str:
    digest = hashlib.blake2b(digest_size=6)
    for clip in clips:
        for array in (clip.measured, clip.inputs, *clip.models.values()):
            digest.update(np.ascontiguousarray(array).tobytes())
    return f"{name}-{digest.hexdigest()}"
