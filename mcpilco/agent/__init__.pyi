from . import algorithms
from .agent import MCPILCO
from .agent_file import Groups, SavedAgent, difference
from .algorithms import Agent, find, find_after_import
from .contract import AbsentEnv, horizon_of, input_bounds, make_env, task_of
from .controller import Act, remembering
from .episode import BrokenEpisodeError, reported, run_episode
from .guess import guess_task
from .inspection import inspect_env
from .model import Model
from .model_based import ModelBasedAgent
from .model_based_file import load_policy
from .policy_file import write_policy
from .streams import Streams
from .task_file import load_task
from .trial_agent import TrialAgent

__all__ = [
    "MCPILCO",
    "AbsentEnv",
    "Act",
    "Agent",
    "BrokenEpisodeError",
    "Groups",
    "Model",
    "ModelBasedAgent",
    "SavedAgent",
    "Streams",
    "TrialAgent",
    "algorithms",
    "difference",
    "find",
    "find_after_import",
    "guess_task",
    "horizon_of",
    "input_bounds",
    "inspect_env",
    "load_policy",
    "load_task",
    "make_env",
    "remembering",
    "reported",
    "run_episode",
    "task_of",
    "write_policy",
]
