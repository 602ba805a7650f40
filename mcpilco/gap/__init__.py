"""The search for what a simulation lacks, from recordings and a plant to a corrected plant.

`investigate` is the whole workflow and returns a `Gap`: verdict, named effects, corrected plant,
errors on held-out recordings. To see how it decides read `investigation` (the list of what
happens), `search` (which sets of effects are tried), `decide` (choice, names, verdict) and
`thresholds` (all numbers that decide, on one page). What these call: `data` cuts recordings into
windows and makes a `GapProblem`; `plant_model`, `sensitivities` and `fit` simulate and fit;
`disturbance` has the random forces and the evidence; `screen` scores effects; `residual_force` and
`learned_force` find forces without a name; `disagreement` finds events and places; `comparison` and
`report` say what a correction is worth.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
