"""The registry of algorithms: their names, as `--algo` takes them, and their classes.

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

import os
import sys
from importlib import import_module
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

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


def require_imported(name: str) -> None:
    """Make sure that a name needs no import."""
    module = name.rpartition(":")[0]
    if module and module not in sys.modules:
        raise InputError(
            f"{name!r} is of the module {module}, and no module is imported because a file names "
            f"it; if you trust it, say so: `--trust {module}`, in Python `import {module}` before."
        )
