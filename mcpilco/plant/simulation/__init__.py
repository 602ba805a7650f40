"""Motions of many systems under recorded commands: command, actuator, bodies, sensor."""

from mcpilco.plant.simulation.layout import Layout
from mcpilco.plant.simulation.motion import simulate
from mcpilco.plant.simulation.stepper import Stepper
from mcpilco.plant.simulation.tables import Tables

__all__ = ["Layout", "Stepper", "Tables", "simulate"]
