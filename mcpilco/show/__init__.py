"""Rollouts to look at: Rerun recordings, the viewer, and plots for reports.

Names are imported when first used: Rerun and matplotlib are slow to load, matplotlib is an extra.
"""

from __future__ import annotations

from importlib import import_module

from mcpilco.show.scene import Pose, Scene, Shape

_HOME = {
    "write_recording": "recording",
    "open_viewer": "viewer",
    "screenshot": "viewer",
    "plot_states": "plots",
    "plot_state": "plots",
    "plot_input": "plots",
    "plot_costs": "plots",
    "plot_learning": "plots",
    "plot_search": "plots",
    "plot_times": "plots",
    "plot_coverage": "plots",
    "plot_errors": "plots",
    "plot_policy": "plots",
}

__all__ = [
    "Pose",
    "Scene",
    "Shape",
    "open_viewer",
    "plot_costs",
    "plot_coverage",
    "plot_errors",
    "plot_input",
    "plot_learning",
    "plot_policy",
    "plot_search",
    "plot_state",
    "plot_states",
    "plot_times",
    "screenshot",
    "write_recording",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
