"""What MC-PILCO must know of InvertedDoublePendulum-v5: the guess, its foot held nearer."""

import contextlib
from dataclasses import replace

import gymnasium as gym

from mcpilco.agent import guess_task
from mcpilco.policies import TipCost

with contextlib.closing(gym.make("InvertedDoublePendulum-v5")) as env:
    guess = guess_task(env)

assert guess is not None, "its class is known"
# the rail ends at 1 m: a foot that is felt from 0.6 m on drifts there more slowly
TASK = replace(
    guess.task, cost=TipCost((1, 2), (0.6, 0.6), lengthscale=0.3, foot=0, foot_lengthscale=0.6)
)
