"""The robots: MJCF files in this folder."""

from __future__ import annotations

from pathlib import Path

import mujoco

from mcpilco.typing import InputError

ARMS = {path.stem: path for path in sorted(Path(__file__).parent.glob("*.xml"))}
"""by name: `vision_head`, 7 joints, and `arm_hand`, 10"""


def load(name: str) -> mujoco.MjModel:
    """The model of a robot.

    Raises:
        InputError: there is no robot of this name.
    """
    if name not in ARMS:
        raise InputError(f"name must be one of {', '.join(ARMS)}, got {name!r}.")
    return mujoco.MjModel.from_xml_path(str(ARMS[name]))
