"""The policy search: particle rollouts, and descent along the gradient of their cost.

`Problem` is the expected cost of particles in a model, and `rollout` their equations in plain torch
(thesis, section 5.4.1). `PolicySearch` takes gradient steps on it from one or several starts, under
a `Schedule` of phases; `follow` searches in easier models first. `fused` computes the same rollout
in compiled loops with a backward sweep of its own, several times faster; `rollout_of` chooses.

Read `particles`, `search`, `schedule`, `engine`; then `fused` (layout, forward, backward).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
