"""A ROS bag is read as the table of what its topics say at the stamps of the joint states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcpilco.recordings import read_recording
from mcpilco.recordings.ros_bag import read_bag
from mcpilco.typing import RecordingError

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="reads bags; in the extra ros")

N, BEGUN = 50, 1_700_000_000


def bag(folder: Path, joints: bool = True) -> Path:
    """Two joints at 50 Hz, in the order of the driver, a target of one of them, and a base."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)

    def make(kind: str, *content: Any) -> Any:
        return types.types[kind](*content)

    def header(k: float) -> Any:
        sec, part = divmod(round(0.02e9 * k), 10**9)
        stamp = make("builtin_interfaces/msg/Time", BEGUN + sec, part)
        return make("std_msgs/msg/Header", stamp, "world")

    kinds = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/targets": "std_msgs/msg/Float64MultiArray",
        "/base": "geometry_msgs/msg/PoseStamped",
        "/log": "std_msgs/msg/String",
    }
    with rosbag2.Writer(folder / "log", version=9) as writer:
        topics = {
            name: writer.add_connection(name, kind, typestore=types) for name, kind in kinds.items()
        }

        def write(topic: str, k: float, message: Any) -> None:
            raw = types.serialize_cdr(message, kinds[topic])
            writer.write(topics[topic], BEGUN * 10**9 + round(0.02e9 * k), raw)

        write("/log", 0, make("std_msgs/msg/String", "begun"))
        layout = make("std_msgs/msg/MultiArrayLayout", [], 0)
        for k in range(N if joints else 0):
            q = np.array([np.sin(0.1 * k), 0.01 * k])
            state = make(kinds["/joint_states"], header(k), ["elbow", "wrist"], q, q[:0], q[:0])
            write("/joint_states", k, state)
        for k in range(0, N, 5):
            content = np.array([k, -k], dtype=float)
            write("/targets", k - 0.5, make(kinds["/targets"], layout, content))
            at = make("geometry_msgs/msg/Point", 0.1 * k, 0.0, 0.3)
            turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(0.1), np.cos(0.1))
            pose = make("geometry_msgs/msg/Pose", at, turn)
            write("/base", k, make(kinds["/base"], header(k), pose))
    return folder / "log"


def test_joints_targets_and_poses_come_at_the_stamps_of_the_joints(tmp_path: Path) -> None:
    columns, k = read_bag(bag(tmp_path)), np.arange(N)
    np.testing.assert_allclose(columns["time"], 0.02 * k, atol=1e-12)
    np.testing.assert_allclose(columns["elbow_position"], np.sin(0.1 * k))
    np.testing.assert_array_equal(columns["/targets/1"], -(k // 5 * 5.0))  # the last that was sent
    np.testing.assert_allclose(columns["/base/x"][: N - 4], 0.1 * k[: N - 4], atol=1e-9)
    assert np.isnan(columns["/base/x"][-1])  # later than the last pose
    np.testing.assert_allclose(columns["/base/rz"][: N - 4], 0.2)
    assert "elbow_velocity" not in columns  # which the driver left empty


def test_a_bag_is_a_recording_with_a_map_of_its_columns(tmp_path: Path) -> None:
    recording = read_recording(
        bag(tmp_path),
        ("wrist_position", "wrist_velocity"),
        ("motor",),
        velocities=((0, 1),),
        columns={"motor": "/targets/0@deg"},
    )
    assert recording.dt == pytest.approx(0.02)
    np.testing.assert_allclose(recording.states[:, 0], 0.01 * np.arange(N), atol=1e-9)
    np.testing.assert_allclose(recording.inputs[7], np.radians(5.0))


def test_a_bag_without_joint_states_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="expected a topic of sensor_msgs/JointState, got /"):
        read_bag(bag(tmp_path, joints=False))


def test_a_damaged_bag_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"nothing of a bag")
    with pytest.raises(RecordingError, match="is no ROS bag that can be read"):
        read_bag(tmp_path / "log.mcap")
