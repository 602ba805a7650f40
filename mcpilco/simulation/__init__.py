"""Motions of many systems under recorded commands: command, actuator, bodies, sensor."""

from mcpilco.simulation.layout import Layout
from mcpilco.simulation.motion import simulate
from mcpilco.simulation.stepper import Stepper
from mcpilco.simulation.tables import Tables

__all__ = ["Layout", "Stepper", "Tables", "simulate"]
