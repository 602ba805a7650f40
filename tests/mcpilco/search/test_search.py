"""Laws of the policy search: it descends, restarts when the model says so, and survives NaN."""

from __future__ import annotations

import copy
import itertools
import math
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from mcpilco.config import Phase, SearchConfig
from mcpilco.dynamics import AngleAugmentation
from mcpilco.policies import Dropout, SaturatingCost, SumOfGaussians
from mcpilco.search.particles import Particles, Problem, rollout
from mcpilco.search.search import MOST_SKIPPED, Adam, PolicySearch, SearchResult

T = 6


# --- a real problem: drive a point on a line to 1 -------------------------------------------------


class Line:
    """x' = x + 0.5 u + a little noise."""

    noise_dim = 1

    def step(self, states: Tensor, inputs: Tensor, noise: Tensor) -> Tensor:
        return states + 0.5 * inputs + 0.01 * noise


def line_problem() -> Problem:
    return Problem(
        dynamics=Line(),
        cost=SaturatingCost((0,), (1.0,), (1.0,), (False,)),
        start_mean=torch.zeros(1, dtype=torch.float64),
        start_std=torch.full((1,), 0.05, dtype=torch.float64),
        horizon=T,
        reference_cost=1 - math.exp(-1),
        rollout=rollout,
    )


def line_policy(seed: int = 0) -> SumOfGaussians:
    policy = SumOfGaussians(AngleAugmentation(1, ()), [-1.0], [1.0], bases=8, squash=1.0)
    ones, generator = torch.ones(1, dtype=torch.float64), torch.Generator().manual_seed(seed)
    policy.randomise(ones, ones, 1.0, 0.1, generator)
    return policy


def search_line(seed: int = 0, report: list | None = None, **numbers) -> SearchResult:
    config = SearchConfig(
        **{
            "particles": 20,
            "steps": (80,),
            "phases": (Phase(0.1, until=0.5), Phase(0.02)),
            "restarts": (0,),
            "evaluation_particles": 50,
            **numbers,
        }
    )

    def note(*numbers) -> None:
        if report is not None:
            report.append(numbers)

    search = PolicySearch(config, torch.Generator().manual_seed(seed), note)
    return search.run(line_problem(), line_policy(), line_policy, trial=1)


def test_gradient_steps_solve_a_simple_problem() -> None:
    """The best policy pushes with 1 for two steps and then stays: about 0.22 of cost."""
    before = search_line(steps=(1,), phases=(Phase(1e-9),)).best
    after = search_line().best
    best = 1 - math.exp(-0.25)
    assert before.cost > 2.0
    assert best < after.cost < best + 0.15
    assert after.final_cost < 0.02
    assert after.steps == 80


def test_the_first_policy_is_not_changed() -> None:
    policy, search = line_policy(), PolicySearch(SearchConfig(), torch.Generator())
    problem, before = line_problem(), [p.clone() for p in policy.parameters()]
    search.config = SearchConfig(steps=(5,), particles=5, restarts=(0,))
    found = search.run(problem, policy, line_policy, trial=1).best.policy
    for mine, old, new in zip(policy.parameters(), before, found.parameters(), strict=True):
        assert torch.equal(mine, old)
        assert not torch.equal(new, old)


def test_equal_seeds_find_equal_policies_and_others_differ() -> None:
    first, again, other = (search_line(seed, steps=(5,)).best for seed in (0, 0, 1))
    assert torch.equal(first.policy.weights, again.policy.weights)
    assert (first.cost, first.cost_std) == (again.cost, again.cost_std)
    assert not torch.equal(first.policy.weights, other.policy.weights)


def test_the_costs_of_a_candidate_are_means_over_its_particles() -> None:
    best = search_line(steps=(3,)).best
    costs = best.costs.numpy()
    assert costs.shape == (T, 50)
    assert best.cost == pytest.approx(costs.mean(1).sum(), rel=1e-12)
    assert best.cost_std == pytest.approx(costs.sum(0).std(ddof=1), rel=1e-12)
    assert best.final_cost == pytest.approx(costs[-2:].mean(), rel=1e-12)
    shown = best.prediction(7)
    np.testing.assert_array_equal(shown.costs, costs[:, :7])
    assert shown.states.shape == (T + 1, 7, 1)
    assert shown.inputs.shape == (T, 7, 1)


def test_each_step_is_reported() -> None:
    report: list = []
    found = search_line(report=report, steps=(10,), failing=0.0, restarts=(2,))
    assert found.starts == 3
    assert found.steps == 30
    assert [step for step, _, _ in report] == list(range(1, 31))
    assert [steps for _, steps, _ in report] == [10] * 10 + [20] * 10 + [30] * 10
    values = [values for _, _, values in report]
    assert [v["policy/learning_rate"] for v in values] == 3 * ([0.1] * 5 + [0.02] * 5)
    assert [v["policy/start"] for v in values] == [1.0] * 10 + [2.0] * 10 + [3.0] * 10
    assert all(v["policy/cost"] > 0 and v["policy/gradient_norm"] > 0 for v in values)


def test_learning_rates_and_steps_follow_the_trial() -> None:
    config = SearchConfig(
        particles=4, steps=(2, 5), rates=(1.0, 0.5), phases=(Phase(0.1),), restarts=(0,)
    )
    report: list = []
    search = PolicySearch(config, torch.Generator(), lambda *numbers: report.append(numbers))
    search.run(line_problem(), line_policy(), line_policy, trial=2)
    assert len(report) == 5
    assert {values["policy/learning_rate"] for _, _, values in report} == {0.05}


@pytest.mark.parametrize("limit", [0.01, None])
def test_the_gradient_is_clipped_to_its_norm(limit: float | None) -> None:
    search = PolicySearch(SearchConfig(particles=10, clip_norm=limit), torch.Generator())
    policy, taken = line_policy(), []

    class Spy(Adam):
        def step(self, slopes: Sequence[Tensor], learning_rate: float) -> None:
            taken.extend(slopes)

    _, norm = search.step(line_problem(), policy, Spy(policy), 1.0)
    assert norm > 0.1  # before clipping
    moved = float(nn.utils.get_total_norm(taken))
    assert moved == pytest.approx(norm if limit is None else limit, rel=1e-4)


# --- a scripted problem: a policy is one number, and the model answers with it --------------------


class Level(nn.Module):
    """A policy whose cost is its level."""

    def __init__(self, level: float) -> None:
        super().__init__()
        self.level = nn.Parameter(torch.tensor(level, dtype=torch.float64))


def level_problem(answer: Callable[[Level, Dropout | None], Tensor]) -> Problem:
    """Each particle's state is `answer`, and its cost is its state."""

    def answered(dynamics, policy, start, noise, dropout=None) -> Particles:
        states = answer(policy, dropout) + torch.zeros(T + 1, len(start), 1, dtype=torch.float64)
        return Particles(states, states[:-1])

    return Problem(
        dynamics=Line(),
        cost=lambda states, inputs: states[..., 0],
        start_mean=torch.zeros(1, dtype=torch.float64),
        start_std=torch.ones(1, dtype=torch.float64),
        horizon=T,
        reference_cost=1.0,
        rollout=answered,
    )


def search_levels(
    levels: list[float],
    answer: Callable[[Level, Dropout | None], Tensor] = lambda policy, dropout: policy.level,
    rate: float = 1e-9,
    report: list | None = None,
    **numbers,
) -> SearchResult:
    """Starts at these levels, in turn."""
    config = SearchConfig(
        particles=3,
        evaluation_particles=3,
        **{
            "steps": (3,),
            "phases": (Phase(rate),),
            "polish": False,
            "screening": 1.0,
            "restarts": (len(levels) - 1,),
            **numbers,
        },
    )
    first, *others = map(Level, levels)
    seen = [] if report is None else report
    search = PolicySearch(config, torch.Generator(), lambda *entry: seen.append(entry))
    return search.run(level_problem(answer), first, lambda: others.pop(0), trial=1)


@pytest.mark.parametrize(
    ("levels", "starts", "best"),
    [
        ([0.05, 0.9, 0.01], 1, 0.05),  # the first will do
        ([0.9, 0.5, 0.09, 0.01], 3, 0.09),
        ([0.9, 0.5, 0.7, 0.6], 4, 0.5),  # none will do: the best of all
        ([0.101, 0.099], 2, 0.099),
        ([0.099, 0.01], 1, 0.099),
    ],
)
def test_restarts_happen_exactly_while_the_model_predicts_failure(
    levels: list[float], starts: int, best: float
) -> None:
    found = search_levels(levels, failing=0.1)
    assert found.starts == starts
    assert found.steps == 3 * starts
    assert found.best.cost == pytest.approx(T * best, rel=1e-6)


def test_good_first_policy_is_never_lost() -> None:
    """Steps this large make any policy worse."""

    def valley(policy: Level, dropout: Dropout | None) -> Tensor:
        return policy.level.square() / 0.05

    lost = search_levels([0.05], valley, rate=1e3, failing=0.1)
    assert lost.best.cost > T * 0.06
    kept = search_levels([0.05], valley, rate=1e3, failing=0.1, polish=True)
    assert kept.best.cost == pytest.approx(T * 0.05, rel=1e-6)
    assert kept.starts == 1


@pytest.mark.parametrize(("level", "entered"), [(0.05, 5), (0.2, 0)])
def test_first_policy_that_needs_polish_only_enters_half_way(level: float, entered: int) -> None:
    phases, report = (Phase(1e-9, until=0.5), Phase(1e-10)), []
    numbers = {"steps": (10,), "phases": phases, "failing": 0.1, "report": report}
    found = search_levels([level], polish=True, **numbers)
    assert found.steps == 10 - entered
    assert [steps for _, steps, _ in report] == [10 - entered] * found.steps
    rates = [values["policy/learning_rate"] for *_, values in report]
    assert rates == [1e-9] * (5 - entered) + [1e-10] * 5


def test_fresh_starts_are_never_half_way() -> None:
    """The first is bad, so that the second, which is good, is tried from random numbers."""
    found = search_levels([0.9, 0.05], failing=0.1, polish=True, steps=(10,))
    assert (found.starts, found.steps) == (2, 20)


def test_further_starts_are_given_up_early_where_they_cost_more_than_half_of_those_before() -> None:
    report: list = []
    levels = [0.5, 0.9, 0.3, 0.4, 0.45]
    found = search_levels(levels, failing=0.1, screening=0.3, steps=(10,), report=report)
    by_start = Counter(int(values["policy/start"]) for *_, values in report)
    assert by_start == {1: 10, 2: 3, 3: 10, 4: 10, 5: 3}  # the last one against 0.4 and 0.3
    assert (found.starts, found.steps) == (5, 36)
    assert found.best.cost == pytest.approx(T * 0.3, rel=1e-6)


def test_start_is_screened_by_a_mean_over_steps() -> None:
    """One lucky step, where the first start is screened, does not lower the bar for the next."""
    costs = iter([0.5] * 9 + [0.0] + [0.5] * 11 + [0.44] * 10 + [0.1] * 11)

    def answer(policy: Level, dropout: Dropout | None) -> Tensor:
        return policy.level * 0 + next(costs)

    found = search_levels([1.0, 1.0], answer, failing=0.0, screening=0.5, steps=(20,))
    assert found.steps == 40
    assert found.best.cost == pytest.approx(T * 0.1, rel=1e-6)


def test_restarts_may_differ_from_trial_to_trial() -> None:
    config = SearchConfig(restarts=(1, 3))
    assert [config.starts_of(trial) for trial in (1, 2, 3)] == [2, 4, 4]


def test_failure_is_measured_against_the_cost_without_a_policy() -> None:
    problem = level_problem(lambda policy, dropout: policy.level)
    for reference, starts in ((1.0, 2), (10.0, 1)):
        config = SearchConfig(
            particles=3, steps=(1,), phases=(Phase(1e-9),), restarts=(1,), failing=0.1
        )
        scaled = Problem(**{**vars(problem), "reference_cost": reference})
        search = PolicySearch(config, torch.Generator())
        assert search.run(scaled, Level(0.5), lambda: Level(0.6), 1).starts == starts


def test_masks_are_fresh_in_each_step_and_absent_when_a_policy_is_judged() -> None:
    masks: list[Dropout | None] = []

    def answer(policy: Level, dropout: Dropout | None) -> Tensor:
        masks.append(dropout)
        return policy.level

    search_levels([0.5], answer, phases=(Phase(0.1, dropout=0.25, until=0.7), Phase(0.1)))
    *steps, judged = masks
    assert [mask is None for mask in steps] == [False, False, False]
    search_levels([0.5], answer, phases=(Phase(0.1, dropout=0.25, until=0.5), Phase(0.1)))
    assert [mask is None for mask in masks[4:]] == [False, False, True, True]
    assert judged is None
    assert len({mask.seed for mask in steps}) == 3
    assert {mask.rate for mask in steps} == {0.25}


# --- numbers that are not finite ------------------------------------------------------------------


def nan_cost(policy: Level) -> Tensor:
    return policy.level * math.nan


def nan_gradient(policy: Level) -> Tensor:
    """A finite cost; the root's slope at 0 is infinite."""
    return policy.level.detach() + (policy.level * 0.0).sqrt()


def finite_gradient_of_a_nan_cost(policy: Level) -> Tensor:
    return policy.level + math.nan * torch.ones((), dtype=torch.float64)


POISONS = [nan_cost, nan_gradient, finite_gradient_of_a_nan_cost]


@pytest.mark.parametrize("poison", POISONS)
def test_single_steps_that_are_not_finite_are_passed_over(poison) -> None:
    calls = itertools.count()

    def answer(policy: Level, dropout: Dropout | None) -> Tensor:
        return poison(policy) if next(calls) % 3 == 1 else policy.level

    found = search_levels([0.5], answer, rate=0.01, steps=(30,))
    assert found.steps == 30
    moved = 0.5 - float(found.best.policy.level.detach())
    assert moved == pytest.approx(20 * 0.01, rel=0.05)  # Adam's steps, but for every third


@pytest.mark.parametrize("poison", POISONS)
def test_a_start_is_given_up_after_many_steps_that_are_not_finite(poison) -> None:
    """And the next one is tried; the policy keeps its last finite parameters."""

    def answer(policy: Level, dropout: Dropout | None) -> Tensor:
        return poison(policy) if float(policy.level.detach()) > 0.8 else policy.level

    found = search_levels([0.9, 0.5], answer, steps=(100,), failing=0.0)
    assert found.starts == 2
    assert found.steps == MOST_SKIPPED + 100
    if poison is not nan_gradient:  # whose cost the model does know
        assert found.best.cost == pytest.approx(T * 0.5, rel=1e-4)


@pytest.mark.parametrize("poison", POISONS)
def test_where_all_starts_are_given_up_the_first_policy_remains(poison) -> None:
    found = search_levels([0.7, 0.9, 0.8], lambda policy, dropout: poison(policy), steps=(100,))
    assert found.starts == 3
    assert found.steps == 3 * MOST_SKIPPED
    assert float(found.best.policy.level.detach()) == 0.7


@pytest.mark.parametrize("poison", POISONS)
def test_the_search_recovers_right_before_it_would_give_up(poison) -> None:
    calls = itertools.count(1)

    def answer(policy: Level, dropout: Dropout | None) -> Tensor:
        return policy.level if next(calls) % MOST_SKIPPED == 0 else poison(policy)

    assert search_levels([0.5], answer, steps=(100,)).steps == 100


def test_a_policy_that_is_not_finite_is_not_chosen() -> None:
    found = search_levels([math.nan, 0.9], steps=(30,), failing=0.0)
    assert float(found.best.policy.level.detach()) == pytest.approx(0.9)


def test_adam_is_torchs_to_the_last_bit() -> None:
    ours, generator = line_policy(), torch.Generator().manual_seed(1)
    theirs = copy.deepcopy(ours)
    adam, reference = Adam(ours), torch.optim.Adam(theirs.parameters(), 0.01, fused=True)
    for rate in (0.01, 0.01, 0.003):
        reference.param_groups[0]["lr"] = rate
        for parameter in theirs.parameters():
            parameter.grad = torch.randn(
                parameter.shape, generator=generator, dtype=parameter.dtype
            )
        adam.step([parameter.grad for parameter in theirs.parameters()], rate)
        reference.step()
    for mine, other in zip(ours.parameters(), theirs.parameters(), strict=True):
        assert mine.tolist() == other.tolist()


@pytest.mark.slow
def test_a_search_imports_no_compiler_of_torch() -> None:
    """It takes longer than a trial's first hundred steps."""
    code = (
        "import sys, mcpilco.search.search as s; from tests.mcpilco.search import test_search as t;"
    )
    code += "t.search_line(steps=(2,)); assert 'torch._dynamo' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


# --- a cost that is wide at first ---------------------------------------------------------------


def test_a_widened_step_follows_the_wide_cost_and_tells_the_true_one() -> None:
    """From equal random numbers, so from equal particles."""
    values, norms = {}, {}
    for name, problem, widening in (
        ("plain", line_problem(), 1.0),
        ("felt", line_problem(), 3.0),
        ("wide", line_problem().widened(3.0), 1.0),
    ):
        policy = line_policy()
        search = PolicySearch(SearchConfig(clip_norm=None), torch.Generator().manual_seed(0))
        numbers = 0.1, 0.0, widening
        values[name], norms[name] = search.step(problem, policy, Adam(policy), *numbers)
    assert values["felt"] == pytest.approx(values["plain"], rel=1e-12)
    assert norms["felt"] == pytest.approx(norms["wide"], rel=1e-12)
    assert norms["felt"] < 0.5 * norms["plain"]


def test_the_search_widens_the_cost_as_its_schedule_says(monkeypatch: pytest.MonkeyPatch) -> None:
    felt: list[float] = []
    widened = Problem.widened

    def spy(problem: Problem, factor: float) -> Problem:
        felt.append(factor)
        return widened(problem, factor)

    monkeypatch.setattr(Problem, "widened", spy)
    search_line(steps=(8,), widening=3.0)
    assert felt == [3.0, 2.5, 2.0, 1.5, 1.0, 1.0, 1.0, 1.0]
