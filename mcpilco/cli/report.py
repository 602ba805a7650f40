"""`mcpilco report`: a run as one HTML page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from mcpilco.cli.options import RunPath, optional
from mcpilco.cli.system import Command, register, use_one_thread


@dataclass(frozen=True)
class Report(Command):
    """Write a run as one HTML page that needs no other file."""

    run: RunPath
    """run folder"""
    out: Annotated[Path | None, optional("FILE", "report.html in the run folder")] = None
    """the page"""

    def __call__(self) -> int:
        """Write the page, print its path, and return the exit code."""
        use_one_thread()
        register()
        from mcpilco.logbook import RunFolder
        from mcpilco.show.report import write_report

        print(write_report(RunFolder.open(self.run), self.out))
        return 0
