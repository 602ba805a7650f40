"""How arguments that several commands share look in `--help`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

RunPath = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
"""a run folder, without a flag"""


TaskPath = Annotated[
    Path | None,
    tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: what the env shows, or a guess)"),
]
"""file of a task: .py, .toml or .json"""


Algo = Annotated[str, tyro.conf.arg(metavar="NAME")]
"""a registered algorithm; of a package that is not installed as `package:name`"""


def optional(metavar: str, default: str) -> object:
    """Annotation of an argument that may be None; `default` says what is taken then."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")
