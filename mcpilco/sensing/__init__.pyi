from .estimator import LinearObserver
from .foresight import Foresight
from .noise import sensor_noise
from .observing import TURN, state_of, state_view
from .perception import Perception, foreign_state
from .state_predictor import StatePredictor
from .tracking import StateTracker

__all__ = [
    "TURN",
    "Foresight",
    "LinearObserver",
    "Perception",
    "StatePredictor",
    "StateTracker",
    "foreign_state",
    "sensor_noise",
    "state_of",
    "state_view",
]
