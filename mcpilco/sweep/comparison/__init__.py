"""Runs beside one another: what each reached after how much experience, over seeds.

found = line_up([Path("runs/out/a"), Path("runs/out/b")])
"""

from mcpilco.sweep.comparison.line_up import LineUp, line_up
from mcpilco.sweep.comparison.runs import Run, read_run

__all__ = ["LineUp", "Run", "line_up", "read_run"]
