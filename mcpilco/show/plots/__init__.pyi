from .rollouts import plot_costs, plot_input, plot_state, plot_states
from .training import (
    plot_coverage,
    plot_errors,
    plot_learning,
    plot_policy,
    plot_search,
    plot_times,
)

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
