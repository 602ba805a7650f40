"""The robots: MJCF files in this folder."""

from __future__ import annotations

from pathlib import Path

import mujoco

from mcpilco.typing import InputError

ARMS = {name: Path(__file__).with_name(f"{name}.xml") for name in ("arm_hand", "vision_head")}
"""robots with motors that follow a reference, by name: 10 and 7 joints"""


def load(name: str) -> mujoco.MjModel:
    """The model of a robot.

    Raises:
        InputError: there is no robot of this name.
    """
    if name not in ARMS:
        raise InputError(f"name must be one of {', '.join(ARMS)}, got {name!r}.")
    return mujoco.MjModel.from_xml_path(str(ARMS[name]))
