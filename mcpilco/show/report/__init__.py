"""A run as one HTML page that needs nothing beside it: curves, calibration, policy, timings.

It reads the run folder alone: no environment is made, no policy is run on one.
"""

from mcpilco.show.report.page import write_report

__all__ = ["write_report"]
