from .plots.rollouts import plot_costs, plot_input, plot_state, plot_states
from .plots.training import (
    plot_coverage,
    plot_errors,
    plot_learning,
    plot_policy,
    plot_search,
    plot_times,
)
from .recorder import Recorder, run_callbacks
from .recording import write_recording
from .report.gap_page import write_gap_report
from .scene import Pose, Scene, Shape
from .side_by_side import write_crossing_film, write_gap_film
from .viewer import open_viewer, screenshot

__all__ = [
    "Pose",
    "Recorder",
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
    "run_callbacks",
    "screenshot",
    "write_crossing_film",
    "write_gap_film",
    "write_gap_report",
    "write_recording",
]
