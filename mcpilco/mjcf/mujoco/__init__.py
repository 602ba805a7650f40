"""MuJoCo itself as a plant: any model that it compiles, stepped by `mj_step`.

`plant` has the face of every plant, `coordinates` its states, `numbers` the effects that a compiled
model takes, and `filters` what acts a step: commands on their way, and forces in joints.
"""

__all__: list[str] = []
