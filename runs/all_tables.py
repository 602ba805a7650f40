"""The tables of all runs: where their results are, the code that makes them, the seeds' role.

A new table is a line of `TABLES`.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from provenance import RUNS, Code

Role = Literal["chosen on", "tested on", "none"]
"""of a seed: a number of the method was chosen on it; none was; nothing is random"""


@dataclass(frozen=True)
class Table:
    """Results that one command makes and one table shows."""

    run: str
    """folder of the run"""
    results: str
    """pattern of their files, a file a seed: the end of their paths"""
    made_by: tuple[str, ...]
    """functions and classes that make them, see `provenance`"""
    chosen_on: str = ""
    """seeds on which a number was chosen: `0:18,19`; `:` are all"""
    seeded: bool = True
    """whether the number in a file's name is a seed"""
    again: str = ""
    """arguments of `run.py` that make one of them anew: `{0}`, `{1}`, ... are what the stars of
    `results` stand for, `{seed}` is the number that ends a file's name; empty where none can be
    compared, for times are measured or data are needed that are not here"""

    @property
    def title(self) -> str:
        """The run and its results."""
        return f"{self.run}: {self.results}"

    @cached_property
    def code(self) -> Code:
        """All code that makes them."""
        return Code(RUNS / self.run, self.made_by)

    def paths(self) -> list[Path]:
        """The results that are there."""
        suffix = Path(self.results).suffix
        return sorted(p for p in (RUNS / self.run).rglob(f"*{suffix}") if self.holds(p))

    def holds(self, path: Path) -> bool:
        """Whether a file is one of these, or stands beside one; in this folder or in another."""
        return path.with_suffix(Path(self.results).suffix).match(self.results)

    def command(self, path: Path) -> list[str]:
        """The arguments that make this result anew; empty where none do."""
        pattern = re.escape(self.results).replace(r"\*", "([^/]*)").replace(r"\?", "([^/])")
        stars = re.search(f"{pattern}$", path.as_posix())
        seed = re.search(r"(\d+)$", path.stem)
        fields = {"seed": int(seed[1])} if seed else {}
        return [word.format(*stars.groups(), **fields) for word in shlex.split(self.again)]

    def role(self, path: Path) -> Role:
        """The role of a result's seed."""
        number = re.search(r"(\d+)$", path.stem) if self.seeded else None
        if number is None:
            return "none"
        return "chosen on" if _within(int(number[1]), self.chosen_on) else "tested on"


def _within(seed: int, text: str) -> bool:
    """Whether `0:18,19` holds a seed."""
    for part in filter(None, text.split(",")):
        first, colon, end = part.partition(":")
        if int(first or 0) <= seed < (int(end or 2**32) if colon else int(first) + 1):
            return True
    return False


AGENT = ("mcpilco.sweep:run_seed", "mcpilco.agent:MCPILCO")
PILCO = ("mcpilco.sweep:run_seed", "baselines.pilco.agent:PILCO")
CROSS = "mcpilco.cli.cross"
SAC = "baselines.sb3.agent:SACAgent"
CART_POLE, MUJOCO = "envs.cartpole:CartPoleSwingUpEnv", "envs.mujoco_cartpole"
PENDULUM, PENDUBOT = "envs.pendulum:PendulumEnv", "envs.double_pendulum:PendubotEnv"
LOOKED_AT = (
    "0:100,1000:1053,20000:20231,20400:20440,21000:21100,22000:22100,23000:23100,24000:24100,"
    "25000:25100,26000:26100"
)
"""seeds of the cart-pole by whose failures the preset `default` was changed"""
SEED = "--seeds {seed}"
ARM = "--seeds 0"
"""all robots of `kinematics`, and one arm"""


def _by_amounts(system: str, env: str, name: str) -> Table:
    agent = f"baselines.sb3.agent:{name.upper()}Agent"
    made_by = ("seed_curve:CurveJob", agent, env, f"baselines/sb3/presets/{name}.yml")
    return _compared(system, name, made_by, "100:")


def _compared(system: str, row: str, made_by: tuple[str, ...], chosen_on: str = "") -> Table:
    again = f"--env {system} --rows {row} --seeds {{seed}}"
    files = f"{system}/{row}/seeds/*.json"
    return Table("cartpole_comparison", files, made_by, chosen_on, again=again)


def _trained(
    run: str, row: str, again: str, made_by: tuple[str, ...], chosen_on: str = ""
) -> Table:
    return Table(run, f"results/{row}/seeds/*.json", made_by, chosen_on, again=again)


def _preset(name: str, chosen_on: str) -> Table:
    again = f"--presets {name} {SEED}"
    return _trained("cartpole_swingup", name, again, (*AGENT, CART_POLE), chosen_on)


def _gip(name: str, experiment: str) -> Table:
    again = f"--only {name} --trials 1"
    return Table("gip", f"results/{name}/*.json", (f"experiments:{experiment}",), again=again)


TABLES = (
    _trained(
        "ablations",
        "*/*",
        f"--bases {{0}} --rows {{1}} {SEED}",
        ("run:settings_of", *AGENT, CART_POLE),
    ),
    _compared("cartpole", "mcpilco", (*AGENT, CART_POLE), LOOKED_AT),
    _compared("cartpole", "pilco", (*PILCO, CART_POLE)),
    _compared("cartpole", "pilco-restarts", (*PILCO, CART_POLE)),
    _compared("cartpole", "pilco-tip", (*PILCO, CART_POLE)),
    _compared("mujoco", "mcpilco", (*AGENT, MUJOCO), LOOKED_AT),
    _compared("mujoco", "pilco", (*PILCO, MUJOCO)),
    _compared("mujoco", "pilco-restarts", (*PILCO, MUJOCO)),
    _compared("mujoco", "pilco-tip", (*PILCO, MUJOCO)),
    *(_by_amounts("cartpole", CART_POLE, name) for name in ("sac", "tqc", "ppo")),
    *(_by_amounts("mujoco", MUJOCO, name) for name in ("sac", "tqc", "ppo")),
    _preset("default", LOOKED_AT),
    _preset("thesis", "0:18"),
    _preset("tro2022", "0:18"),
    Table("collision", "results/p*d/*.json", ("run:trial", "run:CONTROLLERS"), again=SEED),
    Table("cost_growth", "results.json", ("run:timed",)),
    *(
        Table(
            "crossing_the_gap",
            f"results/seeds/{files}.json",
            ("run:LEARN", "run:begun", *AGENT, SAC, CART_POLE),
            "0:20",
            again=f"--legs {legs} {SEED}",
        )
        for files, legs in {"02*": "a b c d", "01*": "f g"}.items()
    ),
    Table("exported_policy", "results.json", ("run:measured", *AGENT, CART_POLE)),
    _gip("scara", "accuracy"),
    _gip("ur10", "six_joints"),
    _gip("efficiency", "efficiency"),
    _gip("ur10-efficiency", "six_joint_efficiency"),
    _gip("unexplained", "unexplained"),
    Table("gip", "results/recorded/*.json", ("experiments:recorded",), seeded=False),
    *(
        Table(
            "hidden_effects",
            f"results/{tier}/*.json",
            ("run:solve",),
            chosen_on,
            again=f"--tiers {tier} --no-peers {SEED}",
        )
        for tier, chosen_on in {
            "one": "0:1280,1708",
            "weak": "0:1280,1287,1708,4029",
            "two": "0:1280",
            "three": "0:1280",
            "none": "0:1280",
            "outside": "0:1280,1281,1326,1330,1332,1334,1850",
            "further": "0:1280",
            "rough": "0:1280,1422:1427,1582,1617,1619,1636,4154,4215,4222",
            "laboratory-one": "0:1280",
            "laboratory-none": "0:1280",
            "sparse-one": "4300:4312",
            "sparse-none": "4300:4306",
        }.items()
    ),
    *(
        Table("kinematics", f"results/{cell}/*.json", ("run:structure",), chosen_on, again=ARM)
        for cell, chosen_on in {
            "noise-free": "",
            "noise": "",
            "outliers": "",
            "outliers-0.3": ":",
        }.items()
    ),
    Table("kinematics", "results/?00-*/*.json", ("run:forward",), again=ARM),
    Table("kinematics", "results/controller/*.json", ("run:control",), again=ARM),
    Table("kinematics", "results/covering/*.json", ("run:covering",), again=ARM),
    *(
        Table(
            "limits",
            f"results/{row}/*.json",
            ("run:trained", *AGENT, CART_POLE),
            "0:3,20:30",
            again=again,
        )
        for row, again in {"limited": SEED, "free": f"--free {SEED}"}.items()
    ),
    Table("many_samples", "results/cost/*.json", ("run:cost", *AGENT, CART_POLE), seeded=False),
    *(
        Table(
            "many_samples",
            f"results/{row}/*.json",
            (f"run:{made_by}", *AGENT, CART_POLE),
            again=again,
        )
        for row, made_by, again in (
            ("success", "trained", SEED),
            ("beside", "beside", "--beside {seed}"),
        )
    ),
    *(
        Table(
            "model_components",
            f"{system}/*/seeds/*.json",
            ("run:run", *AGENT, env),
            "0:4400",
            again=f"--systems {system} --cells {{0}} {SEED}",
        )
        for system, env in {"analytic": CART_POLE, "mujoco": MUJOCO}.items()
    ),
    Table(
        "identified_prior",
        "results/*/*.json",
        ("run:learned", *AGENT, PENDUBOT),
        again=f"--priors {{0}} {SEED}",
    ),
    *(
        Table(
            "model_learning",
            f"results/{system}/*.csv",
            ("run:Bench", env),
            again=f"--systems {system} {SEED}",
        )
        for system, env in {"cartpole": CART_POLE, "mujoco": MUJOCO}.items()
    ),
    _trained(
        "missing_forces",
        "*/*",
        f"--systems {{0}} --models {{1}} {SEED}",
        ("run:run", *AGENT, CART_POLE),
    ),
    Table(
        "mujoco_plants",
        "results/models/*.json",
        ("run:looked_at",),
        seeded=False,
        again="models",
    ),
    Table("mujoco_plants", "results/speed/*.json", ("run:throughput",), seeded=False),
    Table(
        "mujoco_plants",
        "results/study/*.json",
        ("study:tried",),
        "0:100,1000:1489,5000:5048",
        again=f"study {SEED}",
    ),
    Table(
        "mujoco_plants",
        "results/sysid/*.json",
        ("beside_sysid:fitted",),
        ":100",
        again=f"sysid {SEED}",
    ),
    _trained("mujoco_swingup", "default", SEED, (*AGENT, MUJOCO), LOOKED_AT),
    _trained("other_envs", "*", f"--only {{0}} {SEED}", ("run:CASES", *AGENT), "0:2"),
    _trained(
        "partial_state",
        "*",
        f"--settings {{0}} {SEED}",
        ("run:SETTINGS", *AGENT, CART_POLE),
        "500:506",
    ),
    *(
        Table(
            "pendubot_swingup",
            f"results/*-{variant.replace(' ', '-')}-*.json",
            ("run:learned", *AGENT, PENDUBOT),
            "0:1,1000:1010,2000:2003",
            again=f"--robots {{0}} --variants '{variant}' {SEED}",
        )
        for variant in ("full", "without equations", "without regulator")
    ),
    _trained("pendulum_swingup", "default", SEED, (*AGENT, PENDULUM)),
    Table(
        "real_machines",
        "results/*/*.json",
        ("run:solve",),
        seeded=False,
        again="--machines {0}",
    ),
    Table(
        "real_machines",
        "stability/*.json",
        ("run:repeat",),
        seeded=False,
        again="--stability --machines {0}",
    ),
    Table(
        "realaigym",
        "results/*.json",
        (
            "run:learned",
            "run:judged",
            "polish:polished",
            "board:made",
            "fast:rhs",
            *AGENT,
            PENDUBOT,
        ),
        "0:3",
        again="--only {0}",
    ),
    Table("rig", "results/timing-*.json", ("measure:timing", *AGENT, CART_POLE), seeded=False),
    Table("rig", "results/faults.json", ("measure:faults", *AGENT, CART_POLE)),
    Table("rig", "results/fuzz.json", ("measure:fuzz",)),
    Table(
        "rig",
        "results/crossings/*.json",
        ("crossings:crossed", "rig:Rig", *AGENT, CROSS, CART_POLE),
    ),
    Table("speed", "results.json", ("measures:ratio", "measures:memory", "parts:shares")),
    Table("ting_robots", "results/*/*.json", ("run:trial",), again=SEED),
    Table("ting_synthetic", "results/*/*.json", ("run:trial",), again=SEED),
    Table("touched_arm", "results/*.json", ("run:investigated",), ":1000", again=SEED),
    Table("volterra", "results/*/*.json", ("run:trial",), again="--cells {0} --seeds 1"),
    Table(
        "warm_start",
        "results/*-*.json",
        ("run:measured", *AGENT, SAC, CART_POLE),
        again="--rows {0} --seeds {1}",
    ),
)


def named(tables: Sequence[Table], runs: Sequence[str]) -> list[Table]:
    """The tables of some runs; of all where none is named.

    Raises:
        SystemExit: a run has no table.
    """
    if unknown := set(runs) - {table.run for table in tables}:
        raise SystemExit(f"--runs must name folders of runs/ with tables, got {sorted(unknown)}.")
    return [table for table in tables if not runs or table.run in runs]


def table_of(run: str, path: Path) -> Table:
    """The table to which a file of results belongs.

    Raises:
        LookupError: there is none.
    """
    for table in TABLES:
        if table.run == run and table.holds(path):
            return table
    raise LookupError(
        f"No table of {run} has results such as {path}; add it to runs/all_tables.py."
    )
