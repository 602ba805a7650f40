"""Closed forms and independent integrators, against which the package is tested."""

from tests.reference.cartpole import CartPoleDynamics
from tests.reference.double_pendulum import AcrobotDynamics, PendubotDynamics
from tests.reference.pendulum import PendulumDynamics

REFERENCES = {
    "mcpilco/CartPoleSwingUp-v0": CartPoleDynamics.nominal(),
    "mcpilco/MujocoCartPoleSwingUp-v0": CartPoleDynamics.nominal(),
    "mcpilco/Pendulum-v0": PendulumDynamics.nominal(),
    "mcpilco/Pendubot-v0": PendubotDynamics.nominal(),
    "mcpilco/Acrobot-v0": AcrobotDynamics.nominal(),
}
"""equations of motion, by the id of the env"""
