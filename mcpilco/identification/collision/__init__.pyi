from .detector import (
    CollisionDetector,
    Detection,
    Detections,
    Event,
    Sample,
    ThresholdConfig,
    Thresholds,
    debounced,
    detect,
    events,
    thresholds,
)
from .features import (
    CURRENT_TERMS,
    CurrentFeatures,
    about_unidentified,
    check_free,
    quiet,
    unidentified,
)
from .file import load_collision_model, save_collision_model
from .model import CurrentConfig, CurrentModel, fit_currents

__all__ = [
    "CURRENT_TERMS",
    "CollisionDetector",
    "CurrentConfig",
    "CurrentFeatures",
    "CurrentModel",
    "Detection",
    "Detections",
    "Event",
    "Sample",
    "ThresholdConfig",
    "Thresholds",
    "about_unidentified",
    "check_free",
    "debounced",
    "detect",
    "events",
    "fit_currents",
    "load_collision_model",
    "quiet",
    "save_collision_model",
    "thresholds",
    "unidentified",
]
