"""Policies, the costs that judge them, and costs that are learned from rewards.

`SumOfGaussians` is the policy of MC-PILCO, with `dropout` of its basis functions while it is
searched; a cost is a number in [0, 1] for each state and input. Read `policies`, `costs`,
`reward_cost` where an env shows rewards only, `regulator` where a goal is held, and `brake` where
states have limits.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
