"""The catalogue of named physical effects.

    command -> [actuator] -> input -> [joint, inertial] -> state -> [sensor] -> measurement

An effect is one class with one formula; its name is public vocabulary.
"""

from mcpilco.plant.effects.actuator import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorLag,
    ActuatorSaturation,
    Backlash,
)
from mcpilco.plant.effects.base import Effect, Place, Probe, Scale, Symbol
from mcpilco.plant.effects.inertial import Armature, BodyInertia, BodyMass, CenterOfMass
from mcpilco.plant.effects.joint import (
    AsymmetricFriction,
    ConstantForce,
    CoulombFriction,
    HardeningSpring,
    PositionRipple,
    QuadraticDrag,
    Spring,
    StribeckFriction,
    ViscousFriction,
)
from mcpilco.plant.effects.sensor import SensorDelay, SensorOffset, SensorScale

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        ViscousFriction(),
        CoulombFriction(),
        StribeckFriction(),
        QuadraticDrag(),
        AsymmetricFriction(),
        Spring(),
        HardeningSpring(),
        ConstantForce(),
        PositionRipple(),
        BodyMass(),
        CenterOfMass(),
        BodyInertia(),
        Armature(),
        ActuatorGain(),
        ActuatorDeadZone(),
        ActuatorSaturation(),
        ActuatorDelay(),
        ActuatorLag(),
        Backlash(),
        SensorOffset(),
        SensorScale(),
        SensorDelay(),
    )
}
"""all effects, by name"""

__all__ = [
    "CATALOGUE",
    "ActuatorDeadZone",
    "ActuatorDelay",
    "ActuatorGain",
    "ActuatorLag",
    "ActuatorSaturation",
    "Armature",
    "AsymmetricFriction",
    "Backlash",
    "BodyInertia",
    "BodyMass",
    "CenterOfMass",
    "ConstantForce",
    "CoulombFriction",
    "Effect",
    "HardeningSpring",
    "Place",
    "PositionRipple",
    "Probe",
    "QuadraticDrag",
    "Scale",
    "SensorDelay",
    "SensorOffset",
    "SensorScale",
    "Spring",
    "StribeckFriction",
    "Symbol",
    "ViscousFriction",
]
