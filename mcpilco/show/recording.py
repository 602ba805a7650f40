"""A rollout on the system beside the particles predicted for it, as a Rerun recording (.rrd)."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun_bindings
from jaxtyping import Float

from mcpilco.data import Prediction, Rollout
from mcpilco.files import write_bytes
from mcpilco.policies import costs_of
from mcpilco.show.blueprint import ABOUT, TIMELINE, build_blueprint
from mcpilco.show.entities import COLORS_IN_WORDS, Track, log_curves, log_particles, log_scene
from mcpilco.show.scene import Scene
from mcpilco.task import TaskSpec

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
    known: Any = {key: value for key, value in (properties or {}).items() if value is not None}
    with new_recording(path, name, (rollout.observations, rollout.inputs)) as rec:
        rec.send_blueprint(build_blueprint(task, extent_of(scene, rollout)))
        rec.send_recording_name(name)
        if known:
            rec.send_property("run", rr.AnyValues(**known))
        track = Track(rec, rollout.dt)
        track.still(ABOUT, rr.TextDocument(_notes(name, known), media_type="text/markdown"))
        if scene is not None:
            log_scene(track, scene, rollout.shown_states)
            if prediction is not None:
                log_particles(track, scene, prediction)
        log_curves(track, task, rollout, prediction, costs_of(task.cost, rollout))
    return path


@contextlib.contextmanager
def new_recording(
    path: Path, name: str, shown: Iterable[np.ndarray]
) -> Iterator[rr.RecordingStream]:
    """A recording that is written when the context ends, whole or not at all.

    What Rerun writes itself names no cause where it fails.

    The arrays `shown` make its identity: equal for equal ones, another for two of one name.

    Raises:
        RunFolderError: the file cannot be written.
    """
    digest = hashlib.blake2b(b"".join(array.tobytes() for array in shown), digest_size=6)
    identity = f"{name}-{digest.hexdigest()}"
    rerun_bindings.flush_and_cleanup_orphaned_recordings()  # which keep their threads until then
    # Rerun's own properties hold the time of day, which would make equal rollouts unequal files.
    rec = rr.RecordingStream("mcpilco", recording_id=identity, send_properties=False)
    stream = rr.binary_stream(rec)
    yield rec
    content = stream.read()
    rec.disconnect()
    with contextlib.suppress(OSError):  # the writing then says what is wrong
        path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content or b"")


def log_note(rec: rr.RecordingStream, text: str, start_s: float, first: int) -> None:
    """Show notes in Markdown from an instant on, of the time [s] and the step."""
    index = [rr.TimeColumn(TIMELINE, duration=[start_s]), rr.TimeColumn("step", sequence=[first])]
    columns = rr.TextDocument.columns(text=[text], media_type=["text/markdown"])
    rec.send_columns(ABOUT, index, columns)


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
