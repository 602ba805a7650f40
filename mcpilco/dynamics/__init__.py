"""Models of the next state: Gaussian processes of its changes, physics as mean, memory, delay.

`GPDynamics` adds the changes that the GPs predict to a state; an `Increment` says which entries
they predict. `PhysicsDynamics` has a plant's equations as mean, `PathwisePosterior` draws whole
functions, a `Delay` says which commands act in a step. Read `dynamics`, `features`, `physics`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
