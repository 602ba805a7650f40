"""Collisions from motor currents alone: what they should be, and when they are not."""

from mcpilco.identification.collision.checks import about_unidentified, check_free, unidentified
from mcpilco.identification.collision.detector import (
    CollisionDetector,
    Detection,
    Detections,
    Event,
    Sample,
    detect,
    events,
)
from mcpilco.identification.collision.features import TERMS, CurrentFeatures, quiet
from mcpilco.identification.collision.file import load_collision_model, save_collision_model
from mcpilco.identification.collision.model import CurrentConfig, CurrentModel, fit_currents
from mcpilco.identification.collision.thresholds import (
    ThresholdConfig,
    Thresholds,
    debounced,
    thresholds,
)
from mcpilco.recordings import FORCE, ArmRecording, ArmSamples, columns_of, read_arm, samples_of

__all__ = [
    "FORCE",
    "TERMS",
    "ArmRecording",
    "ArmSamples",
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
    "columns_of",
    "debounced",
    "detect",
    "events",
    "fit_currents",
    "load_collision_model",
    "quiet",
    "read_arm",
    "samples_of",
    "save_collision_model",
    "thresholds",
    "unidentified",
]
