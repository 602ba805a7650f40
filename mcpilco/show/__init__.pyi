from .collision_film import write_collision_film
from .comparison import estimate_cell, solved_table, write_comparison
from .film import Follower, Reel, write_run_film
from .model_scene import scene_of
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
from .report.gap_maps import MissingForce, TimeMap, missing_force, time_map
from .report.gap_page import write_gap_report
from .scene import Pose, Scene, Shape, chain_scene
from .side_by_side import write_crossing_film, write_gap_film
from .video import write_video
from .viewer import ended_by_signals, has_display, live_viewer, open_viewer, screenshot

__all__ = [
    "Follower",
    "MissingForce",
    "Pose",
    "Recorder",
    "Reel",
    "Scene",
    "Shape",
    "TimeMap",
    "chain_scene",
    "ended_by_signals",
    "estimate_cell",
    "has_display",
    "live_viewer",
    "missing_force",
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
    "scene_of",
    "screenshot",
    "solved_table",
    "time_map",
    "write_collision_film",
    "write_comparison",
    "write_crossing_film",
    "write_gap_film",
    "write_gap_report",
    "write_recording",
    "write_run_film",
    "write_video",
]
