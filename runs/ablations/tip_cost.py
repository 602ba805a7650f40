"""The cart-pole with PILCO's cost: of the distance from the pole's tip to where it is up."""

from dataclasses import replace

import gymnasium

import envs  # noqa: F401  registers the cart-pole
from baselines.moments.costs import TipDistanceCost

_shown = gymnasium.make("mcpilco/CartPoleSwingUp-v0").unwrapped.task
_states = _shown.state_names.index
TASK = replace(
    _shown, cost=TipDistanceCost(cart=_states("cart_position"), angle=_states("pole_angle"))
)
