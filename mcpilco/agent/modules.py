"""Modules behind the names of envs and algorithms, `module:Name`: whoever types one imports it.

A name may also come from a file that somebody sent. So nothing that opens an env or finds an
algorithm imports its module: it must have been imported before, in Python by an `import`, on the
command line because the user typed the name, or the module after `--trust`.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from mcpilco.typing import InputError


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
