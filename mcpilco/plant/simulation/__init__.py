"""Motion of many systems under recorded commands, compiled: command, actuator, bodies, sensor.

`layout` names what moves and holds its numbers, `laws` compiles the formulas of the effects,
`signals` has commands on their way and sensors, `integrator` the steps of a motion. `motion`
follows many whose commands are all known side by side, `stepper` those that go on from command to
command.
"""

__all__: list[str] = []
