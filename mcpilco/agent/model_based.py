"""Learning by trials: fit a model to all data, search a policy in it, try it, go on."""

from __future__ import annotations

import itertools
import math
import warnings
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from mcpilco.agent.agent_file import SavedModelBased, arrays_of, difference, load_policy
from mcpilco.agent.episode import Act, Controller, remembering
from mcpilco.agent.model import Model
from mcpilco.agent.trial_agent import TrialAgent
from mcpilco.data import Rollout, Stopwatch, Transitions, TrialResult
from mcpilco.logbook import Callback
from mcpilco.policies import Bounds, RewardCost, careful, held, with_cost
from mcpilco.search import EXPLORED, Limits, SearchResult
from mcpilco.sensing import PastInputs, Perception, chained
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, Estimator, InputError, NotPositiveDefiniteError

SHOWN_PARTICLES = 100
"""particles of a prediction that are kept with a trial's result"""


class ModelBasedAgent(TrialAgent):
    """Learns by trials with a model; a subclass says which model, policy and search.

    The first call of `learn` spends one rollout on exciting inputs, or `Config.exploration` steps;
    each further rollout is a trial: fit the model to all data, search a policy, try it.

    A trial whose model cannot be made, or predicts nothing finite, tries the last policy once
    more, for its data; one whose env breaks off keeps the steps before. Either tells why in
    `TrialResult.failure`, and the next trial follows.

    Where there are limits, a brake acts on the commands from the first episode on, in which it is
    learned. While it does not hold them all, an episode of random inputs ends half-way to a limit,
    and a trial without a policy that is predicted to keep them is such an episode.
    """

    saved_type = SavedModelBased
    model: Model
    limits: Limits | None = None
    """of states, which the policy's brake holds, or else a policy must be predicted to keep"""

    def _set_up(self) -> None:
        self.policy: Any = self.make_policy(self.config, self.task, self.low, self.high)
        self.model = self._new_model()
        partly = self.task.measured is not None
        self.perception = Perception(self.config.estimator, self.task) if partly else None
        self._refined: Transitions | None = None
        """the transitions as a trial has smoothed them anew, while it lasts"""
        self.reference_cost = 1.0
        self.fitted_rows = 0
        """how many rows the model was fitted to: those of the last trial are not among them"""
        self.tracker = self.model.tracker(None)
        """estimator of the states in which late commands act; None where none is late"""
        self.taught = False
        """whether it has the policy of another agent before its first trial"""

    def begin_with(self, source: ModelBasedAgent) -> None:
        """Take over another agent's policy: it is tried first, and the first search begins with it.

        Its data stay behind: they are of another system, such as a simulation of this one.

        Raises:
            InputError: this agent has learned already, or the other one's states, inputs or numbers
                are not those of this one.
        """
        if not self._unexplored:
            raise InputError("A policy is taken over by a new agent, got one that has learned.")
        if different := difference(source.task, self.task):
            name, there, here = different
            raise InputError(
                f"A policy must be of the same states and inputs; its {name} is {there}, here "
                f"{here}."
            )
        try:
            load_policy(self.policy, arrays_of(source.policy))
        except ValueError as error:
            raise InputError(
                f"A policy must be of this algorithm and of these numbers: {error}."
            ) from error
        if isinstance(self.task.cost, RewardCost) and isinstance(source.task.cost, RewardCost):
            self.task.cost.load_arrays(source.task.cost.to_arrays())
        self.reference_cost, self.taught = source.reference_cost, True

    @staticmethod
    @abstractmethod
    def make_policy(config: Any, task: TaskSpec, low: Bounds, high: Bounds) -> Any:
        """A policy that has learned nothing, with buffers `squash.centre` and `.half_range`."""

    @staticmethod
    @abstractmethod
    def make_model(config: Any, task: TaskSpec) -> Model:
        """A model that has seen nothing yet."""

    def _new_model(self) -> Model:
        return self.make_model(self.config, self.task)

    @abstractmethod
    def _random_policy(self, generator: torch.Generator) -> Any:
        """A start for the search, which knows what has been recorded."""

    @abstractmethod
    def _search(
        self, trial: int, perception: Perception | None, events: Callback
    ) -> SearchResult[Any]:
        """Search the trial's policy, in the model as it is fitted now.

        The best candidate has what `mcpilco.search.Candidate` has of `policy`, `cost`, `cost_std`
        and `prediction`.

        Raises:
            NotPositiveDefiniteError: the model cannot be conditioned on the data.
        """

    @staticmethod
    def usual_trials(config: Any) -> int:
        return 4

    def _own_task(self, task: TaskSpec) -> TaskSpec:
        """The task as the agent sees it: with a cost."""
        return with_cost(task)

    def _fit_model(self, trial: int) -> dict[str, float]:
        """Fit the model to all data; returns the numbers of the fit by name."""
        return self.model.fit(self._data)

    @property
    def num_timesteps(self) -> int:
        return 0 if self.transitions is None else len(self.transitions)

    def _trials_within(self, total_timesteps: int) -> int:
        needed = self.timesteps_of(1)
        trials = 1 + math.ceil((total_timesteps - needed) / self.horizon)
        if trials < 1:
            first = f"{needed - self.horizon} of first inputs and " if self._unexplored else ""
            raise InputError(
                f"learn needs at least {needed} timesteps, {first}{self.horizon} for a trial, "
                f"got {total_timesteps}."
            )
        return trials

    def timesteps_of(self, trials: int) -> int:
        return trials * self.horizon + (self._exploration_steps if self._unexplored else 0)

    @property
    def _unexplored(self) -> bool:
        return self.transitions is None

    @property
    def _exploration_steps(self) -> int:
        asked = self.config.exploration
        return self.horizon if asked is None else asked

    def _explore(self) -> list[Rollout]:
        """Rollouts of exciting inputs, or of the policy taken over; more where they end early."""
        if not self._unexplored:
            return []
        inputs = self.streams.inputs(trial=0)
        records: list[Rollout] = []
        while (left := self._exploration_steps - sum(map(len, records))) > 0:
            if self.taught:
                record, _ = self._run_episode(self.on_states(), 0, left, len(records))
            else:
                record, _ = self._random_episode(inputs, 0, left, records)
            records.append(_digested(record, self.perception))
        for record in records:
            self._take(record)
        self._learn_cost(() if self.taught else records)
        if not self.taught:
            self.policy = self._random_policy(self.streams.search(trial=0))
        return records

    def _random_episode(
        self, inputs: np.random.Generator, trial: int, steps: int, before: Sequence[Rollout] = ()
    ) -> tuple[Rollout, str | None]:
        """A rollout of inputs that excite the system, after those before it.

        Where there are limits they are random, and the brake is learned on the way; until it holds
        them all, the rollout ends half-way to one.
        """
        episode = len(before)
        if self.limits is None:
            act = self._exciting(inputs, min(steps, self.horizon), before)
            return self._run_episode(act, trial, steps, episode)
        draws = (inputs.uniform(self.low, self.high) for _ in itertools.count())
        known = [record.transitions() for record in before]
        learns = self._unexplored and self.perception is None
        braked = Controller(careful(self.policy.brake, draws, known, learns), self.estimator)
        return self._run_episode(remembering(braked.answer), trial, steps, episode, self._far)

    def _exciting(self, random: np.random.Generator, steps: int, before: Sequence[Rollout]) -> Act:
        """Inputs that excite the system, for an episode of so many steps after those before it."""
        return lambda _: random.uniform(self.low, self.high)

    def _far(self, measured: Float[np.ndarray, " Y"]) -> bool:
        """Whether a random input might lead out of the limits, as far as they are measured."""
        if self.policy.brake.holds:
            return False
        assert self.limits is not None
        states = np.array(self.task.start_mean)
        states[list(self.task.measured_states)] = measured
        return bool(self.limits.beyond(torch.from_numpy(states)) > EXPLORED - 1.0)

    def _begins_with_policy(self, trial: int) -> bool:
        """Whether a trial's search finds a policy that was searched before."""
        return trial > 1 or self.taught

    def _learn_cost(self, random: Sequence[Rollout] = ()) -> None:
        """Fit the cost to the rewards so far, where it is not given; `random` are the first."""
        cost = self.task.cost
        if isinstance(cost, RewardCost):
            if random:
                rewards = [held(record.rewards, self.horizon) for record in random]
                cost.baseline = float(np.mean(rewards))
            cost.fit()
            self.reference_cost = cost.reference
        elif random:
            self.reference_cost = float(np.mean([self._costs(record) for record in random]))

    def _trial(self, trial: int, steps: int, events: Callback) -> TrialResult:
        """Fit the model to all data, search a policy in it, try it on the system."""
        self._refined = None
        watch, experience = Stopwatch(), len(self._data)
        found, no_policy, perception = self._improve(trial, events)
        policy, prediction = self.policy, None
        if found is not None and no_policy is None:
            policy = found.best.policy
            shown = found.best.prediction(SHOWN_PARTICLES)
            prediction = shown.of_states(len(self.task.state_names)).later(self.model.delay.whole)
        if self.limits is not None and no_policy is not None:
            inputs = self.streams.inputs(trial)
            record, broken = self._random_episode(inputs, trial, self.horizon)
        else:
            act = remembering(Controller(policy, self._estimator(perception)).answer)
            record, broken = self._run_episode(act, trial, self.horizon)
        record = _digested(record, perception)
        self._take(record)
        self.policy, self.perception = policy, perception
        if perception is not None:
            self.look_ahead()  # the episode has shown how large the errors of its estimates are
        failures = [failure for failure in (no_policy, broken) if failure]
        learned: dict[str, Any] = {"noise_std": self.model.noise_std, "prediction": prediction}
        if found is not None:
            learned |= {"policy_steps": found.steps, "starts": found.starts}
            learned["predicted_cost"] = found.best.cost
            learned["predicted_cost_std"] = found.best.cost_std
        if self.limits is not None:
            states = torch.from_numpy(record.shown_states)[:, None]
            learned["limits_crossed"] = self.limits.kept(states) < 1.0
            learned["limits_kept"] = None if found is None else found.best.kept
        failure = " ".join(failures) or None
        return self._result(trial, record, watch, experience, failure=failure, **learned)

    def _improve(
        self, trial: int, events: Callback
    ) -> tuple[SearchResult[Any] | None, str | None, Perception | None]:
        """Fit the model and search a policy: the result, or the reason why there is none to try.

        And what the policy to be tried makes of measurements.
        """
        model, rows, perception = self.model.to_arrays(), self.fitted_rows, self.perception
        try:
            self.model.gp.on_iteration = events.on_fit_step
            try:
                numbers = self._fit_model(trial)
            finally:
                self.model.gp.on_iteration = None  # copies of the model are no part of the fit
            events.on_model_fitted(numbers)
            self.fitted_rows = len(self._data)
            self.look_ahead()
            self._learn_cost()
            adapted = perception and perception.adapted(self._data)
            found = self._search(trial, adapted, events)
        except (NotPositiveDefiniteError, torch.linalg.LinAlgError) as error:
            self.model.load_arrays(model)
            self.fitted_rows = rows
            self.look_ahead()
            return None, self._failed(trial, f"No policy could be learned: {error}"), perception
        if not math.isfinite(found.best.cost):
            why = self._failed(trial, "The model predicted no finite cost for any policy.")
            return found, why, perception
        if self.limits is not None and not found.best.admissible:
            why = self._failed(
                trial,
                "No policy is predicted to keep the limits: of the best one's particles "
                f"{found.best.kept:.1%} do, of at least {self.limits.share:.1%}. It is not tried; "
                "random inputs are, which end half-way to a limit.",
            )
            return found, why, perception
        return found, None, adapted

    def _take(self, record: Rollout) -> None:
        if isinstance(self.task.cost, RewardCost):
            self.task.cost.add(record)
        rows = record.transitions().after_inputs(self.model.memory)
        self.transitions = rows if self.transitions is None else self._data + rows
        self._refined = None

    @property
    def estimator(self) -> Estimator | None:
        """Makes the states that the policy acts on of measurements; None where it sees them."""
        return self._estimator(self.perception)

    def _estimator(self, perception: Perception | None) -> Estimator | None:
        measured = None if perception is None else perception.estimator
        past = None
        if self.tracker is None and self.model.memory:
            past = PastInputs(len(self.task.input_names), self.model.memory)
        return chained(measured, self.tracker, past)

    def on_states(self) -> Act:
        return remembering(Controller(self.policy, self.estimator).answer)

    def look_ahead(self) -> None:
        """Predict states by the model and the data it was fitted to, where the actuator is late."""
        known = self._data[: self.fitted_rows] if self.fitted_rows else None
        error = None if self.perception is None else self.perception.estimate_std
        self.tracker = self.model.tracker(known, error)

    @property
    def _cost(self) -> Cost:
        assert self.task.cost is not None, "with_cost has seen to it"
        return self.task.cost

    @property
    def _data(self) -> Transitions:
        assert self.transitions is not None, "learn explores first"
        return self.transitions if self._refined is None else self._refined

    def _answer(
        self, measured: Float[np.ndarray, "*b Y"], state: Any, begun: Any, deterministic: bool
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        if not self.trials:
            warnings.warn("No policy was learned yet; call learn before predict.", stacklevel=3)
        return Controller(self.policy, self.estimator).answer(measured, state, begun)


def _digested(record: Rollout, perception: Perception | None) -> Rollout:
    """The rollout with the states that are made of its measurements."""
    return record if perception is None else perception.digest(record)
