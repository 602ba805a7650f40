"""ROS bags as named columns: what joints, commands and a base did, a row a joint state.

| message | columns |
|---|---|
| `sensor_msgs/JointState` of `joint_states` | `<joint>_position`, `_velocity`, `_effort` |
| the same of another topic | `<topic>/<joint>_position`, ... |
| `trajectory_msgs/JointTrajectory` | `<topic>/<joint>`, of its first point |
| `std_msgs/Float64MultiArray` | `<topic>/0`, `<topic>/1`, ... |
| `std_msgs/Float64` | `<topic>` |
| `geometry_msgs/PoseStamped`, `nav_msgs/Odometry` | `<topic>/x` to `/z` [m], `/rx` to `/rz` [rad] |

An orientation is its rotation vector. Commands are the last ones that were sent by the time of a
row, joint states of other topics too; poses are interpolated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.typing import RecordingError

Readings = dict[str, float]
"""of one message, by what stands behind its topic"""
STATES = "joint_states"
"""end of the topic whose messages are rows"""


def is_bag(path: Path) -> bool:
    """Whether a file, or a folder, is a bag of ROS 1 or 2."""
    return path.suffix in (".bag", ".mcap", ".db3") or (path / "metadata.yaml").is_file()


def read_bag(path: Path) -> dict[str, Float[np.ndarray, " N"]]:
    """The columns of a bag, and `time` [s], see above.

    Raises:
        RecordingError: it is missing or damaged, has no joint states, or rosbags is not installed.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise RecordingError(
            f'{path}: reading a ROS bag needs rosbags; pip install "mcpilco[ros]", or save it as '
            "CSV."
        ) from None
    topics: dict[str, tuple[str, list[tuple[int, Readings]]]] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            wanted = [c for c in bag.connections if c.msgtype in _READERS]
            for connection, received, raw in bag.messages(wanted) if wanted else ():
                message = bag.deserialize(raw, connection.msgtype)
                _, found = topics.setdefault(connection.topic, (connection.msgtype, []))
                found.append((_sent(message, received), _READERS[connection.msgtype](message)))
    except Exception as error:  # rosbags raises almost anything from damaged bytes
        raise RecordingError(f"{path} is no ROS bag that can be read: {error}.") from error
    rows = [topic for topic, (kind, _) in topics.items() if kind == _JOINTS]
    if not rows:
        told = ", ".join(topics) or "none that is read"
        raise RecordingError(f"{path}: expected a topic of sensor_msgs/JointState, got {told}.")
    return _side_by_side(topics, min(rows, key=lambda topic: not topic.endswith(STATES)))


def _side_by_side(
    topics: dict[str, tuple[str, list[tuple[int, Readings]]]], rows: str
) -> dict[str, Float[np.ndarray, " N"]]:
    """The columns of all topics at the stamps of one; times are counted from its first."""
    stamps = np.array([sent for sent, _ in topics[rows][1]])
    columns = {"time": 1e-9 * (stamps - stamps[0])}
    for topic, (kind, messages) in topics.items():
        sent = np.array([at for at, _ in messages])
        for name in messages[0][1]:
            values = np.array([readings.get(name, np.nan) for _, readings in messages])
            if topic == rows:
                columns[name] = values
                continue
            if kind in _POSES:
                read = np.interp(stamps - sent[0], sent - sent[0], values, np.nan, np.nan)
            else:
                last = np.searchsorted(sent, stamps, side="right") - 1
                read = np.where(last < 0, np.nan, values[last])
            columns[f"{topic}/{name}".rstrip("/")] = read
    return columns


def _sent(message: Any, received: int) -> int:
    """When it was measured or sent, by its header, else when the bag received it [ns]."""
    header = getattr(message, "header", None)
    if header is None:
        return received
    stamp = header.stamp
    return int(stamp.sec * 10**9 + stamp.nanosec) or received


def _of_joints(message: Any) -> Readings:
    kinds = ("position", "velocity", "effort")
    return dict(_named(message.name, {kind: getattr(message, kind) for kind in kinds}))


def _named(joints: list[str], kinds: dict[str, Any]) -> Iterator[tuple[str, float]]:
    for kind, values in kinds.items():
        for joint, value in zip(joints, values, strict=False):  # what is not measured is empty
            yield f"{joint}_{kind}", float(value)


def _of_trajectory(message: Any) -> Readings:
    first = message.points[0].positions if message.points else ()
    return dict(zip(message.joint_names, map(float, first), strict=False))


def _of_pose(message: Any) -> Readings:
    from scipy.spatial.transform import Rotation

    pose = getattr(message.pose, "pose", message.pose)  # with a covariance around it
    at, turn = pose.position, pose.orientation
    vector = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_rotvec()
    return dict(zip(("x", "y", "z", "rx", "ry", "rz"), (at.x, at.y, at.z, *vector), strict=True))


_JOINTS = "sensor_msgs/msg/JointState"
_POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Odometry",
)
_READERS: dict[str, Callable[[Any], Readings]] = {
    _JOINTS: _of_joints,
    "trajectory_msgs/msg/JointTrajectory": _of_trajectory,
    "std_msgs/msg/Float64MultiArray": lambda m: {str(k): float(x) for k, x in enumerate(m.data)},
    "std_msgs/msg/Float64": lambda message: {"": float(message.data)},
    **dict.fromkeys(_POSES, _of_pose),
}
