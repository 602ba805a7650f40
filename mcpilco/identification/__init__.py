"""Identification: what a robot's recordings say of its parameters, forces, kinematics and maps.

Six rooms, each for itself; all say how a fit went with one `Report`:

- `rigid_body`: masses, inertias and friction of an open chain, from motions and joint forces.
- `noisy_inputs`: the linear regression behind it, where the inputs are noisy.
- `inverse_dynamics`: torques of a motion as Gaussian processes, least squares or a network.
- `collision`: currents of an arm without contact, and alarms where they differ.
- `kinematics`: the chain of joints from markers, and the pose of its tip.
- `volterra`: an output as a polynomial of past inputs.

The names of `rigid_body`, `noisy_inputs` and `volterra` can be imported from here, and the entry
points of the others; recordings are read by `mcpilco.recordings`. Read `rigid_body` first.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
