"""A folder that somebody sent executes nothing, whatever it names and whatever reads it."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import mcpilco.cli.cross
import mcpilco.cli.train
import mcpilco.sweep.job
from mcpilco.cli import COMMANDS, main
from mcpilco.cli.collisions import Collisions
from mcpilco.config import CART_POLE, PRESETS
from mcpilco.files import read_groups, write_groups
from mcpilco.logbook import read_json
from mcpilco.typing import InputError
from tests.newcomer import SMALL

ROLLOUT, MODEL = "run/trials/01/rollout.npz", "run/model.xml"
READERS: dict[str, tuple[list[str], ...]] = {
    "Train": (
        ["train", "--resume", "run", "--trials", "2", "--quiet"],
        ["train", "--algo", "sac", "--warm-start", "run", "--horizon", "8", "--out", "warm"],
        ["train", "--model", "physics+rbf", "--prior", "run/corrected.json", "--out", "prior"],
        ["train", "--env-kwargs", "effects=run/corrected.json", "--out", "effects"],
    ),
    "Evaluate": (["evaluate", "run", "--episodes", "1"],),
    "Export": (["export", "run", "policy.npz"],),
    "Sweep": (["sweep", "--out", "sweep", "--seeds", "0:1", "--trials", "2", "--quiet"],),
    "Compare": (["compare", "run", "sweep", "--out", "tables"],),
    "Record": (
        ["record", "--policy", "run", "--out", "logs", "--seconds", "2", "--rollouts", "1"],
    ),
    "Gap": (
        ["gap", ROLLOUT, "--out", "found"],
        ["gap", ROLLOUT, "--plant", MODEL, "--out", "found"],
    ),
    "Cross": (
        ["cross", "--out", "cross", "--trials", "1", "--episodes", "1", "--quiet"],
        ["cross", "--out", "run", "--quiet"],
    ),
    "Identify": (["identify", ROLLOUT, "--model", MODEL, "--out", "robot"],),
    "InverseDynamics": (["inverse-dynamics", ROLLOUT, "--model", MODEL, "--out", "torques"],),
    "Kinematics": (["kinematics", ROLLOUT, "--out", "chain"],),
    "Learn": (["collisions", "learn", ROLLOUT, "--robot", MODEL, "--out", "current.npz"],),
    "Threshold": (["collisions", "threshold", "run/agent.npz", ROLLOUT],),
    "Detect": (["collisions", "detect", "run/agent.npz", ROLLOUT, "--out", "alarms"],),
    "Volterra": (["volterra", ROLLOUT, "--inputs", "u", "--outputs", "y", "--out", "series"],),
    "View": (
        ["view", "run", "--screenshot", "picture.png"],
        ["view", "run", "other", "--screenshot", "picture.png"],
    ),
    "Report": (["report", "run"],),
}
"""calls of each command that reads a folder or file of somebody else's"""
READ_NOTHING = {
    "CheckEnv": "an env, and the task that its user wrote",
    "Demo": "nothing",
    "Doctor": "this machine",
    "Simulate": "nothing",
}


def test_every_command_is_tried() -> None:
    """A new command stands in one of the tables."""
    parts = get_args(get_type_hints(Collisions)["command"])
    known = {kind.__name__ for kind in (*COMMANDS, *parts) if kind is not Collisions}
    assert known == {*READERS, *READ_NOTHING}


# What is sent -------------------------------------------------------------------------------------


class Bomb:
    """Leaves the mark where it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("executed",)


Change = Callable[[Path], object]
CODE = "import pathlib\nfor k in range(9):\n    pathlib.Path('executed').mkdir(exist_ok=True)\n"
NAMES = (
    "evilm:X-v0",
    "run.evilm:X-v0",
    "run.inner.evilm:X-v0",
    "evilm:evilm:X-v0",
    "..evilm:X-v0",
    "run/evilm.py:X-v0",
    "evilm.py:X-v0",
    f"evilm:{CART_POLE}",
    "evilm:",
)
OWN_EFFECT = {"name": "evil", "target": "cart", "parameters": {}, "file": "run/evilm.py"}
CORRECTION = {"format": 1, "plant": CART_POLE, "parameters": {}, "effects": []}
PLUGIN = "<mujoco><extension><plugin plugin='evilm'/></extension></mujoco>"


def in_json(*names: str, **entries: Any) -> Change:
    """Changes entries of JSON files; a dict is merged."""

    def change(sent: Path) -> None:
        for name in names:
            content = read_json(sent / name)
            for key, value in entries.items():
                merged = isinstance(value, dict) and isinstance(content.get(key), dict)
                content[key] = {**content[key], **value} if merged else value
            (sent / name).write_text(json.dumps(content))

    return change


def config(**entries: Any) -> Change:
    """The configuration in a run, a sweep and the trainings of a crossing."""
    heads = ("run/config.json", "sweep/sweep.json", "cross/nominal/config.json")
    return in_json(*heads, **entries)


def agent(**entries: Any) -> Change:
    """The description in the file of an agent."""

    def change(sent: Path) -> None:
        about, groups = read_groups(sent / "run/agent.npz")
        write_groups(sent / "run/agent.npz", {**about, **entries}, groups)

    return change


def pickled(name: str, raw: bool = False) -> Change:
    """A file that executes where it is unpickled, as numpy and torch would."""

    def change(sent: Path) -> None:
        with (sent / name).open("wb") as file:
            if raw:
                pickle.dump(Bomb(), file)
            else:
                np.savez(file, about=np.array([Bomb()], dtype=object), allow_pickle=True)

    return change


def text(name: str, content: str) -> Change:
    return lambda sent: (sent / name).write_text(content)


def link(name: str, target: str) -> Change:
    """A link that leads out of the folder."""

    def change(sent: Path) -> None:
        path = sent / name
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        path.symlink_to(sent.parent / target)

    return change


HOSTILE: dict[str, Change] = {
    **{f"env {name}": config(env=name) for name in NAMES},
    **{f"algorithm {name}": config(algo=name) for name in (*NAMES, "evil")},
    "algorithm of a crossing": in_json("cross/cross.json", algo="evilm:x", env="evilm:X-v0"),
    "no name": config(env=["evilm"], algo={"evilm": 1}),
    "machine": config(
        env="mcpilco/Machine-v0",
        env_kwargs={"simulation": CART_POLE, "address": "udp://127.0.0.1:9", "machine": "evil"},
    ),
    "machine of evil": config(env="mcpilco/Machine-v0", env_kwargs={"simulation": "evilm:X-v0"}),
    "preset": config(preset="evilm:preset"),
    "task": config(task="run/evilm.py"),
    "task above": config(task="../sent/run/evilm.py"),
    "warm start": config(warm_start="run/../run"),
    "callback": config(callback="evilm:callback", callbacks=["evilm:callback"]),
    "effects file": config(env_kwargs={"effects": "run/corrected.json"}),
    "effect": config(env_kwargs={"effects": {**CORRECTION, "effects": [OWN_EFFECT]}}),
    "cost of an env": config(env_kwargs={"cost": "evilm:cost"}),
    "entry point": config(env_kwargs={"entry_point": "evilm:X"}),
    "wrappers": config(env_kwargs={"additional_wrappers": ["evilm:X"], "autoreset": "evilm:X"}),
    "kernel": config(config={"model": {"kernel": "evilm:Kernel"}}),
    "prior": config(config={"model": {"name": "physics+rbf", "prior": "run/corrected.json"}}),
    "policy": config(config={"policy": "evilm:Policy"}),
    "engine": config(config={"engine": "evilm:Engine", "search": {"engine": "evilm"}}),
    "cost": in_json("run/task.json", cost="evilm:cost"),
    "agent's algorithm": agent(algo="evilm:mcpilco"),
    "agent's kernel": agent(kernel="evilm:Kernel"),
    "agent's cost": agent(cost="evilm:cost"),
    "agent's config": agent(config={"model": {"kernel": "evilm:Kernel"}}),
    "agent's task": agent(task={"cost": "evilm:cost"}),
    "correction": text("run/corrected.json", json.dumps({**CORRECTION, "effects": [OWN_EFFECT]})),
    "plant": text("run/corrected.json", json.dumps({**CORRECTION, "plant": "evilm:X-v0"})),
    "model": text("run/model.xml", PLUGIN),
    "pickled agent": pickled("run/agent.npz"),
    "agent that is a pickle": pickled("run/agent.npz", raw=True),
    "pickled policy": pickled("run/trials/01/policy.npz"),
    "pickled rollout": pickled("run/trials/01/rollout.npz"),
    "pickled particles": pickled("run/trials/01/particles.npz"),
    "pickled model": pickled("run/trials/01/gp.npz"),
    "env of a wrapper": config(env="GymV26Environment-v0", env_kwargs={"env_id": NAMES[0]}),
    "name within keywords": config(env_kwargs={"inner": [{"of": {"env": NAMES[1]}}]}),
    "model of an env": config(
        env="mcpilco/MujocoCartPoleSwingUp-v0", env_kwargs={"model": "run/model.xml"}
    ),
    "code as a model": config(
        env="mcpilco/MujocoCartPoleSwingUp-v0", env_kwargs={"model": "run/evilm.py"}
    ),
    "spread of a file": config(spread="run/evilm.py", env_kwargs={"spread": "run/evilm.py"}),
    "trust": config(env=NAMES[0], trust=["evilm"], env_kwargs={"trust": "evilm"}),
    "absurd horizon": config(horizon=10**8, config={"horizon": 10**8}),
    "no number": config(seed=math.nan, trials=math.inf, horizon=-1),
    "deep": text("run/config.json", "[" * 100_000),
    "long number": text("run/config.json", '{"format": ' + "9" * 5_000 + "}"),
    "bytes": lambda sent: (sent / "run/config.json").write_bytes(b"\xff\xfe\0" * 99),
    "names that lead elsewhere": in_json("run/task.json", state_names=["../../mine/text"] * 4),
    "names with escapes": in_json("run/task.json", state_names=["\x1b]0;evilm\a\n<script>"] * 4),
    "states of another kind": in_json("run/task.json", state_names={"a": 1}, angles=[10**9]),
    "agent of another size": agent(task={"state_names": ["x"] * 10_000}),
    "trial of another number": link("run/trials/../trials/99", "mine"),
    "formulas in metrics": text("run/metrics.csv", "trial,=cmd|'evilm'!A1\n1,@evilm\n"),
    "folder for a file": lambda sent: (
        (sent / "run/summary.json").unlink(),
        (sent / "run/summary.json").mkdir(),
    ),
    "linked agent": link("run/agent.npz", "mine/agent.npz"),
    "linked trial": link("run/trials/01", "mine"),
    "linked metrics": link("run/metrics.csv", "mine/text"),
    "linked report": link("run/report.html", "mine/text"),
    "linked steps": link("run/policy_steps.jsonl", "mine/text"),
    "linked summary": link("run/summary.json", "mine/text"),
    "linked result of a sweep": link("sweep/seeds/0000.txt", "mine/text"),
    "linked crossing": link("cross/nominal.json", "mine/text"),
    "reason of a failure": text("sweep/seeds/evilm.txt", "evilm"),
}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sound folders, before they are made hostile: runs, a sweep, a crossing; and one's own file.

    Modules and their metadata lie beside the run, in it, and below it.
    """
    path = tmp_path_factory.mktemp("world")
    sent, mine = path / "sent", path / "mine"
    numbers = dataclasses.replace(PRESETS["default"], config=SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "default", numbers)
        argv = ["train", "--trials", "1", "--horizon", "8", "--quiet", "--out"]
        assert main([*argv, str(sent / "run")]) == 0
    (sent / "run/model.xml").write_text("<mujoco/>")
    (sent / "run/corrected.json").write_text(json.dumps(CORRECTION))
    for folder in ("run/inner", "sweep/seeds", "cross/gap", "cross/recordings"):
        (sent / folder).mkdir(parents=True)
    about = {"seed": 0, "trials": [], "format": 1, "machine": {"cpu": "Zen"}}
    (sent / "sweep/seeds/0000.json").write_text(json.dumps(about))
    settings = mcpilco.sweep.job.Settings(f"envs:{CART_POLE}", trials=2)
    (sent / "sweep/sweep.json").write_text(json.dumps({"format": 1, **settings.to_json()}))
    typed = mcpilco.cli.cross.Cross(out=Path("cross"), trials=1, episodes=1)._typed()
    (sent / "cross/cross.json").write_text(json.dumps(typed))
    for k in range(6):
        (sent / f"cross/recordings/excitation-seed{k}-00.csv").touch()
    (sent / "cross/gap/gap.json").write_text(json.dumps({"verdict": "named", "effects": []}))
    (sent / "cross/gap/corrected.json").write_text(json.dumps(CORRECTION))
    shutil.copytree(sent / "run", sent / "other")
    shutil.copytree(sent / "run", mine)
    for leg in ("nominal", "corrected"):
        shutil.copytree(sent / "run", sent / "cross" / leg)
        (sent / "cross" / leg / "summary.json").unlink()
    (mine / "text").write_text("mine")
    for folder in (sent, sent / "run", sent / "run/inner", sent / "cross"):
        (folder / "evilm.py").write_text(CODE)
        entries = folder / "evil-1.0.dist-info"
        entries.mkdir()
        (entries / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
        (entries / "entry_points.txt").write_text("[mcpilco.algorithms]\nevil = evilm:X\n")
    return path


@pytest.fixture
def sent(world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, in which the user works; nothing is drawn, and no long training begins."""

    def stop(*_: Any, **__: Any) -> None:
        raise InputError("enough")

    shutil.copytree(world, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path / "sent")
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "evilm", raising=False)
    monkeypatch.setattr("mcpilco.show.screenshot", lambda *_: "picture.png")
    monkeypatch.setattr("mcpilco.show.write_run_film", lambda *_: 1.0)
    monkeypatch.setattr("mcpilco.show.report.page.page_of", stop)
    monkeypatch.setattr("mcpilco.show.write_comparison", stop)
    monkeypatch.setattr("mcpilco.cli.cross.Cross._draw", stop)
    for name in ("sweep.sweep", "agent.begin_run", "agent.learn_rest", "gap.investigate"):
        monkeypatch.setattr(f"mcpilco.{name}", stop)
    for name in ("begin_run", "learn_rest", "investigate", "record_rollouts", "cross"):
        monkeypatch.setattr(f"mcpilco.crossing.workflow.{name}", stop)
    return tmp_path / "sent"


OFTEN = ("Train", "Evaluate", "Export", "Compare", "Record", "Cross", "View", "Report")
"""commands that read a run folder; half of them are given each form in seconds, all in minutes"""
OF_FILES = ("pickled rollout", "agent that is a pickle", "model", "correction")
"""forms of files that other commands read too"""
ALL = [argv for calls in READERS.values() for argv in calls]


FEWER = [form for form in HOSTILE if form not in {f"algorithm {name}" for name in NAMES[2:]}]


@pytest.mark.one_in(6)
@pytest.mark.parametrize("form", FEWER)
def test_nothing_that_is_sent_is_executed(
    sent: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    """Each command succeeds or ends with one sentence, and what is not in the folder stays."""
    HOSTILE[form](sent)
    half = OFTEN[FEWER.index(form) % 2 :: 2]
    require_harmless(sent, capsys, ALL if form in OF_FILES else [READERS[k][0] for k in half])


@pytest.mark.slow
@pytest.mark.parametrize("form", HOSTILE)
def test_no_command_executes_what_is_sent(
    sent: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    HOSTILE[form](sent)
    require_harmless(sent, capsys, ALL)


def require_harmless(
    sent: Path, capsys: pytest.CaptureFixture[str], calls: Sequence[list[str]]
) -> None:
    for argv in calls:
        code, said = main(argv), capsys.readouterr().err
        assert not (sent / "executed").exists(), argv
        assert "evilm" not in sys.modules, argv
        assert (sent.parent / "mine/text").read_text() == "mine", argv
        assert code in (0, 1, 2), argv
        assert "Traceback" not in said, argv
        assert said.count("mcpilco: error: ") == (code == 2), (argv, said)


@pytest.mark.parametrize("command", ["train --resume", "evaluate", "record --out logs --policy"])
def test_a_machine_is_met_only_where_its_address_is_typed(
    sent: Path, capsys: pytest.CaptureFixture[str], monkeypatch, command: str
) -> None:
    def opened(*_: Any) -> None:
        raise AssertionError("a file has opened a machine")

    monkeypatch.setattr("mcpilco.machine.env.Meeting.open", opened)
    address = {"machine": "udp://127.0.0.1:9", "address": "udp://127.0.0.1:9"}
    config(env="mcpilco/Machine-v0", env_kwargs={"simulation": CART_POLE}, **address)(sent)
    assert main([*command.split(), "run"]) == 2
    assert "met only at an address that you type" in capsys.readouterr().err


def test_a_module_that_the_user_trusts_is_imported(sent: Path) -> None:
    """So the module would have been found, and its import would have left the mark."""
    config(env=NAMES[0])(sent)
    try:
        assert main(["evaluate", "run", "--trust", "evilm"]) == 2
        assert (sent / "executed").exists()
    finally:
        sys.modules.pop("evilm", None)


def test_settings_of_libraries_in_the_folder_load_no_code(sent: Path) -> None:
    """numba and matplotlib read settings where the user is; those that name code do not count."""
    (sent / ".numba_config.yaml").write_text("cache_dir: cache\ncache_locator_classes: evilm.X\n")
    (sent / "matplotlibrc").write_text("backend: module://evilm\n")
    code = (
        "from mcpilco.cli import main\nmain(['--help'])\nimport matplotlib, numba\n"
        "c = numba.config\nprint([c.CACHE_DIR, c.CACHE_LOCATOR_CLASSES, matplotlib.get_backend()])"
    )
    root = str(Path(__file__).parents[3])
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_CACHE", "MPLBACK"))}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**clean, "PYTHONPATH": root},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "['', '', 'agg']"
