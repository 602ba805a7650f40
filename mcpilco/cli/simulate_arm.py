"""`mcpilco collisions simulate`: recordings of an arm whose joints stick."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli.system import make_folder
from mcpilco.typing import InputError

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class Simulate:
    """Record a simulated arm whose joints stick: without contact, and pushed."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for arm.xml, free.csv, check.csv and pushed.csv"""
    moves: int = 60
    """of the arm in free.csv and in check.csv; pushed.csv has 8"""
    seed: int = 0
    """of everything random; equal seeds give equal files"""

    def __call__(self) -> int:
        """Simulate, and return the exit code."""
        import numpy as np

        from envs.arms.sticky_arm import MODEL, StickyArm
        from envs.arms.waypoints import waypoints

        if self.moves < 1 or self.seed < 0:
            raise InputError(
                f"--moves must be at least 1 and --seed not negative, got {self.moves} and "
                f"{self.seed}."
            )
        names = ("arm.xml", "free.csv", "check.csv", "pushed.csv")
        make_folder(self.out, [self.out / name for name in names], "name another folder")
        rng = np.random.default_rng(self.seed)
        arm = StickyArm.drawn(rng)
        for name in ("free", "check"):
            self._write(name, arm.follow(waypoints(self.moves, rng), rng))
        targets = waypoints(8, rng, rest_s=(1.6, 1.6), always=0)
        pushes = _pushes(targets, float(arm.model.dof_frictionloss[0]), rng)
        self._write("pushed", arm.follow(targets, rng, pushes))
        shutil.copyfile(MODEL, self.out / "arm.xml")
        print(f"In {self.out}: arm.xml, free.csv, check.csv, pushed.csv.")
        return 0

    def _write(self, name: str, log: Any) -> None:
        """A CSV with seven decimals, of which sensors tell five."""
        import numpy as np

        from mcpilco.files import csv_bytes, write_bytes
        from mcpilco.recordings import FORCE, columns_of

        names = ["time", *columns_of(log.joints)]
        table = [log.time]
        for name_ in names[1:]:
            joint = next(j for j in log.joints if name_.startswith(f"{j}_"))
            column = getattr(log, name_.removeprefix(f"{joint}_"))
            table.append(column[:, log.joints.index(joint)])
        if log.pushes:
            names, table = [*names, *FORCE], [*table, *log.force.T]
        rows = np.round(np.column_stack(table), 7).tolist()
        write_bytes(self.out / f"{name}.csv", csv_bytes(names, rows))


def _pushes(targets: Any, friction: float, rng: np.random.Generator) -> tuple[Any, ...]:
    """A push in every other move and in every other rest, of three strengths."""
    from envs.arms.sticky_arm import Push

    found = []
    for number, move in enumerate(targets.moves):
        resting = number % 2 == 1
        start = move.end_s + 0.5 if resting else 0.5 * (move.start_s + move.end_s)
        strength = (1.0, 2.0, 3.0)[number // 2 % 3] * float(rng.choice([-1.0, 1.0]))
        found.append(Push(start, strength * friction))
    return tuple(found)
