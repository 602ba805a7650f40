from .identification import draw_kinematics, plot_lags, plot_prediction, plot_response, plot_torque
from .rollouts import plot_costs, plot_input, plot_state, plot_states
from .style import MODEL, PARTICLES, SYSTEM, add_legend, new_axes, write_picture
from .training import (
    Curve,
    plain_log_axis,
    plot_coverage,
    plot_curves,
    plot_errors,
    plot_learning,
    plot_policy,
    plot_search,
    plot_times,
)

__all__ = [
    "MODEL",
    "PARTICLES",
    "SYSTEM",
    "Curve",
    "add_legend",
    "draw_kinematics",
    "new_axes",
    "plain_log_axis",
    "plot_costs",
    "plot_coverage",
    "plot_curves",
    "plot_errors",
    "plot_input",
    "plot_lags",
    "plot_learning",
    "plot_policy",
    "plot_prediction",
    "plot_response",
    "plot_search",
    "plot_state",
    "plot_states",
    "plot_times",
    "plot_torque",
    "write_picture",
]
