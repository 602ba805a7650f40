"""Keywords that an agent does not have: stable-baselines3's, and what takes their place here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

REMEDIES = {
    "batch_size": "a model is fitted to all data; SearchConfig(particles=...) sizes a rollout",
    "buffer_size": "all transitions are kept; leave it out",
    "custom_objects": "a file holds plain arrays and numbers alone; leave it out",
    "device": "agents compute on the processor; leave it out",
    "force_reset": "each trial begins new episodes; leave it out",
    "gamma": "costs are summed over the horizon without discount; set config={}(horizon=...)",
    "learning_starts": "set the steps before the first trial in config={}(exploration=...)",
    "log_interval": "callbacks are told of each step of a search; leave it out",
    "n_steps": "set the steps of an episode in config={}(horizon=...)",
    "policy_kwargs": "set the policy's numbers in config={}(...)",
    "print_system_info": "run the command `mcpilco doctor`",
    "reset_num_timesteps": "`learn` goes on where it ended; make a new agent to begin anew",
    "stats_window_size": "each trial is told by itself; leave it out",
    "tb_log_name": "name the folder: learn(callback=mcpilco.logbook.TensorBoard(folder))",
    "tensorboard_log": "give learn a callback: callback=mcpilco.logbook.TensorBoard(folder)",
    "total_timesteps": "give it to learn(total_timesteps)",
}


def refuse_keywords(what: str, given: Iterable[str], known: Iterable[str], config: type) -> None:
    """Say of keywords that are not known what to use in their place.

    `config` is the dataclass of the agent's numbers, which may have an entry of such a name.

    Raises:
        TypeError: there are any.
    """
    for name in given:
        usual = f"it has {', '.join(known)}"
        remedy = REMEDIES.get(name, usual).format(config.__name__)
        entry = next(_entries(config, name, "config={}"), None)
        raise TypeError(f"{what} has no keyword {name}; {entry or remedy}.")


def _entries(config: Any, name: str, place: str) -> Iterator[str]:
    """Where an entry of that name stands in a configuration or its parts."""
    hints = get_type_hints(config)
    for field in fields(config):
        here = place.format(f"{config.__name__}({field.name}={{}})")
        if field.name == name:
            yield f"set {here.format('...')}"
        hint = hints[field.name]
        for part in filter(is_dataclass, (hint, *get_args(hint))):
            inner = here if part is hint else here.format("({},)")
            yield from _entries(part, name, inner)
