from . import algorithms
from .agent import MCPILCO
from .agent_file import Groups, SavedAgent, difference, load_policy
from .algorithms import (
    find,
    import_named,
    preset_numbers,
    suitable_preset,
    with_limits,
    with_model,
    with_package,
    with_regulator,
)
from .contract import AbsentEnv, horizon_of, input_bounds, make_env, task_of
from .episode import Act, BrokenEpisodeError, Streams, remembering, reported, run_episode
from .guess import guess_task
from .inspection import inspect_env
from .model import Model
from .model_based import ModelBasedAgent
from .numpy_policy import NumpyPolicy
from .policy_code import write_c, write_onnx
from .policy_file import write_policy
from .rehearsal import rehearsed
from .stored import (
    agent_of,
    algorithm_of,
    begin_run,
    changed_versions,
    choose_trial,
    config_of,
    finished_trial,
    learn_rest,
    open_run_env,
    reopened,
)
from .task_file import load_task, task_entries
from .trial_agent import TrialAgent

__all__ = [
    "MCPILCO",
    "AbsentEnv",
    "Act",
    "BrokenEpisodeError",
    "Groups",
    "Model",
    "ModelBasedAgent",
    "NumpyPolicy",
    "SavedAgent",
    "Streams",
    "TrialAgent",
    "agent_of",
    "algorithm_of",
    "algorithms",
    "begin_run",
    "changed_versions",
    "choose_trial",
    "config_of",
    "difference",
    "find",
    "finished_trial",
    "guess_task",
    "horizon_of",
    "import_named",
    "input_bounds",
    "inspect_env",
    "learn_rest",
    "load_policy",
    "load_task",
    "make_env",
    "open_run_env",
    "preset_numbers",
    "rehearsed",
    "remembering",
    "reopened",
    "reported",
    "run_episode",
    "suitable_preset",
    "task_entries",
    "task_of",
    "with_limits",
    "with_model",
    "with_package",
    "with_regulator",
    "write_c",
    "write_onnx",
    "write_policy",
]
