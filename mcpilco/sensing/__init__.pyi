from .delay import DelayModel, StatePredictor, StateTracker, Track, sensor_noise
from .estimator import Chain, LinearEstimator, Observer, PastInputs, chained
from .perception import TURN, Perception, state_of, state_view

__all__ = [
    "TURN",
    "Chain",
    "DelayModel",
    "LinearEstimator",
    "Observer",
    "PastInputs",
    "Perception",
    "StatePredictor",
    "StateTracker",
    "Track",
    "chained",
    "sensor_noise",
    "state_of",
    "state_view",
]
