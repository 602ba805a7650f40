"""Commands and what they share: first steps, types of options, and the options of a training.

Options that cannot be meant raise InputError.
"""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.config import CART_POLE, Limit
from mcpilco.typing import InputError, McPilcoError, RecordingError

if TYPE_CHECKING:
    import gymnasium as gym

    from mcpilco.agent import TrialAgent
    from mcpilco.task import TaskSpec


class Command(ABC):
    """A command and its options, which are its fields."""

    @abstractmethod
    def __call__(self) -> int:
        """Run it, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """


def use_one_thread() -> None:
    """Keep torch and BLAS to one thread: the matrices are small, and runs share a machine.

    It also makes results equal to the last digit, wherever the command runs.
    """
    import scipy.linalg  # noqa: F401  loads the BLAS whose threads are limited
    import torch
    from threadpoolctl import threadpool_limits

    torch.set_num_threads(1)
    threadpool_limits(1)


def register(*names: str, trusted: Iterable[str] = ()) -> None:
    """Register the envs and algorithms of this project, and those of the modules that a user names.

    Of `module:Name` the module is imported; `trusted` modules are named by a run.
    """
    import baselines  # noqa: F401  registers its algorithms
    import envs  # noqa: F401  registers its ids
    from mcpilco.agent import import_named
    from mcpilco.machine import MACHINE  # noqa: F401  registers it

    import_named(*names, *(f"{module}:" for module in trusted))


def require_at_least(least: int, **values: int | None) -> None:
    """Check options that are whole numbers, by name; None is an option that is not given."""
    for name, value in values.items():
        if value is not None and value < least:
            expected = "not be negative" if least == 0 else f"be at least {least}"
            raise InputError(f"--{name} must {expected}, got {value}.")


def is_model(plant: str) -> bool:
    """Whether this names the file of a model, and no registered plant."""
    from envs import MODELS

    return plant.endswith(MODELS)


def require_new(*paths: Path, remedy: str) -> None:
    """Raises RecordingError where a file is there already; `remedy` says what to do then."""
    for path in paths:
        if path.exists():
            raise RecordingError(f"{path} exists already; nothing is overwritten: {remedy}.")


def warn(*sentences: object, about: str = "mcpilco") -> None:
    """Print each sentence to standard error, behind what it is about."""
    for sentence in sentences:
        print(f"{about}: {sentence}", file=sys.stderr)


@contextlib.contextmanager
def without(what: str) -> Iterator[None]:
    """Where this cannot be drawn or written, says so and goes on: nothing else is lost then."""
    try:
        yield
    except McPilcoError as error:
        warn(f"without {what}: {error}")


# Types of options ---------------------------------------------------------------------------------


def optional(metavar: str, default: str) -> object:
    """Annotation of an argument that may be None; `default` says what is taken then."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")


RunPath = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
"""a run folder, without a flag"""
Trust = Annotated[tuple[str, ...], tyro.conf.arg(metavar="MODULE...")]
"""modules that a run names; without it none of them is imported"""
TaskPath = Annotated[
    Path | None,
    tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: what the env shows, or a guess)"),
]
"""file of a task: .py, .toml or .json"""
Algo = Annotated[str, tyro.conf.arg(metavar="NAME")]
"""a registered algorithm; of a package that is not installed as `package:name`"""
SuitablePreset = Annotated[
    str | None, optional("NAME", "default; thorough where the mean is physics")
]
"""a preset, or the one that suits the model"""
Columns = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=COLUMN...")]
"""the names of columns in a file, as `column_names` reads them"""
EnvKeywords = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE...")]
"""keywords of an env, as `keywords` reads them"""
Files = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE...")]
"""recordings, without a flag"""


# Entries NAME=VALUE -------------------------------------------------------------------------------


def pairs(option: str, entries: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Names and values."""
    for entry in entries:
        name, equals, value = entry.partition("=")
        if not (name and equals):
            raise InputError(f"{option} must be NAME=VALUE, got {entry!r}.")
        yield name, value


def separated(entries: Sequence[str]) -> list[str]:
    """The entries, of which some hold several, separated by commas."""
    return [part for entry in entries for part in entry.split(",") if part]


def column_names(entries: Sequence[str]) -> dict[str, str]:
    """The file's name of each column that is named otherwise there; empty of one to ignore."""
    named = pairs("--columns", separated(entries))
    return {name: "" if column == "none" else column for name, column in named}


def column_maps(entries: Sequence[str]) -> dict[str, dict[str, str]]:
    """`column_names` by file: of those that FILE: before the first names, or else of all, `*`."""
    maps: dict[str, dict[str, str]] = {}
    for entry in entries:
        first, equals, rest = entry.partition("=")
        file, _, name = first.rpartition(":")
        maps.setdefault(file or "*", {}).update(column_names([name + equals + rest]))
    return maps


def number(what: str, text: str) -> float:
    """The number in a text."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{what} must be a number, got {text!r}.") from None


def named_numbers(option: str, entries: Sequence[str]) -> dict[str, float]:
    """Numbers by name, of entries that are also separated by commas."""
    found = pairs(option, separated(entries))
    return {name: number(f"{option} {name}", value) for name, value in found}


def uncertainty(entries: Sequence[str]) -> float | dict[str, float]:
    """Prior standard deviations of parameters: by name, or one for all."""
    if named := [entry for entry in entries if "=" in entry]:
        return named_numbers("--uncertainty", named)
    return number("--uncertainty", entries[-1])


def limits(entries: Sequence[str]) -> tuple[Limit, ...]:
    """Bounds of states, STATE=LOW:HIGH, of which one may be left out."""
    found = []
    for state, text in pairs("--limit", separated(entries)):
        low, colon, high = text.partition(":")
        if not colon:
            raise InputError(f"--limit must be STATE=LOW:HIGH, such as x=-0.5:0.5, got {text!r}.")
        ends = (number(f"--limit {state}", end) if end else None for end in (low, high))
        found.append(Limit(state, *ends))
    return tuple(found)


def spans_of(path: Path) -> dict[str, tuple[tuple[float, float], ...]]:
    """Begin and end of each event by recording, of what `mcpilco collisions detect` has written."""
    told = _json("--events", path)
    try:
        return {
            name: tuple((float(event["start_s"]), float(event["end_s"])) for event in events)
            for name, events in told.items()
        }
    except (AttributeError, KeyError, TypeError, ValueError):
        raise InputError(
            f"--events must be a collisions.json of `mcpilco collisions detect`, a list of events "
            f"with start_s and end_s for each recording, got {path}."
        ) from None


def keywords(option: str, entries: Sequence[str]) -> dict[str, Any]:
    """Keywords of an env: numbers, true, false, words, or what a JSON file holds.

    A run folder that keeps them needs no other file.
    """
    return {name: _value(option, text) for name, text in pairs(option, entries)}


def _value(option: str, text: str) -> Any:
    path = Path(text)
    if path.suffix == ".json":
        return _json(option, path)
    try:
        return json.loads(text)
    except ValueError:
        return text


def _json(option: str, path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{option}: cannot read {path}: {error.strerror or error}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{option}: {path} is no JSON file: {error}.") from None


# Machines -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class OnMachine(Command):
    """Options of every command that can drive a machine in the place of an env."""

    machine: Annotated[str | None, optional("URL", "none")] = None
    """udp://HOST:PORT or serial:///dev/NAME of a machine, which takes the place of the env"""
    machine_kwargs: EnvKeywords = ()
    """how it is watched: rate, watchdog, limits, and others; of a JSON file the content"""
    machine_key: Annotated[Path | None, optional("FILE", "none")] = None
    """file of the key that signs the packets; the machine has the same"""

    def met(self, log: Path) -> contextlib.AbstractContextManager[None]:
        """Within it envs of a machine can be made; their episodes are logged in the folder."""
        if self.machine is None:
            return contextlib.nullcontext()
        from mcpilco.machine import meeting

        return meeting(self.machine, log, self.machine_key)

    @property
    def as_typed(self) -> str:
        """The options that another command needs to meet the same machine, if there is one."""
        given = {"--machine": self.machine, "--machine-key": self.machine_key}
        return "".join(f" {k} {shlex.quote(str(v))}" for k, v in given.items() if v is not None)

    def place(self, env: str, kwargs: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
        """Id and keywords of an env, or of the machine in its place."""
        if self.machine is None:
            return env, dict(kwargs)
        from mcpilco.machine import MACHINE, machine_of

        settings = keywords("--machine-kwargs", self.machine_kwargs)
        return (
            (env, {**kwargs, **settings}) if env == MACHINE else machine_of(env, kwargs, settings)
        )


# Trainings ----------------------------------------------------------------------------------------


def given_task(path: Path | None) -> TaskSpec | None:
    """The task in the file that the user names, if any; Python in it is executed."""
    from mcpilco.agent import load_task

    return None if path is None else load_task(path)


@dataclass(frozen=True, kw_only=True)
class Learning(Command):
    """Options of every command that learns: in which env, by which algorithm, of which model."""

    env: str = CART_POLE
    """Gymnasium id of the env; `module:Id` imports the module first"""
    env_kwargs: EnvKeywords = ()
    """keywords of the env; of a JSON file, such as effects=gap/corrected.json, the content"""
    algo: Algo = "mcpilco"
    """mcpilco: particles; pilco: one Gaussian, matched in its moments; sac, tqc, ppo: of
    stable-baselines3; of another package `package:name`, or the name of its entry point"""
    preset: SuitablePreset = None
    """setting of the agent, and of the cart-pole; mcpilco has default, thorough, limited, thesis
    and tro2022, pilco default and tip, the others default"""
    horizon: Annotated[int | None, optional("INT", "the env's time limit")] = None
    """steps of a rollout"""
    task: TaskPath = None
    """file with states, angles and cost of the env, where the env does not show them"""
    exploration: Annotated[int | None, optional("INT", "one rollout")] = None
    """steps that excite the system at first; several rollouts, where they end early"""
    model: Annotated[str | None, optional("NAME", "that of the preset, rbf+mpk")] = None
    """of mcpilco: rbf, mpk, sed-mpk, sed-fir, features, friction, joined by +; physics+ before them
    makes the plant's equations the mean, physics+gip+ adds the forces that they lack"""
    prior: Annotated[Path | None, optional("FILE", "the nominal plant of the env")] = None
    """of mcpilco: the plant that physics and features know, and what is known of its parameters:
    gap/corrected.json, identified/identified.json, or an MJCF such as arm/kinematics.xml"""
    spread: Annotated[str | None, optional("FILE.json|NAME=STD,...", "that plant alone")] = None
    """of mcpilco: plants that a policy must hold for, each particle its own: what `mcpilco gap` has
    written, or relative standard deviations, such as mass=0.1,f_c=0.3"""
    memory: Annotated[int | None, optional("INT", "that of the preset, 0")] = None
    """of mcpilco: past inputs that model and policy see, for actuators that lag"""
    limit: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STATE=LOW:HIGH...")] = ()
    """of mcpilco: bounds of states, such as cart_position=-0.5:0.5, in their units; a brake that is
    learned keeps those of positions"""
    delay: Annotated[float | None, optional("SECONDS", "that of the preset, 0")] = None
    """of mcpilco: delay of the actuator [s]; the policy acts on the state predicted for then"""
    regulator: bool = False
    """of mcpilco: near the task's goal a linear regulator of the learned model takes over"""

    @property
    def chosen_preset(self) -> str:
        """The one that is given, or the one that suits the model and the limits."""
        from mcpilco.agent import suitable_preset

        limited = self.algo == "mcpilco" and bool(self.limit)
        return suitable_preset(self.preset, self.algo, self.model, limited)

    def numbers(self) -> tuple[Any, dict[str, Any]]:
        """The agent's configuration and the env's keywords."""
        from mcpilco.agent import find, preset_numbers, with_limits, with_model, with_regulator

        config, env_kwargs = preset_numbers(
            find(self.algo), self.chosen_preset, self.env, self.horizon, self.exploration
        )
        wide: dict[str, float] | Path | None = None
        if self.spread is not None:
            recipe = "=" in self.spread
            wide = named_numbers("--spread", [self.spread]) if recipe else Path(self.spread)
        config = with_model(config, self.model, self.prior, self.memory, self.delay, wide)
        config = with_limits(config, limits(self.limit))
        config = with_regulator(config) if self.regulator else config
        return config, env_kwargs | keywords("--env-kwargs", self.env_kwargs)

    def agent(self, env: gym.Env, config: Any, seed: int = 0) -> TrialAgent:
        """A new agent with these numbers, in an env whose task is given or shown."""
        from mcpilco.agent import find

        kind = find(self.algo)
        return kind(kind.policy_name, env, config=config, seed=seed, task=given_task(self.task))
