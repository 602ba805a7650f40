"""The catalogue of named physical effects.

    command -> [actuator] -> input -> [joint, inertial, contact] -> state -> [sensor] -> measurement

An effect is one class with one formula; its name is public vocabulary.
"""

from mcpilco.plant.effects import actuator, contact, inertial, joint, memory, sensor
from mcpilco.plant.effects.base import Effect, Place, Probe, Scale, Symbol, sizes

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        joint.ViscousFriction(),
        joint.CoulombFriction(),
        joint.StribeckFriction(),
        joint.QuadraticDrag(),
        joint.AsymmetricFriction(),
        joint.AsymmetricViscousFriction(),
        joint.LoadDependentFriction(),
        joint.Spring(),
        joint.HardeningSpring(),
        joint.ConstantForce(),
        joint.PositionRipple(),
        memory.DahlFriction(),
        memory.BackEMF(),
        memory.ElasticJoint(),
        memory.JointBacklash(),
        inertial.BodyMass(),
        inertial.CenterOfMass(),
        inertial.BodyInertia(),
        inertial.Armature(),
        inertial.BodyLength(),
        actuator.ActuatorGain(),
        actuator.ActuatorDeadZone(),
        actuator.AsymmetricDeadZone(),
        actuator.ActuatorSaturation(),
        actuator.ActuatorDelay(),
        actuator.ActuatorLag(),
        actuator.ActuatorRateLimit(),
        actuator.Backlash(),
        sensor.SensorOffset(),
        sensor.SensorScale(),
        sensor.SensorDelay(),
        sensor.SensorLag(),
        sensor.EccentricEncoder(),
        inertial.GravityTilt(),
        contact.ContactFriction(),
        contact.ContactStiffness(),
        contact.ContactDamping(),
        contact.GroundHeight(),
    )
}
"""all effects, by name"""

__all__ = ["CATALOGUE", "Effect", "Place", "Probe", "Scale", "Symbol", "sizes"]
