from .callbacks import Agent, Callback, JsonLines, Logged, TensorBoard, as_callback
from .history import (
    History,
    PastTrial,
    read_history,
    read_search,
    read_task,
    read_transitions,
    read_trial,
)
from .metrics import measures_in, values_of
from .progress import Progress, Results, counting
from .run_folder import READABLE, RunFolder, read_json, versions, write_json

__all__ = [
    "READABLE",
    "Agent",
    "Callback",
    "History",
    "JsonLines",
    "Logged",
    "PastTrial",
    "Progress",
    "Results",
    "RunFolder",
    "TensorBoard",
    "as_callback",
    "counting",
    "measures_in",
    "read_history",
    "read_json",
    "read_search",
    "read_task",
    "read_transitions",
    "read_trial",
    "values_of",
    "versions",
    "write_json",
]
