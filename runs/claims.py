"""The measured claims of README and its shortfalls: two tables, computed from stored results.

    python runs/claims.py     # rewrites both in README.md

A claim is a line of `CLAIMS` or `SHORTFALLS`: the results that it rests on and how its figure comes
out of them. The seeds' role and the code are those of the results. tests/test_readme.py compares
README with these tables, and finds numbers of README that no table holds.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parent))

from all_tables import TABLES, Table
from evidence import read_made
from harness import fill
from provenance import ROOT

from mcpilco.logbook import read_json
from mcpilco.sweep import markdown, mean, mean_cell, rate, rate_cell, spread, spread_cell

README = ROOT / "README.md"
BY = "claims.py"

Results = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Claim:
    """A figure, and the results that it comes from."""

    says: str
    """what was measured, on what"""
    run: str
    results: str
    """a pattern that one table of the run holds"""
    figure: Callable[[Results], str]
    """the figure, from the results in the order of their names"""
    beside: str = ""
    """the thesis's figure, or an aim"""

    @property
    def table(self) -> Table:
        """The table that holds the results."""
        held = (t for t in TABLES if t.run == self.run and t.holds(Path(self.results)))
        return next(held)

    def paths(self) -> list[Path]:
        """The results."""
        return [path for path in self.table.paths() if path.match(self.results)]

    def cells(self) -> tuple[str, ...]:
        """Its row in README."""
        figure = self.figure([read_json(path) for path in self.paths()])
        page = f"[{self.run}](runs/{self.run}/README.md)"
        return self.says, figure, self.beside, self.seeds(), page

    def seeds(self) -> str:
        """How many there are, and their role."""
        by_seed = {path.name: self.table.role(path) for path in self.paths()}
        roles = Counter(by_seed.values())
        told = [f"{n} {role}" for role, n in roles.items() if role != "none"]
        return ", ".join(told) or "no seed"


# How figures come out of results ------------------------------------------------------------------


def success(experience: float) -> Callable[[Results], str]:
    """How often the policies after so much experience [s] succeed in their test rollout [%]."""
    return lambda found: rate_cell(rate(row["success"] for row in _after(found, experience)))


def fresh_success(experience: float) -> Callable[[Results], str]:
    """The mean success of those policies over fresh rollouts [%]."""
    return lambda found: mean_cell(mean(row["p"] for row in _after(found, experience)))


def both_less_rbf(found: Results) -> str:
    """The difference of the same seeds; those with RBF alone come first by its name."""
    rows = _after(found, 12.0)
    seeds = len(rows) // 2
    pairs = zip(rows[:seeds], rows[seeds:], strict=True)
    return mean_cell(mean(both["p"] - rbf["p"] for rbf, both in pairs))


def mean_of(key: str, experience: float, digits: int) -> Callable[[Results], str]:
    """The mean over seeds of a number that the env tells."""
    return lambda found: f"{np.mean([row[key] for row in _after(found, experience)]):.{digits}f}"


def _after(found: Results, experience: float) -> list[Mapping[str, Any]]:
    rows = (row for seed in found for row in seed["trials"])
    return [row for row in rows if round(row["experience_s"], 1) == experience]


def training_cpu(found: Results) -> str:
    """CPU time of a whole training [s]."""
    return spread_cell(spread(sum(row["cpu_s"] for row in seed["trials"]) for seed in found), 1)


def speed_up(found: Results) -> str:
    """The least and the greatest ratio over sizes, float64."""
    return _from_to([row["ratio"] for row in found[0]["ratios"] if row["engine"] == "fused"])


def single_over_double(found: Results) -> str:
    """How much faster single precision is than double, least and greatest over sizes."""
    size = ("particles", "samples", "steps", "bases")
    seconds = {
        (row["engine"], *(row[name] for name in size)): row["ours_s"] for row in found[0]["ratios"]
    }
    double = {key[1:]: value for key, value in seconds.items() if key[0] == "fused"}
    return _from_to([double[key] / seconds[("float32", *key)] for key in double])


def compiling(found: Results) -> str:
    """CPU time of the first step of a process that compiles [s], least and greatest."""
    return _from_to([row["first"]["cpu_s"] for row in found[0]["calls"]])


def solved(found: Results) -> str:
    """How many seeds have a policy that succeeds in its test and in 90 % of its fresh rollouts."""
    good = [[row for row in seed["trials"] if row["success"] and row["p"] >= 0.9] for seed in found]
    seconds = [rows[0]["experience_s"] for rows in good if rows]
    return f"{len(seconds)} of {len(found)} seeds, after a median of {np.median(seconds):g} s"


def over_the_posterior(found: Results) -> str:
    """How much more often policies over a posterior succeed than those at its mean [points]."""
    over, at_mean = (np.mean([one["legs"][leg]["happened"] for one in found]) for leg in "fg")
    return f"{100.0 * (over - at_mean):+.0f} points"


def mean_on_board(*keys: str) -> Callable[[Results], str]:
    """The mean over seeds of a number that the boards' scripts give."""
    return lambda found: f"{np.mean([reduce(getitem, keys, one) for one in found]):.3f}"


def reached(which: str) -> Callable[[Results], str]:
    """RMSE of the tip in x, y and z [mm], over all arms and targets of a kind."""

    def figure(found: Results) -> str:
        each = [trial[which] for trial in found if which in trial]
        squares = np.square([one["position_m"] for one in each])
        mean = np.average(squares, axis=0, weights=[one["targets"] for one in each])
        return ", ".join(f"{1e3 * value:.1f}" for value in np.sqrt(mean))

    return figure


def covered(way_points: int) -> Callable[[Results], str]:
    """RMSE of the tip in x, y and z [mm], over all arms, with samples of so many way-points."""

    def figure(found: Results) -> str:
        squares = np.square([one[str(way_points)]["reached"]["position_m"] for one in found])
        return ", ".join(f"{1e3 * rms:.1f}" for rms in np.sqrt(squares.mean(0)))

    return figure


def gip_over_pp(found: Results) -> str:
    """Medians of GIP's nMSE over those of PP, joint by joint."""
    gip, pp = (np.median([trial["nmse"][name] for trial in found], 0) for name in ("gip", "pp"))
    return ", ".join(f"{ratio:.2g}" for ratio in gip / pp)


def fits(*kernels: str) -> Callable[[Results], str]:
    """Median fits of kernels [%]."""

    def figure(found: Results) -> str:
        told = (
            np.median([trial["kernels"][kernel]["fit"] for trial in found]) for kernel in kernels
        )
        return ", ".join(f"{fit:.1f}" for fit in told)

    return figure


def left(found: Results) -> str:
    """How many of all rollouts cross a limit [%]."""
    return rate_cell(rate(crossed for r in found for crossed in r["explored"] + r["crossed"]))


def swung_up(found: Results) -> str:
    """How often the policy after 12 s of experience succeeds, and keeps the limits [%]."""
    pairs = (zip(r["experience_s"], r["success"], strict=True) for r in found)
    return rate_cell(rate([done for spent, done in each if spent <= 12.0][-1] for each in pairs))


def count(found: Results) -> str:
    """How many results there are."""
    return str(len(found))


def verdicts(found: Results) -> str:
    """How many questions each verdict answers."""
    told = Counter(question["verdict"] for question in found)
    return ", ".join(f"`{verdict}` {n}" for verdict, n in sorted(told.items()))


def crossed(found: Results) -> str:
    """On how many machines a policy out of the corrected simulation succeeds, and the nominal's."""

    def swung_up(leg: str) -> int:
        return sum(leg in row and row[leg]["happened"][0] >= 0.9 for row in found)

    return f"{swung_up('corrected')} of {len(found)} (nominal: {swung_up('nominal')})"


def _from_to(values: Sequence[float]) -> str:
    return f"{min(values):.1f} to {max(values):.1f}"


# The claims ---------------------------------------------------------------------------------------

SWING_UP = "cartpole_swingup", "results/default/seeds/*.json"
THESIS = "cartpole_swingup", "results/thesis/seeds/*.json"
WIDENED = "ablations", "results/thesis/widening/seeds/*.json"
PUSHING = "ablations", "results/thesis/large-weights/seeds/*.json"
SPEED = "speed", "results.json"
LIMITED = "limits", "results/limited/*.json"
PENDUBOT_BOARD = "realaigym", "results/pendubot-full-*.json"
ACROBOT_BOARD = "realaigym", "results/acrobot-full-*.json"
CONTROLLER = "kinematics", "results/controller/*.json"
COVERING = "kinematics", "results/covering/*.json"
POSITIONS = "partial_state", "results/modelled/seeds/*.json"


def components(cell: str) -> tuple[str, str]:
    """The results of a model on the analytic cart-pole."""
    return "model_components", f"analytic/{cell}/seeds/*.json"


CLAIMS = (
    Claim(
        "cart-pole: CPU time of a whole training [s], median (quartiles)", *SWING_UP, training_cpu
    ),
    Claim(
        "cart-pole in MuJoCo: success after 12 s [%]",
        "mujoco_swingup",
        "results/default/seeds/*.json",
        success(12.0),
        "88.5, analytic",
    ),
    Claim(
        "pendulum, preset of the cart-pole: success after 16 s [%]",
        "pendulum_swingup",
        "results/default/seeds/*.json",
        success(16.0),
    ),
    Claim(
        "pendubot with its equations and wrong masses: solved",
        "pendubot_swingup",
        "results/pendubot-full-*.json",
        solved,
    ),
    Claim(
        "pendubot without equations: solved",
        "pendubot_swingup",
        "results/pendubot-without-equations-*.json",
        solved,
    ),
    Claim(
        "acrobot with its equations and wrong masses: solved",
        "pendubot_swingup",
        "results/acrobot-full-*.json",
        solved,
    ),
    Claim(
        "RealAIGym's board of the pendubot, whose equations are given: robustness, mean of seeds",
        *PENDUBOT_BOARD,
        mean_on_board("robustness"),
        "best published 0.913",
    ),
    Claim(
        "the same of the acrobot: robustness",
        *ACROBOT_BOARD,
        mean_on_board("robustness"),
        "best published 0.751",
    ),
    Claim(
        "the same boards, RealAI score: pendubot",
        *PENDUBOT_BOARD,
        mean_on_board("score", "RealAI Score"),
        "best published 0.682",
    ),
    Claim(
        "RealAI score: acrobot",
        *ACROBOT_BOARD,
        mean_on_board("score", "RealAI Score"),
        "best published 0.655",
    ),
    Claim(
        "cart-pole with its equations and wrong masses, preset `thorough`: success after 3 s [%]",
        *components("physics+rbf-thorough"),
        success(3.0),
    ),
    Claim(
        "cart-pole, its actuator late by two samples, and told so: p after 15 s [%]",
        *components("delay-2-predicted"),
        fresh_success(15.0),
    ),
    Claim("policy step: times as fast as plain torch, over four sizes", *SPEED, speed_up),
    Claim("policy step: single precision, times as fast as double", *SPEED, single_over_double),
    Claim("policy step: CPU time of the first, which compiles [s]", *SPEED, compiling, "15"),
    Claim("limits: rollouts that leave the rail, exploration included [%]", *LIMITED, left, "1"),
    Claim("limits: success after 12 s, within the rail [%]", *LIMITED, swung_up, "90"),
)

SHORTFALLS = (
    Claim(
        "`cross` over UDP to hidden machines, a minute of recordings: swung up in 9 of 10 attempts",
        "rig",
        "results/crossings/*.json",
        crossed,
        "9 of 10",
    ),
    Claim("preset `thesis`: success after 12 s [%]", *THESIS, success(12.0), "88.5"),
    Claim(
        "preset `thesis`: mean distance of the cart after 12 s [m]",
        *THESIS,
        mean_of("mean_abs_cart_m", 12.0, 2),
        "0.16",
    ),
    Claim(
        "the same preset, its cost begun three times as wide: success after 12 s [%]",
        *WIDENED,
        success(12.0),
        "88.5",
    ),
    Claim(
        "and the mean distance of the cart [m]",
        *WIDENED,
        mean_of("mean_abs_cart_m", 12.0, 2),
        "0.16",
    ),
    Claim(
        "the same preset, first weights twice as large: success after 12 s [%]",
        *PUSHING,
        success(12.0),
        "88.5",
    ),
    Claim(
        "cart-pole: p after 12 s with RBF + MPK less that with RBF [points]",
        *components("rbf*"),
        both_less_rbf,
        "far above 0",
    ),
    Claim("cart-pole, positions measured alone: p after 15 s [%]", *POSITIONS, fresh_success(15.0)),
    Claim(
        "cart-pole, an actuator that lags by a sample, three inputs in the state: p after 12 s [%]",
        *components("lag-memory"),
        fresh_success(12.0),
    ),
    Claim(
        "kinematics from a camera: the controller's errors in x, y, z, targets within the samples' "
        "range of each joint [mm]",
        *CONTROLLER,
        reached("mended, inside"),
        "6.5, 11.1, 22.8",
    ),
    Claim(
        "the same, targets outside of it [mm]", *CONTROLLER, reached("mended, outside"), "not told"
    ),
    Claim(
        "targets within it, refitted three times with the poses reached [mm]",
        *CONTROLLER,
        reached("mended, refit 3 with the poses reached, inside"),
        "1.7, 1.6, 2.0, refitted once",
    ),
    Claim(
        "the same, all targets, its 300 samples on a path through 25 way-points [mm]",
        *COVERING,
        covered(25),
        "6.5, 11.1, 22.8",
    ),
    Claim("and through 400 way-points, no longer [mm]", *COVERING, covered(400), "6.5, 11.1, 22.8"),
    Claim(
        "torques of six joints: error of GIP over that of PP, joint by joint",
        "gip",
        "results/ur10/*.json",
        gip_over_pp,
        "below 1",
    ),
    Claim(
        "Volterra series, system (6.36), larger test inputs: fit of MPK, PK, IPK [%]",
        "volterra",
        "results/third-order-2/*.json",
        fits("mpk", "pk", "ipk-1"),
        "MPK 10 % better",
    ),
    Claim(
        "Volterra series, system (6.38), order 3 at 5 dB: fit of SED-MPK and MPK [%]",
        "volterra",
        "results/wiener-3-5dB/*.json",
        fits("sed-mpk", "mpk"),
        "SED-MPK far above",
    ),
    Claim(
        "the same, order 5 at 20 dB: fit of SED-MPK [%]",
        "volterra",
        "results/wiener-5-20dB/*.json",
        fits("sed-mpk"),
        "above 80",
    ),
    Claim(
        "comparison: seeds of SAC that were run, and of PPO; none of TQC",
        "cartpole_comparison",
        "cartpole/sac/seeds/*.json",
        count,
        "10",
    ),
    Claim(
        "crossing from 20 s of recordings: policies over the posterior beside those at its mean",
        "crossing_the_gap",
        "results/seeds/01*.json",
        over_the_posterior,
        "+15 points",
    ),
    Claim(
        "recordings of real machines: questions by verdict of `mcpilco gap`",
        "real_machines",
        "results/*/*.json",
        verdicts,
        "named",
    ),
)


def table(claims: Sequence[Claim]) -> str:
    """A line a claim."""
    header = ("what", "here", "thesis, or aim", "seeds", "page")
    return markdown(header, [claim.cells() for claim in claims])


def code() -> str:
    """How many of all tables of runs/ say which code made them."""
    found = [paths for one in TABLES if (paths := one.paths())]
    told = sum(all(read_made(path).get("digest") for path in paths) for paths in found)
    return (
        f"Of {len(found)} tables under `runs/`, {told} say by a digest which code made them. `make "
        "stale` lists those that are not of today's code, and of which it has not made a sample "
        "again with equal results."
    )


LEGEND = (
    "In brackets: 95 % intervals, unless told otherwise. *Chosen on*: a number of the method was "
    "chosen on these seeds, or changed because of their failures; *tested on*: on none of them."
)


def main() -> None:
    """Rewrite both tables."""
    fill(README, parts(), name="claims", by=BY)
    fill(README, [table(SHORTFALLS)], name="shortfalls", by=BY)


def parts() -> list[str]:
    """The first of them, and what is to be said of both."""
    return [table(CLAIMS), LEGEND, code()]


if __name__ == "__main__":
    main()
