"""Plots for reports, one on each Axes: the system black, the model blue, its particles grey.

matplotlib comes with the extra `report` and is imported when the first plot is drawn.
"""

from mcpilco.show.plots.models import plot_coverage, plot_errors, plot_policy
from mcpilco.show.plots.rollouts import plot_costs, plot_input, plot_state, plot_states
from mcpilco.show.plots.training import plot_learning, plot_search, plot_times

__all__ = [
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
]
