"""Motion of many systems under recorded commands, compiled: command, actuator, bodies, sensor.

`layout` names what moves and holds its numbers, `laws` compiles the formulas of the effects,
`motion` follows motions whose commands are all known, `stepper` those that go on from command to
command.
"""

__all__: list[str] = []
