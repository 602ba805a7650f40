"""Statistics over seeds and their intervals: of a run, and of the difference of two runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.stats import trim_mean

from mcpilco.data import title_of
from mcpilco.sweep.comparison import SPENT, Run

CONFIDENCE = 0.95
"""level of every interval [-]"""
_RESAMPLES = 10_000
SAME = 1e-3
"""amounts of experience whose ratio differs less from 1 are the same [-]"""


# Of numbers ------------------------------------------------------------------------


def rate(flags: Iterable[bool | None]) -> dict[str, float] | None:
    """Share of successes with its Wilson interval; None where nobody tells.

    Reference: Wilson (1927), J. Am. Stat. Assoc. 22.
    """
    from scipy.stats import binomtest

    told = [flag for flag in flags if flag is not None]
    if not told:
        return None
    test = binomtest(sum(told), len(told))
    interval = test.proportion_ci(CONFIDENCE, method="wilson")
    share = sum(told) / len(told)
    return {"n": len(told), "rate": share, "low": float(interval.low), "high": float(interval.high)}


def mean(values: Iterable[float | None]) -> dict[str, Any] | None:
    """Mean over seeds with its bootstrap interval, which takes two; None where nobody tells."""
    told = _told(values)
    if not len(told):
        return None
    low, high = bootstrapped(told, np.mean)
    return {"n": len(told), "mean": float(told.mean()), "low": low, "high": high}


def jackknife(
    left: Float[np.ndarray, "W ..."], R: Float[np.ndarray, "W W"]
) -> Float[np.ndarray, "*b"]:
    """Half of the interval of a number, by Student's t; infinity where there is one value only.

    With R the values' correlations, C what centers, and S the sum of squares of W pseudo-values,

        variance of the mean = 1'R 1 / W^2 / tr(C R) S,    degrees of freedom = tr(CR)^2 / tr(CR CR)

    Args:
        left: the number without each of W values.
        R: the correlations of these.

    Reference: Miller, The jackknife: a review, Biometrika 61 (1974); Satterthwaite, An approximate
        distribution of estimates of variance components, Biometrics Bulletin 2 (1946).
    """
    from scipy.stats import t

    CR = R - R.mean(axis=0)
    trace = np.trace(CR)
    if not trace > 0.0:
        return np.full(left.shape[1:], np.inf)
    S = np.square((len(R) - 1) * (left - left.mean(axis=0))).sum(axis=0)
    width = t.ppf(0.5 + 0.5 * CONFIDENCE, trace**2 / (CR * CR.T).sum())
    return np.asarray(width * np.sqrt(R.mean() / trace * S))


def bootstrapped(
    values: Float[np.ndarray, " S"], statistic: Callable[..., Any]
) -> tuple[float | None, float | None]:
    """Ends of the bootstrap interval of a statistic over seeds; None where there is one seed only.

    The statistic is of the values along `axis`.
    """
    from scipy.stats import bootstrap

    if len(values) < 2:
        return None, None
    interval = bootstrap(
        (values,),
        statistic,
        n_resamples=_RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",  # the others are undefined where all values are equal
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def spread(values: Iterable[float | None]) -> dict[str, float] | None:
    """Mean, standard deviation, median and quartiles; None where nobody tells."""
    told = _told(values)
    if not len(told):
        return None
    q1, median, q3 = np.quantile(told, (0.25, 0.5, 0.75))
    return {
        "n": len(told),
        "mean": float(told.mean()),
        "std": float(told.std(ddof=1)) if len(told) > 1 else 0.0,
        "q1": float(q1),
        "median": float(median),
        "q3": float(q3),
    }


def _told(values: Iterable[float | None]) -> np.ndarray:
    return np.array([value for value in values if value is not None], dtype=float)


# Of runs ------------------------------------------------------------------------


STATISTICS: Mapping[str, Callable[..., Any]] = {
    "mean": np.mean,
    "median": np.median,
    "iqm": partial(trim_mean, proportiontocut=0.25, axis=-1),
}
"""what many seeds are told as, by name; iqm: interquartile mean, of the middle half: less noisy
than the median, as deaf to outliers (Agarwal et al. (2021), Deep reinforcement learning at the edge
of the statistical precipice, NeurIPS)"""


@dataclass(frozen=True)
class Measure:
    """One thing that is compared."""

    key: str
    """its name in files"""
    label: str
    """in tables and pictures"""
    unit: str
    digits: int
    """behind the point"""
    short: str = ""
    """label where there is little room; empty: it is not shown there"""
    statistics: tuple[str, ...] = ("iqm", "median")
    """that it is told by; curves and differences show the first"""
    scale: float = 1.0
    """of what is shown: 100 for shares in percent [-]"""
    share: bool = False
    """the seeds say yes or no"""

    @property
    def title(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]"


_OF_POLICIES = (
    Measure(
        "success", "success of the test rollout", "%", 1, "success", ("mean",), 100.0, share=True
    ),
    Measure("p", "success of fresh rollouts", "%", 1, "p", ("mean", "iqm", "median"), 100.0),
    Measure("return", "return of the test rollout", "-", 1, "return"),
    Measure("fresh_return", "return of fresh rollouts", "-", 1),
)
_TIME = Measure(SPENT, "processor time so far", "s", 1, "CPU")


def measures(runs: Sequence[Run]) -> list[Measure]:
    """Everything that these runs can be compared in, in the order of tables.

    Success and returns, then the measures that the envs report, then processor time.
    """
    reported = dict.fromkeys(name for run in runs for name in run.measures)
    return [*_OF_POLICIES, *map(measure_of, reported), _TIME]


def measure_of(key: str) -> Measure:
    """The measure of this name: success, a return, processor time, or one that an env reports."""
    for measure in (*_OF_POLICIES, _TIME):
        if measure.key == key:
            return measure
    label, _, unit = title_of(key).removesuffix("]").rpartition(" [")
    return Measure(key, label, unit, 2, label)


@dataclass(frozen=True)
class Estimate:
    """A statistic over seeds and its 95 % interval."""

    seeds: int
    value: float
    low: float | None
    """None where there is one seed only"""
    high: float | None


def estimate(values: Sequence[float], measure: Measure, statistic: str) -> Estimate | None:
    """A statistic of finite values, in the measure's unit; None where there are none.

    The interval is Wilson's where seeds say yes or no, else that of the bootstrap over seeds.
    """
    if not len(values):
        return None
    scaled = measure.scale * np.asarray(values, dtype=float)
    if measure.share and (found := rate([bool(value) for value in values])):
        low, high = measure.scale * found["low"], measure.scale * found["high"]
        return Estimate(len(values), float(scaled.mean()), low, high)
    low_, high_ = bootstrapped(scaled, STATISTICS[statistic])
    return Estimate(len(values), float(STATISTICS[statistic](scaled)), low_, high_)


def difference(run: Run, other: Run, measure: Measure, amount: float) -> Estimate | None:
    """How much more the first has than the other, after the same experience, seed by seed.

    The statistic is that of the differences, whose interval is the bootstrap's: what a seed does
    to both alike drops out.
    """
    here, there = run.at(amount, measure.key), other.at(amount, measure.key)
    common = sorted(here.keys() & there.keys())
    if not common:
        return None
    gains = measure.scale * np.array([here[seed] - there[seed] for seed in common])
    statistic = STATISTICS[measure.statistics[0]]
    return Estimate(len(common), float(statistic(gains)), *bootstrapped(gains, statistic))


@dataclass(frozen=True)
class Row:
    """An estimate and what it is of."""

    run: str
    measure: Measure
    statistic: str
    experience_s: float
    """behind the policies [s]"""
    estimate: Estimate
    other: str | None = None
    """of a difference: what is taken away"""


def estimates(runs: Sequence[Run]) -> list[Row]:
    """Every statistic of every measure, after each amount of experience of each run."""
    return [
        Row(run.name, measure, statistic, float(amount), found)
        for measure in measures(runs)
        for run in runs
        for statistic in measure.statistics
        for amount in run.amounts
        if (found := estimate(list(run.at(amount, measure.key).values()), measure, statistic))
    ]


def differences(runs: Sequence[Run]) -> list[Row]:
    """Every pair of runs with seeds in common, after each amount of experience that both have."""
    return [
        Row(run.name, measure, measure.statistics[0], amount, found, other.name)
        for measure in measures(runs)
        for other, run in itertools.combinations(runs, 2)
        for amount in common_amounts([other, run])
        if (found := difference(run, other, measure, amount))
    ]


def common_amounts(runs: Sequence[Run]) -> list[float]:
    """Amounts of experience that all runs have [s], rising."""

    def has(run: Run, amount: float) -> bool:
        return any(same_amount(float(own), amount) for own in run.amounts)

    return [a for a in all_amounts(runs[:1]) if all(has(run, a) for run in runs[1:])]


def all_amounts(runs: Sequence[Run]) -> list[float]:
    """Amounts of experience that any run has [s], rising, those that are the same once."""
    distinct: list[float] = []
    for amount in sorted(float(amount) for run in runs for amount in run.amounts):
        if not distinct or not same_amount(amount, distinct[-1]):
            distinct.append(amount)
    return distinct


def same_amount(amount: float, other: float) -> bool:
    """Whether two amounts of experience are the same."""
    return abs(amount - other) <= SAME * max(abs(amount), abs(other))
