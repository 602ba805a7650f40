"""The file of an agent: networks, optimisers and replay buffer as plain arrays.

stable-baselines3's own zip holds pickled objects, which execute when they are read. Here the
algorithm is made anew from its numbers, and takes the arrays.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from mcpilco.agent_file import STRUCTURE
from mcpilco.archive import read_groups, write_groups
from mcpilco.config import from_dict
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, RunFolderError

if TYPE_CHECKING:
    from baselines.sb3.agent import SB3Agent

FORMAT = 1
"""version of the file"""
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_VARIABLES = ("log_ent_coef",)
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class SavedAgent:
    """What an agent's file holds; reading it checks nothing yet."""

    about: Mapping[str, Any]
    """numbers and names"""
    arrays: Mapping[str, Mapping[str, np.ndarray]]
    """bounds; networks and optimisers; memory, where there is one"""

    def config(self, kind: type[Any]) -> Any:
        """The agent's numbers, of the dataclass of its algorithm."""
        return from_dict(kind, self.about["config"])

    @property
    def task(self) -> TaskSpec:
        """What the agent knew of its env, but for the cost."""
        return TaskSpec.from_json(self.about["task"])

    def restore(self, agent: SB3Agent) -> None:
        """Give a new agent all that the saved one had learned.

        Raises:
            ValueError: an entry does not fit the agent, or is not finite.
        """
        saved, here = self.task.to_json(), agent.task.to_json()
        for name in STRUCTURE:
            if saved[name] != here[name]:
                raise ValueError(f"its {name} is {saved[name]}, the env has {here[name]}")
        counts = [*self.about["counters"].values(), self.about["trials"], self.about["borrowed"]]
        if not all(type(count) is int and count >= 0 for count in counts):
            raise ValueError(f"its counters are {counts}")
        load_learner(agent.learner, self.arrays)
        for name in _COUNTERS:
            setattr(agent.learner, name, self.about["counters"][name])
        agent.trials = self.about["trials"]
        agent.borrow(self.about["borrowed"])


def write_agent(path: Path, agent: SB3Agent) -> Path:
    """Write all that an agent has learned, and what it needs to go on; returns the file's path.

    Raises:
        RunFolderError: the file cannot be written.
    """
    about = {
        "format": FORMAT,
        "algo": agent.algo,
        "config": dataclasses.asdict(agent.config),
        "task": agent.task.to_json(),
        "horizon": agent.horizon,
        "observations": int(np.prod(agent.env.observation_space.shape or (0,))),
        "seed": agent.seed,
        "trials": agent.trials,
        "borrowed": agent.borrowed_timesteps,
        "counters": {name: int(getattr(agent.learner, name)) for name in _COUNTERS},
    }
    dtype = agent.env.action_space.dtype
    bounds = {"low": agent.low.astype(dtype), "high": agent.high.astype(dtype)}
    return write_groups(_npz(path), about, {"bounds": bounds, **learner_arrays(agent.learner)})


@contextlib.contextmanager
def reading(path: Path, algo: str) -> Iterator[SavedAgent]:
    """What a file holds, for the time in which an agent is made of it.

    Args:
        path: of the file.
        algo: the algorithm of the agent.

    Raises:
        RunFolderError: the file is missing or damaged, or the agent cannot be made of it.
    """
    path = _npz(path)
    about, arrays = read_groups(path)
    if (saved := about.get("algo", "mcpilco")) != algo:
        raise RunFolderError(
            f"{path} holds an agent of the algorithm {saved!r}, expected one of {algo!r}; "
            "load it with the class of its algorithm."
        )
    if about.get("format") != FORMAT:
        raise RunFolderError(
            f"{path} has format {about.get('format')!r}, this mcpilco reads {FORMAT}; "
            "save the agent with this version, or install the one that saved it."
        )
    try:
        yield SavedAgent(about, arrays)
    except EnvError:
        raise
    except Exception as error:  # what a damaged file says may lead to almost anything
        raise RunFolderError(
            f"{path} is damaged, or holds no agent of this env ({type(error).__name__}: {error})."
        ) from error


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


def _npz(path: Path) -> Path:
    return path if path.suffix == ".npz" else path.with_name(f"{path.name}.npz")
