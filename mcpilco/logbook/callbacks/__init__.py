"""Callbacks that follow the learning: nothing, a table on screen, numbers in a file.

An agent calls the methods of `Callback` while it learns, in this order (+ one or more times); a
callback reads and must not change the agent:

    on_training_start
    on_exploration +
    ( on_trial_start  on_model_fitted  on_policy_step +  on_trial_end ) +
    on_training_end

Numbers have keys like stable-baselines3's: `model/noise_std_0`, `policy/cost`, `time/trial`.
"""

from mcpilco.logbook.callbacks.base import Agent, Callback, CallbackList, as_callback
from mcpilco.logbook.callbacks.progress import Progress
from mcpilco.logbook.callbacks.writers import JsonLines, TensorBoard, trial_values

__all__ = [
    "Agent",
    "Callback",
    "CallbackList",
    "JsonLines",
    "Progress",
    "TensorBoard",
    "as_callback",
    "trial_values",
]
