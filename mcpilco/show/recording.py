"""A rollout on the system beside the particles predicted for it, as a Rerun recording (.rrd)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float

from mcpilco.data import Prediction, Rollout
from mcpilco.files import write_bytes
from mcpilco.policies import costs_of
from mcpilco.show.blueprint import ABOUT, build_blueprint
from mcpilco.show.entities import COLORS_IN_WORDS, Track, log_curves, log_particles, log_scene
from mcpilco.show.scene import Scene
from mcpilco.task import TaskSpec
from mcpilco.typing import RunFolderError

Property = str | float | bool | None


def write_recording(
    path: str | Path,
    rollout: Rollout,
    prediction: Prediction | None,
    task: TaskSpec,
    scene: Scene | None,
    name: str,
    properties: Mapping[str, Property] | None = None,
) -> Path:
    """The path of the recording written: one rollout on the system, over `sim_time` and `step`.

    The file appears whole or not at all; equal arguments make recordings that
    `rerun rrd compare` calls equal.

    Args:
        path: where the .rrd file goes; missing folders are made, an existing file is replaced.
        rollout: the episode on the system.
        prediction: the particles predicted for it; None for a rollout that no model foresaw.
        task: names and units.
        scene: how to draw a state in 3D; None leaves the curves alone.
        name: what the viewer calls the recording.
        properties: what else is known of it, shown in the notes; None is left out.

    Raises:
        RunFolderError: the file cannot be written.
    """
    path = Path(path)
    known = {key: value for key, value in (properties or {}).items() if value is not None}
    return write_file(path, _recording(rollout, prediction, task, scene, name, known))


def write_file(path: Path, content: bytes) -> Path:
    """The path of the file written, whole or not at all; missing folders are made.

    Raises:
        RunFolderError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(
            f"Cannot write {path}: {error.strerror or error}; choose another folder."
        ) from error
    return write_bytes(path, content)


def _recording(
    rollout: Rollout,
    prediction: Prediction | None,
    task: TaskSpec,
    scene: Scene | None,
    name: str,
    properties: dict[str, Any],
) -> bytes:
    """The content of the file; what Rerun writes itself names no cause where it fails."""
    # Rerun's own properties hold the time of day, which would make equal rollouts unequal files.
    rec = rr.RecordingStream(
        "mcpilco", recording_id=_identity(name, rollout), send_properties=False
    )
    content = rr.binary_stream(rec)
    rec.send_blueprint(build_blueprint(task, extent_of(scene, rollout)))
    rec.send_recording_name(name)
    if properties:
        rec.send_property("run", rr.AnyValues(**properties))
    track = Track(rec, rollout.dt)
    track.still(ABOUT, rr.TextDocument(_notes(name, properties), media_type="text/markdown"))
    if scene is not None:
        log_scene(track, scene, rollout.shown_states)
        if prediction is not None:
            log_particles(track, scene, prediction)
    costs = costs_of(task.cost, rollout)
    log_curves(track, task, rollout, prediction, costs)
    written = content.read()
    rec.disconnect()
    return written or b""


def _identity(name: str, rollout: Rollout) -> str:
    """Equal for equal rollouts; different for two runs' rollouts of one name, to see both."""
    content = rollout.observations.tobytes() + rollout.inputs.tobytes()
    return f"{name}-{hashlib.blake2b(content, digest_size=6).hexdigest()}"


def _notes(name: str, properties: Mapping[str, Property]) -> str:
    shown = [
        f"{key} **{value:.4g}**" if isinstance(value, float) else f"{key} **{value}**"
        for key, value in properties.items()
    ]
    return "\n\n".join([f"### {name}", ", ".join(shown), COLORS_IN_WORDS])


def extent_of(scene: Scene | None, rollout: Rollout) -> Float[np.ndarray, "N 3"] | None:
    """Where the bodies, the marker and the target are during the rollout [m]."""
    if scene is None:
        return None
    states = rollout.shown_states
    points = [*(pose.translation for pose in scene.poses(states).values()), scene.marker(states)]
    if scene.target is not None:
        points.append(np.array([scene.target]))
    return np.concatenate(points)
