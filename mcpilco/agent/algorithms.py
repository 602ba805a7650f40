"""The registry of algorithms: their names, as `--algo` takes them, classes and presets.

An algorithm is a name and a class, `module:Class`, that is loaded when it is used. Another package
registers its own when it is imported, as `baselines` does and as Gymnasium's envs are registered,

    from mcpilco.agent import algorithms
    algorithms.register("pilco", "baselines.pilco:PILCO")

and is chosen as `package:name`; or it is installed with an entry point, and chosen as `name`:

    [project.entry-points."mcpilco.algorithms"]
    pilco = "baselines.pilco:PILCO"

Commands, sweeps and reports know of an agent and its class what
`mcpilco.agent.trial_agent.TrialAgent` says.

A name `module:Name` may also come from a file that somebody sent. So nothing that opens an env or
finds an algorithm imports its module: it must have been imported before, in Python by an `import`,
on the command line because the user typed the name, or the module after `--trust`.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcpilco.config import KERNELS, REGULATOR_ROOM, Limit
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.agent.trial_agent import TrialAgent


ENTRY_POINTS = "mcpilco.algorithms"
"""group of the entry points by which installed packages register algorithms"""
_HOMES = {"mcpilco": "mcpilco.agent.agent:MCPILCO"}


def register(name: str, home: str) -> None:
    """Make an algorithm known.

    `home` is the `module:Class` of a class like `mcpilco.agent.trial_agent.TrialAgent`.

    Raises:
        InputError: the name is taken by another class.
    """
    if _HOMES.setdefault(name, home) != home:
        raise InputError(
            f"The algorithm {name!r} is registered as {_HOMES[name]} already, got {home}; "
            "choose another name."
        )


def names() -> list[str]:
    """The algorithms that are registered."""
    return sorted(_homes())


def _homes() -> dict[str, str]:
    """Where each algorithm is: those that were registered, and entry points of other names."""
    installed = {point.name: point.value for point in entry_points(group=ENTRY_POINTS)}
    return installed | _HOMES


def find(name: str) -> type[TrialAgent]:
    """The class of an algorithm.

    Of `package:name` the package must have been imported.

    Raises:
        InputError: none of this name is registered.
    """
    name, homes = name.rpartition(":")[2], _homes()
    if name not in homes:
        raise InputError(
            f"The algorithm must be one of {sorted(homes)}, got {name!r}; type it as package:name, "
            "or where a file names it, trust the package that registers it: `--trust package`, in "
            "Python `import package` before."
        )
    module, _, kind = homes[name].partition(":")
    return getattr(import_module(module), kind)


def with_package(name: str) -> str:
    """The name of an algorithm as any process can find it: `package:name` where it needs one."""
    package = find(name).__module__.partition(".")[0]
    return name if ":" in name or package == "mcpilco" else f"{package}:{name}"


def import_named(*names: str) -> None:
    """Import the modules of names that the user typed, also from the folder where the user is.

    An import executes the module: never call this with what a file holds.

    Names are `module:Name`; those without a module are left out.

    Raises:
        InputError: there is no such module, or it fails.
    """
    for name in names:
        module = name.rpartition(":")[0]
        if not module:
            continue
        if (here := os.getcwd()) not in sys.path:  # as with `python -m`
            sys.path.append(here)
        try:
            import_module(module)
        except Exception as error:  # whatever a foreign module may raise
            raise InputError(f"Cannot import the module {module}: {error}.") from error


def names_in(value: Any) -> Iterator[str]:
    """The texts `module:Name` in a value of JSON: a constructor may import what it is given."""
    if isinstance(value, Mapping):
        value = [*value.keys(), *value.values()]
    if isinstance(value, list | tuple):
        for part in value:
            yield from names_in(part)
    elif isinstance(value, str) and re.fullmatch(r"[A-Za-z_][\w.]*:[A-Za-z_][\w./-]*", value):
        yield value


def require_imported(name: str) -> None:
    """Make sure that a name needs no import."""
    module = name.rpartition(":")[0]
    if module and module not in sys.modules:
        raise InputError(
            f"{name!r} is of the module {module}, and no module is imported because a file names "
            f"it; if you trust it, say so: `--trust {module}`, in Python `import {module}` before."
        )


PHYSICS = "physics"
"""the part of a model's name that makes the equations of the plant its mean"""


def suitable_preset(given: str | None, algo: str, model: str | None, limited: bool = False) -> str:
    """The preset of a training: the one that is given, or the one that suits its model and limits.

    Equations hold from the first trial on, so that it pays to search for longer in them. Within
    limits of states a policy is harder to find.
    """
    physics = algo == "mcpilco" and PHYSICS in (model or "").split("+")
    return given or ("thorough" if physics else "limited" if limited else "default")


def preset_numbers(
    kind: type[TrialAgent],
    preset_name: str,
    env_id: str,
    horizon: int | None = None,
    exploration: int | None = None,
) -> tuple[Any, dict[str, Any]]:
    """The agent's configuration and the env's keywords, of a preset.

    Without `horizon` [steps] it is the env's time limit, without `exploration` [steps] one rollout.

    Raises:
        InputError: the algorithm has no such preset, or does not explore beforehand.
    """
    if preset_name not in kind.presets:
        raise InputError(
            f"--preset of the algorithm {kind.algo} must be one of {sorted(kind.presets)}, "
            f"got {preset_name!r}."
        )
    preset = kind.presets[preset_name]
    env_kwargs = preset.keywords(env_id)
    config = preset.config_for(env_id)
    if exploration is not None:
        if not hasattr(config, "exploration"):
            raise InputError(
                f"--exploration is no option of the algorithm {kind.algo}; its presets say how it "
                "begins."
            )
        config = dataclasses.replace(config, exploration=exploration)
    if horizon is None:
        return config, env_kwargs
    config = dataclasses.replace(config, horizon=horizon)
    return config, {**env_kwargs, "max_episode_steps": horizon}


def with_limits(config: Any, limits: tuple[Limit, ...]) -> Any:
    """The agent's numbers with limits of states.

    Raises:
        InputError: the algorithm keeps none.
    """
    if not limits:
        return config
    if not hasattr(getattr(config, "search", None), "limits"):
        raise InputError("--limit is an option of the algorithm mcpilco.")
    search = dataclasses.replace(config.search, limits=(*config.search.limits, *limits))
    return dataclasses.replace(config, search=search)


def with_regulator(config: Any, room: float = REGULATOR_ROOM) -> Any:
    """The agent's numbers with a regulator near the goal, see `PolicyConfig.regulator`.

    Raises:
        InputError: the algorithm has no regulator.
    """
    if not hasattr(getattr(config, "policy", None), "regulator"):
        raise InputError("--regulator is an option of the algorithm mcpilco.")
    return dataclasses.replace(config, policy=dataclasses.replace(config.policy, regulator=room))


def with_model(
    config: Any,
    name: str | None = None,
    prior: Path | None = None,
    memory: int | None = None,
    delay: float | None = None,
    spread: Mapping[str, float] | Path | None = None,
) -> Any:
    """The agent's numbers with another model.

    `name` is a sum of parts out of `mcpilco.config.KERNELS`; with `physics` the equations of the
    plant are the mean, which the file `prior` describes, as `mcpilco gap` and `mcpilco identify`
    write it, or an MJCF; a spread in it is the prior of the parameters, where no `spread` is given.
    `memory` is how many past inputs a state holds, `delay` how late the actuator answers [s].
    `spread` has relative standard deviations by name, or is a file with one, whose plant is the
    prior where none is given.

    Raises:
        InputError: the algorithm has no such model, a part is unknown, or the file is no plant.
    """
    if (name, prior, memory, delay, spread) == (None,) * 5:
        return config
    if not hasattr(config, "model"):
        raise InputError(
            "--model, --prior, --memory, --delay and --spread are options of the algorithm mcpilco."
        )
    numbers = {"memory": memory, "delay": delay}
    changes: dict[str, Any] = {key: value for key, value in numbers.items() if value is not None}
    if name is not None:
        parts = name.split("+")
        kernel = [part for part in parts if part != PHYSICS]
        if not kernel or not set(kernel) <= set(KERNELS):
            raise InputError(
                f"--model must be a sum of parts out of {', '.join(KERNELS)}, with {PHYSICS}+ "
                f"before it where the mean is the plant's, such as physics+rbf, got {name!r}."
            )
        mean = PHYSICS if PHYSICS in parts else "zero"
        changes |= {"kernel": "+".join(kernel), "mean": mean}
    if isinstance(spread, Path):
        changes["spread"] = _described(spread).get("spread")
        if not changes["spread"]:
            raise InputError(
                f"{spread} tells no spread; a corrected.json of `mcpilco gap` does, or give a "
                "recipe such as mass=0.1,f_c=0.3."
            )
        prior = prior or spread
    elif spread is not None:
        changes["spread"] = dict(spread)
    if prior is not None:
        changes["plant"] = _described(prior)
        if spread is None and changes["plant"].get("spread"):
            changes["uncertainty"] = "told"
    return dataclasses.replace(config, model=dataclasses.replace(config.model, **changes))


def _described(path: Path) -> dict[str, Any]:
    """The content of a correction's file, or of an MJCF as one."""
    if path.suffix == ".xml":
        from mcpilco.mjcf import text_of

        plant = {"plant": path.stem, "parameters": {}, "effects": []}
        return {"format": 1, **plant, "mjcf": text_of(path)}
    from mcpilco.plant import read_correction

    read_correction(path)  # it says what is wrong with the file
    content = json.loads(path.read_text(encoding="utf-8"))
    content.pop("about", None)
    return content
