"""Plants: a machine as bodies on joints behind actuators and in front of sensors, and its effects.

A `Plant` has named states, inputs and parameters with units, and `simulate`. An effect is a class
with one formula (`effects/joint.py` first); `Plant.having` adds it, and `Correction` keeps effects
and parameters in a JSON file. The formula is Python of numbers of any kind (`arithmetic`), which is
compiled into simulations (`simulation/`) and made the mean of a model (`equations/`);
`mcpilco.mjcf` reads plants from MuJoCo's models, and writes corrections into them.

Read `plant`, `effects/base`, `effects/joint`, `simulation/motion`, `correction`, `equations/step`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
