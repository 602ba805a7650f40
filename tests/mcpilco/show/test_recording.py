from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from mcpilco.show.recording import write_recording
from mcpilco.show.viewer import _executable
from mcpilco.typing import RunFolderError

THREADS = Path("/proc/self/task")
STATES = ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")
NAME = "trial 3"
PROPERTIES = {"seed": 0, "real_cost": 9.5, "success": True, "time_up_s": None}


def rrd(*arguments) -> int:
    return subprocess.run(
        [_executable(), "rrd", *map(str, arguments)], capture_output=True
    ).returncode


def chunks(path) -> dict[str, list]:
    """Chunks with data over time, by entity."""
    found: dict[str, list] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.is_static:
            found.setdefault(chunk.entity_path.lstrip("/"), []).append(chunk)
    return found


def column(path, entity, component) -> list:
    """The rows of one component over time."""
    (chunk,) = chunks(path)[entity]
    batch = chunk.to_record_batch()
    (name,) = [n for n in batch.schema.names if n.endswith(component)]
    return batch.column(name).to_pylist()


def static_entities(path) -> set[str]:
    return {c.entity_path.lstrip("/") for c in RrdReader(path).stream() if c.is_static}


@pytest.fixture
def path(tmp_path, rollout, prediction, task, scene):
    return write_recording(tmp_path / "01.rrd", rollout, prediction, task, scene, NAME, PROPERTIES)


def test_recording_is_verified_by_rerun(path) -> None:
    assert rrd("verify", path) == 0


def test_recording_holds_every_curve_with_its_rows(path, rollout) -> None:
    steps = len(rollout)
    rows = {entity: sum(c.num_rows for c in found) for entity, found in chunks(path).items()}
    curves = {
        f"states/{s}/{kind}": steps + 1
        for s in STATES
        for kind in ("system", "observed", "particles", "predicted")
    }
    curves |= {
        f"{group}/{kind}": steps
        for group in ("inputs/force", "cost")
        for kind in ("system", "particles", "predicted")
    }
    moving = ("bodies/cart", "bodies/pole", "tail", "particles", "particle_tails")
    assert rows == curves | {f"world/{name}": steps + 1 for name in moving}


def test_recording_holds_the_still_parts_of_the_scene(path) -> None:
    assert static_entities(path) >= {"world", "world/fixed/0", "world/target", "about"}


def test_timelines_are_simulated_time_and_steps_only(path) -> None:
    names = {
        name for found in chunks(path).values() for chunk in found for name in chunk.timeline_names
    }
    assert names == {"sim_time", "step"}


def test_costs_stand_at_the_end_of_their_step(path, rollout) -> None:
    (chunk,) = chunks(path)["cost/system"]
    batch = chunk.to_record_batch()
    assert batch.column("step").to_pylist() == list(range(1, len(rollout) + 1))
    seconds = [time.total_seconds() for time in batch.column("sim_time").to_pylist()]
    np.testing.assert_allclose(seconds, rollout.times[1:], atol=1e-9)
    values = column(path, "cost/system", "scalars")
    np.testing.assert_allclose(np.ravel(values), 1 - rollout.rewards)


def test_particles_of_a_step_are_one_row_of_points(path, prediction, scene) -> None:
    positions = column(path, "world/particles", "positions")
    assert {len(row) for row in positions} == {prediction.states.shape[1]}
    np.testing.assert_allclose(positions, scene.marker(prediction.states), atol=1e-6)


def test_tail_ends_at_the_marker_and_never_leaves_its_path(path, rollout, scene) -> None:
    markers = scene.marker(rollout.states)
    for k, strips in enumerate(column(path, "world/tail", "strips")):
        (strip,) = strips
        np.testing.assert_allclose(strip[-1], markers[k], atol=1e-6)
        np.testing.assert_allclose(strip[0], markers[max(k - 8, 0)], atol=1e-6)  # 0.8 s


def test_predicted_curve_is_the_median_and_thirty_particles_are_beside_it(path, prediction) -> None:
    predicted = column(path, "states/pole_angle/predicted", "scalars")
    np.testing.assert_allclose(np.ravel(predicted), np.median(prediction.states[..., 2], axis=1))
    assert {len(row) for row in column(path, "states/pole_angle/particles", "scalars")} == {30}


def test_capsule_is_centred_at_its_body(path) -> None:
    """Rerun's capsule starts at its origin and runs along +z, ours is centred."""
    (chunk,) = [
        c for c in RrdReader(path).stream()
        if c.entity_path == "/world/bodies/pole" and c.is_static
    ]  # fmt: skip
    batch = chunk.to_record_batch()
    (lengths,) = [n for n in batch.schema.names if n.endswith("lengths")]
    (shifts,) = [n for n in batch.schema.names if n.endswith("translations")]
    length = batch.column(lengths).to_pylist()[0][0]
    np.testing.assert_allclose(
        batch.column(shifts).to_pylist()[0][0], [0, 0, -length / 2], atol=1e-6
    )


@pytest.mark.skipif(not THREADS.is_dir(), reason="the system does not list threads as files")
def test_a_recording_that_is_written_leaves_no_thread(rollout, task, tmp_path) -> None:
    """But for the two that Rerun 0.41 keeps of a blueprint."""
    counts = []
    for _ in range(4):
        write_recording(tmp_path / "01.rrd", rollout, None, task, None, NAME)
        counts.append(len(list(THREADS.iterdir())))
    assert counts[-1] <= counts[0] + 3 * 2


def test_equal_rollouts_make_equal_recordings(
    path, tmp_path, rollout, prediction, task, scene
) -> None:
    again = write_recording(
        tmp_path / "again.rrd", rollout, prediction, task, scene, NAME, PROPERTIES
    )
    assert rrd("compare", path, again) == 0
    other = write_recording(tmp_path / "other.rrd", rollout, None, task, scene, NAME, PROPERTIES)
    assert rrd("compare", path, other) != 0


def test_rollouts_of_one_name_are_told_apart(
    path, tmp_path, rollout, prediction, task, scene
) -> None:
    rollout.inputs[3] += 1.0
    other = write_recording(tmp_path / "other.rrd", rollout, prediction, task, scene, NAME)
    (one,), (two,) = (RrdReader(p).recordings() for p in (path, other))
    assert one.recording_id != two.recording_id
    assert one.recording_id.startswith(NAME)


def test_recording_opens_with_a_blueprint(path) -> None:
    assert len(RrdReader(path).blueprints()) == 1


def test_exploration_has_no_particles(tmp_path, rollout, task, scene) -> None:
    path = write_recording(tmp_path / "00.rrd", rollout, None, task, scene, "random")
    assert not [e for e in chunks(path) if "particles" in e or "predicted" in e]
    assert rrd("verify", path) == 0


def test_without_a_scene_there_are_curves_only(tmp_path, rollout, prediction, task) -> None:
    path = write_recording(tmp_path / "01.rrd", rollout, prediction, task, None, NAME)
    assert not [e for e in chunks(path) if e.startswith("world")]
    assert "cost/system" in chunks(path)


def test_names_may_hold_any_character(tmp_path, rollout, task) -> None:
    odd = type(task)(**{**vars(task), "state_names": ("x / y", "é", "pole angle", "#0")})
    path = write_recording(tmp_path / "01.rrd", rollout, None, odd, None, NAME)
    assert rrd("verify", path) == 0
    assert len([e for e in chunks(path) if e.startswith("states") and e.endswith("system")]) == 4


def test_failed_recording_leaves_the_old_one_and_nothing_else(
    path, rollout, prediction, task, scene
) -> None:
    before = path.read_bytes()
    broken = type(scene)(**{**vars(scene), "marker": lambda states: 1 / 0})
    with pytest.raises(ZeroDivisionError):
        write_recording(path, rollout, prediction, task, broken, NAME)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_recording_replaces_the_old_one(path, rollout, task, scene) -> None:
    write_recording(path, rollout, None, task, scene, NAME)
    assert "world/particles" not in chunks(path)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("place", ["file/01.rrd", "folder"])
def test_unwritable_place_is_answered_with_a_sentence(tmp_path, place, rollout, task) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(
        RunFolderError, match="Cannot write .*; (choose another folder|name another file)"
    ):
        write_recording(tmp_path / place, rollout, None, task, None, NAME)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]
