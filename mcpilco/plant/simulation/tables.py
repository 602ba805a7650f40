"""The numbers of S systems of one plant, as arrays for the compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mcpilco.bodies import Chains
from mcpilco.plant.simulation.learned import Learned

GAIN, DEAD_ZONE, LIMIT, DELAY, LAG, PLAY, RANGE = range(7)
"""columns of `Tables.actuators`: [-], [force], [force], [s], [s], [force], [command]"""
OFFSET, SCALE, LATENCY = range(3)
"""columns of `Tables.sensors`: [state], [-], [s]"""
IDEAL_ACTUATOR = (1.0, 0.0, np.inf, 0.0, 0.0, 0.0, np.inf)
IDEAL_SENSOR = (0.0, 1.0, 0.0)


class Tables(NamedTuple):
    """Everything that a simulation must know of S systems."""

    chains: Chains
    """their bodies"""
    law: Int[np.ndarray, " L"]
    """forces in joints: which formula of `mcpilco.plant.simulation.laws`"""
    joint: Int[np.ndarray, " L"]
    """the joint of each"""
    constants: Float[np.ndarray, "S L 4"]
    """the constants a, b, c, d of each"""
    drives: Int[np.ndarray, " U"]
    """the joint that each input drives"""
    actuators: Float[np.ndarray, "S U 7"]
    """from command to force, see `GAIN` to `RANGE`"""
    sensors: Float[np.ndarray, "S X 3"]
    """from state to measurement, see `OFFSET` to `LATENCY`"""
    learned: Learned
    """forces in joints that no formula gives"""
