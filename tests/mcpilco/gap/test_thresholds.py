"""The page of thresholds."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path

import pytest

from mcpilco.gap import thresholds

GROUPS = [group for group in vars(thresholds).values() if dataclasses.is_dataclass(type(group))]


@pytest.mark.parametrize("group", GROUPS, ids=lambda group: type(group).__name__)
def test_no_threshold_changes_while_it_is_used(group: object) -> None:
    (first, *_) = dataclasses.fields(group)  # type: ignore[arg-type]
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(group, first.name, 0)


def test_every_threshold_says_what_it_means() -> None:
    tree = ast.parse(Path(str(thresholds.__file__)).read_text())
    silent = [
        f"{body.name}.{ast.unparse(line.target)}"
        for body in tree.body
        if isinstance(body, ast.ClassDef)
        for line, below in zip(body.body, [*body.body[1:], None], strict=True)
        if isinstance(line, ast.AnnAssign)
        and not (isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant))
    ]
    assert not silent
