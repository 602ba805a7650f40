"""The file of an agent: networks, optimisers and replay buffer as plain arrays.

stable-baselines3's own zip holds pickled objects, which execute when they are read. Here the
algorithm is made anew from its numbers, and takes the arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from mcpilco.agent import Groups, SavedAgent

if TYPE_CHECKING:
    from baselines.sb3.agent import SB3Agent

_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_VARIABLES = ("log_ent_coef",)
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")

Arrays = dict[str, np.ndarray]


class SavedSB3(SavedAgent["SB3Agent"]):
    """What the file holds: networks and optimisers; memory, where there is one."""

    formats = (1,)

    @classmethod
    def learned(cls, agent: SB3Agent) -> tuple[dict[str, Any], Groups]:
        counters = {name: int(getattr(agent.learner, name)) for name in _COUNTERS}
        about = {"borrowed": agent.borrowed_timesteps, "counters": counters}
        return about, learner_arrays(agent.learner)

    def restore(self, agent: SB3Agent) -> None:
        self.require_structure(agent)
        counts = [*self.about["counters"].values(), self.about["trials"], self.about["borrowed"]]
        if not all(type(count) is int and count >= 0 for count in counts):
            raise ValueError(f"its counters are {counts}")
        load_learner(agent.learner, self.arrays)
        for name in _COUNTERS:
            setattr(agent.learner, name, self.about["counters"][name])
        agent.trials = self.about["trials"]
        agent.borrow(self.about["borrowed"])


def learner_arrays(learner: Any) -> dict[str, Arrays]:
    """Networks, optimisers and memory of an algorithm of stable-baselines3, by name."""
    groups = {name: _flat(state) for name, state in learner.get_parameters().items()}
    groups["variables"] = {
        name: getattr(learner, name).detach().numpy()
        for name in _VARIABLES
        if getattr(learner, name, None) is not None
    }
    buffer = getattr(learner, "replay_buffer", None)
    if buffer is not None:
        rows = {name: getattr(buffer, name)[: buffer.size()] for name in _BUFFER}
        groups["memory"] = {**rows, "position": np.array(buffer.pos)}
    return groups


def load_learner(learner: Any, arrays: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """Give a new algorithm the arrays of `learner_arrays`.

    Raises:
        ValueError: they are not those of an algorithm like this, or not finite.
    """
    for group in arrays.values():
        if not all(a.dtype.kind in "iu" or np.isfinite(a).all() for a in group.values()):
            raise ValueError("its networks or memory are not made of finite numbers")
    fresh = learner.get_parameters()
    learner.set_parameters(
        {name: _nested(arrays.get(name, {}), fresh[name]) for name in fresh}, exact_match=True
    )
    for name, value in arrays.get("variables", {}).items():
        if name not in _VARIABLES:
            raise ValueError(f"it has a variable {name!r}")
        with torch.no_grad():
            getattr(learner, name).copy_(torch.from_numpy(value))
    if "memory" in arrays:
        _load_memory(learner.replay_buffer, dict(arrays["memory"]))


def _load_memory(buffer: Any, arrays: Arrays) -> None:
    position, count = int(arrays.pop("position")), len(arrays["rewards"])
    if not 0 <= position <= count <= buffer.buffer_size:
        raise ValueError(f"its memory has {count} rows, and the next goes to {position}")
    for name in _BUFFER:
        getattr(buffer, name)[:count] = arrays[name]
    buffer.pos, buffer.full = position, count == buffer.buffer_size


def _flat(state: Mapping[str, Any]) -> Arrays:
    """The tensors of a module or an optimiser by name; an optimiser's settings are the config's."""
    if "param_groups" not in state:
        return {name: value.numpy() for name, value in state.items()}
    return {
        f"{index}.{name}": value.numpy()
        for index, entries in state["state"].items()
        for name, value in entries.items()
    }


def _nested(arrays: Mapping[str, np.ndarray], fresh: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `_flat`, for an object whose present state is `fresh`."""
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items()}
    if "param_groups" not in fresh:
        return tensors
    state: dict[int, dict[str, torch.Tensor]] = {}
    for path, tensor in tensors.items():
        index, _, name = path.partition(".")
        state.setdefault(int(index), {})[name] = tensor
    return {"state": state, "param_groups": fresh["param_groups"]}
