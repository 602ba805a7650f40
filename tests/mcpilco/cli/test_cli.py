from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import mcpilco.agent.agent
import mcpilco.machine.env
from mcpilco.agent import algorithm_of, algorithms, find, with_package
from mcpilco.cli import main
from mcpilco.config import CART_POLE, PRESETS
from mcpilco.logbook import RunFolder
from mcpilco.sweep import job
from mcpilco.typing import EnvError, RunFolderError
from tests.mcpilco.fakes import FakeAgent

STRANGE_ENVS = """
import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box, Discrete
from mcpilco.policies.costs import QuadraticCost
from mcpilco.task import TaskSpec


class Point(gym.Env):
    observation_space = Box(-9, 9, (1,), np.float64)
    action_space = Box(-1, 1, (1,), np.float32)
    cost = QuadraticCost((0.0,), (1.0,), (0.0,))
    task = TaskSpec(("x",), ("m",), ("u",), ("N",), 0.1, (), (), (0.0,), (0.1,), cost)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1), {}

    def step(self, action):
        return np.zeros(1), 0.0, False, False, {}


class Nan(Point):
    def step(self, action):
        return np.full(1, np.nan), 0.0, False, False, {}


class Keys(Point):
    action_space = Discrete(3)


class Unknown(Point):
    task = None


class Interrupt(Point):
    steps = 0

    def step(self, action):
        self.steps += 1
        if self.steps > 12:
            raise KeyboardInterrupt
        return super().step(action)


for kind in (Point, Nan, Keys, Unknown, Interrupt):
    gym.register(f"Strange/{kind.__name__}-v0", kind, max_episode_steps=5)
gym.register("Strange/Endless-v0", Point)
"""

RUN = ["--trials", "2", "--horizon", "5", "--quiet"]


@pytest.fixture
def fake(monkeypatch):
    """The agent that learns nothing, in place of MCPILCO."""
    monkeypatch.setattr(mcpilco.agent.agent, "MCPILCO", FakeAgent)


@pytest.fixture
def strange(tmp_path, monkeypatch):
    """A module of envs in the present folder."""
    (tmp_path / "strange.py").write_text(STRANGE_ENVS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "strange", raising=False)
    monkeypatch.setattr("gymnasium.envs.registration.registry", dict(gym.registry))
    return tmp_path


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """The run of an agent that learns nothing."""
    path = tmp_path_factory.mktemp("once") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcpilco.agent.agent, "MCPILCO", FakeAgent)
        assert main(["train", *RUN, "--out", str(path)]) == 0
    return path


@pytest.fixture
def trained(once, tmp_path, fake):
    """A copy of it, to be damaged and continued."""
    return Path(shutil.copytree(once, tmp_path / "run"))


def refused(capsys, *argv: str) -> str:
    """The sentence that a command line is refused with."""
    assert main(list(argv)) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    sentences = [line for line in lines if line.startswith("mcpilco: error: ")]
    assert sentences == lines[-1:]
    assert not any("Traceback" in line for line in lines)
    return sentences[0].removeprefix("mcpilco: error: ")


# train --------------------------------------------------------------------------------------------


def test_train_ends_with_the_run_folder_and_the_next_commands(tmp_path, fake, capsys):
    path = tmp_path / "my run"
    assert main(["train", *RUN, "--out", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-4:] == [
        f"Run folder: {path}",
        f"Look at it: mcpilco view '{path}'",
        f"Report it:  mcpilco report '{path}'",
        f"Judge it:   mcpilco evaluate '{path}'",
    ]
    assert RunFolder.open(path).finished_trials() == [1, 2]


def test_train_shows_a_line_a_trial_unless_quiet(tmp_path, fake, capsys):
    assert main(["train", *RUN[:-1], "--out", str(tmp_path / "loud")]) == 0
    assert capsys.readouterr().out.count("predicted cost") == 2
    assert main(["train", *RUN, "--out", str(tmp_path / "quiet")]) == 0
    assert "predicted cost" not in capsys.readouterr().out


def test_config_holds_what_a_second_run_needs(trained):
    config = RunFolder.open(trained).config
    assert config["env"] == CART_POLE
    assert config["env_kwargs"] == {"max_episode_steps": 5}
    assert (config["preset"], config["seed"], config["trials"]) == ("default", 0, 2)
    assert config["config"]["horizon"] == 5


def test_policy_steps_are_recorded(trained):
    lines = RunFolder.open(trained).policy_steps_path.read_text().splitlines()
    assert sum("policy/cost" in json.loads(line) for line in lines) == 6


def test_tensorboard_events_lie_in_the_run_folder(tmp_path, fake):
    pytest.importorskip("tensorboard")
    path = tmp_path / "run"
    assert main(["train", *RUN, "--tensorboard", "--out", str(path)]) == 0
    assert any((path / "tensorboard").iterdir())


def test_default_folder_names_env_preset_and_seed(tmp_path, fake, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *RUN, "--seed", "7"]) == 0
    (path,) = (tmp_path / "runs" / "out").iterdir()
    assert path.name.startswith("CartPoleSwingUp-v0-default-seed7-")


def test_equal_seeds_give_equal_metrics(tmp_path, fake):
    texts = []
    for name in "ab":
        assert main(["train", *RUN, "--seed", "3", "--out", str(tmp_path / name)]) == 0
        texts.append((tmp_path / name / "metrics.csv").read_text())
    assert texts[0] == texts[1]


def test_presets_of_the_command_line_are_those_of_the_algorithm(tmp_path, capsys):
    run = ["train", *RUN, "--preset", "nonsense", "--out", str(tmp_path / "run")]
    for name in ("mcpilco", "pilco"):
        assert main([*run, "--algo", name]) == 2
        assert str(sorted(find(name).presets)) in " ".join(capsys.readouterr().err.split())


ALGORITHM = """
from mcpilco.agent import algorithm_of, algorithms, find, with_package
from tests.mcpilco.fakes import FakeAgent


class Careful(FakeAgent):
    algo = "careful"


algorithms.register("careful", f"{__name__}:Careful")
"""


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """A package that registers an algorithm of its own, where the user is."""
    monkeypatch.setattr(algorithms, "_HOMES", dict(algorithms._HOMES))
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "careful_package", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "careful_package.py").write_text(ALGORITHM)
    return tmp_path


def test_an_algorithm_of_another_package_is_chosen_by_package_and_name(stranger):
    assert main(["train", *RUN, "--algo", "nowhere:careful", "--out", "none"]) == 2
    name = "careful_package:careful"
    assert main(["train", *RUN, "--algo", name, "--out", "run"]) == 0
    run = RunFolder.open(stranger / "run")
    assert run.config["algo"] == name
    assert run.finished_trials() == [1, 2]
    assert algorithm_of(run).algo == "careful"
    assert main(["evaluate", "run", "--episodes", "2"]) == 0
    assert with_package("careful_package:careful") == "careful_package:careful"
    assert [with_package(name) for name in ("mcpilco", "sac")] == ["mcpilco", "baselines:sac"]


def test_a_run_of_an_algorithm_in_its_own_folder_is_not_executed(stranger):
    config = {"env": CART_POLE, "env_kwargs": {}, "preset": "default", "seed": 0, "trials": 1}
    config |= {"config": {}, "algo": "run.careful_package:careful"}
    run = RunFolder.create(stranger / "run", config)
    (stranger / "run" / "careful_package.py").write_text("raise SystemExit('executed')")
    with pytest.raises(RunFolderError, match="cannot be used: .* got 'careful'.* `--trust"):
        algorithm_of(run)
    assert "run.careful_package" not in sys.modules


def test_an_algorithm_of_an_installed_package_is_chosen_by_its_entry_point(stranger):
    about = stranger / "careful_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: careful-package\nVersion: 1.0\n")
    entry = "[mcpilco.algorithms]\nprudent = careful_package:Careful\n"
    (about / "entry_points.txt").write_text(entry)
    sys.path.insert(0, str(stranger))
    assert "prudent" in algorithms.names()
    assert find("prudent").algo == "careful"


def test_preset_sets_the_cart_pole_and_no_other_env(tmp_path, fake, strange):
    preset = ["--preset", "tro2022", "--trials", "1", "--quiet"]
    assert main(["train", *preset, "--out", str(tmp_path / "a")]) == 0
    kwargs = RunFolder.open(tmp_path / "a").config["env_kwargs"]
    assert kwargs["dt"] == PRESETS["tro2022"].env_kwargs["dt"]
    other = ["--env", "strange:Strange/Point-v0", "--out", str(tmp_path / "b")]
    assert main(["train", *preset, *other]) == 0
    assert RunFolder.open(tmp_path / "b").config["env_kwargs"] == {}


def test_env_module_of_the_present_folder_is_imported(strange, fake):
    assert main(["train", "--env", "strange:Strange/Point-v0", *RUN, "--out", "run"]) == 0
    assert RunFolder.open(strange / "run").finished_trials() == [1, 2]
    assert main(["evaluate", "run", "--episodes", "2"]) == 0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--trials", "0"], "--trials must be at least 1, got 0"),
        (["--trials", "-3"], "--trials must be at least 1, got -3"),
        (["--seed", "-1"], "--seed must not be negative"),
        (["--horizon", "0"], "horizon must be >= 1 step, got 0"),
        (["--horizon", "-5"], "horizon must be >= 1 step, got -5"),
        (["--env", "mcpilco/CartPoleSwingUp-v7"], "provides versioned environments"),
        (["--env", "mcpilco/CartPole-v0"], "doesn't exist"),
        (["--env", "nowhere/Nothing-v0"], "Namespace nowhere not found"),
        (["--env", "no_such_module:Nothing-v0"], "No module named 'no_such_module'"),
        (["--env", "not an id!"], "Malformed environment ID"),
    ],
)
def test_wrong_arguments_are_refused_before_a_folder_is_made(tmp_path, capsys, arguments, sentence):
    assert sentence in refused(capsys, "train", *arguments, "--out", str(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [("Keys", "action space"), ("Unknown", "TaskSpec"), ("Endless", "has no time limit")],
)
def test_envs_that_do_not_fit_are_refused(strange, capsys, kind, sentence):
    env = f"strange:Strange/{kind}-v0"
    assert sentence in refused(capsys, "train", "--env", env, "--out", "run")
    assert not (strange / "run").exists()


def test_nan_from_the_env_is_refused(strange, capsys):
    sentence = refused(capsys, "train", "--env", "strange:Strange/Nan-v0", "--out", "run")
    assert "must return finite numbers" in sentence


def test_folder_that_holds_a_run_is_refused(trained, capsys):
    assert "already holds a run" in refused(capsys, "train", *RUN, "--out", str(trained))


def test_unwritable_folder_is_refused(tmp_path, capsys):
    (tmp_path / "file").touch()
    assert "cannot be written" in refused(
        capsys, "train", *RUN, "--out", str(tmp_path / "file" / "run")
    )


def test_interrupt_says_what_is_saved(strange, fake, capsys):
    argv = ["train", "--env", "strange:Strange/Interrupt-v0", "--out", "run", "--quiet"]
    assert main(argv) == 130
    assert "interrupted; trial 1 is saved in run" in capsys.readouterr().err
    assert RunFolder.open("run").finished_trials() == [1]


@pytest.mark.slow
def test_equal_seeds_of_the_real_agent_give_equal_runs(tmp_path):
    steps = []
    for name in "ab":
        argv = [
            "train",
            "--trials",
            "1",
            "--horizon",
            "4",
            "--quiet",
            "--out",
            str(tmp_path / name),
        ]
        assert main(argv) == 0
        assert main(["evaluate", str(tmp_path / name), "--episodes", "1"]) == 0
        run = RunFolder.open(tmp_path / name)
        (row,) = run.metrics()
        lines = run.policy_steps_path.read_text().splitlines()[:-1]
        steps.append((lines, {key: row[key] for key in row if key not in ("wall_s", "cpu_s")}))
    assert len(steps[0][0]) > 10
    assert steps[0] == steps[1]


# evaluate -----------------------------------------------------------------------------------------


def evaluation(capsys, *argv: str) -> dict:
    assert main(["evaluate", *argv, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_evaluation_reports_every_measure(trained, capsys):
    report = evaluation(capsys, str(trained), "--episodes", "3")
    assert report["trial"] == 2
    assert report["episodes"] == 3
    assert 0 <= report["success_rate"] <= 1
    for measure in ("return", "time_up_s", "mean_abs_cart_m"):
        numbers = report[measure]
        assert numbers["min"] <= numbers["mean"] <= numbers["max"]
        assert numbers["std"] >= 0


def test_evaluation_repeats_with_its_seed_alone(trained, capsys):
    first, again, other = (
        evaluation(capsys, str(trained), "--episodes", "3", "--seed", seed) for seed in "001"
    )
    assert first == again
    assert first["return"] != other["return"]


def test_evaluation_judges_the_policy_of_the_trial_asked_for(trained, capsys):
    # A policy with a huge bias pushes the cart away.
    run = RunFolder.open(trained)
    arrays = run.read_arrays(1, "policy")
    run.write_arrays(1, "policy", {**arrays, "bias": np.full(1, 1e6)})
    pushed = evaluation(capsys, str(trained), "--episodes", "3", "--trial", "1")
    last = evaluation(capsys, str(trained), "--episodes", "3")
    assert pushed["mean_abs_cart_m"]["mean"] > 2 * last["mean_abs_cart_m"]["mean"]


def test_evaluation_prints_a_table(trained, capsys):
    assert main(["evaluate", str(trained), "--episodes", "2"]) == 0
    text = capsys.readouterr().out
    assert "trial 2: 2 fresh rollouts" in text
    assert "time up [s]" in text
    assert "success: 0 of 2 (0%)" in text


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--episodes", "0"], "--episodes must be at least 1"),
        (["--trial", "9"], "--trial must be one of 1, 2, got 9"),
        (["--trial", "0"], "--trial must be one of 1, 2, got 0"),
    ],
)
def test_wrong_evaluations_are_refused(trained, capsys, arguments, sentence):
    assert sentence in refused(capsys, "evaluate", str(trained), *arguments)


@pytest.mark.parametrize("command", ["evaluate", "view", "report"])
def test_missing_run_is_refused(tmp_path, capsys, command):
    assert "holds no run" in refused(capsys, command, str(tmp_path / "nothing"))


@pytest.mark.parametrize("command", ["evaluate", "view", "report"])
def test_corrupted_config_is_refused(trained, capsys, command):
    path = trained / "config.json"
    path.write_text(path.read_text()[:40])
    assert "config.json is damaged" in refused(capsys, command, str(trained))


@pytest.mark.parametrize("name", ["agent.npz", "trials/02/policy.npz", "metrics.csv"])
def test_corrupted_run_is_refused(trained, capsys, name):
    path = trained / name
    path.write_bytes(path.read_bytes()[:50])
    assert name in refused(capsys, "evaluate", str(trained))


def test_policy_of_another_shape_is_refused(trained, capsys):
    RunFolder.open(trained).write_arrays(2, "policy", {"weight": np.ones((2, 2))})
    assert "is not a policy of this agent" in refused(capsys, "evaluate", str(trained))


def test_run_without_a_trial_is_refused(tmp_path, trained, capsys):
    config = RunFolder.open(trained).config
    RunFolder.create(tmp_path / "new", config)
    assert "no finished trial yet" in refused(capsys, "evaluate", str(tmp_path / "new"))
    assert "no recording yet" in refused(capsys, "view", str(tmp_path / "new"))


# view ---------------------------------------------------------------------------------------------


@pytest.fixture
def shown(monkeypatch):
    """What the viewer is asked for, in place of the viewer."""
    calls = []
    monkeypatch.setattr(
        "mcpilco.show.open_viewer", lambda paths, web, tell: calls.append((paths, web))
    )
    monkeypatch.setattr("mcpilco.show.screenshot", lambda *arguments: calls.append(arguments))
    return calls


def test_view_opens_a_film_of_all_trials_or_the_one_asked_for(trained, shown):
    assert main(["view", str(trained)]) == 0
    assert main(["view", str(trained), "--trial", "0", "--web"]) == 0
    ((film,), window), second = shown
    assert (film.name, window) == ("film.rrd", False)
    assert second == ([trained / "rollouts" / "00.rrd"], True)


def test_picture_is_of_the_end_unless_told(trained, shown, tmp_path):
    picture = ["--screenshot", str(tmp_path / "a.png")]
    assert main(["view", str(trained), *picture]) == 0
    assert main(["view", str(trained), *picture, "--trial", "2"]) == 0
    assert main(["view", str(trained), *picture, "--at", "0.2"]) == 0
    film_s = 3 * 0.5 + 2 * 0.5  # three rollouts of five steps of 0.1 s, and two pauses
    assert [call[2] for call in shown] == [pytest.approx(film_s), pytest.approx(0.5), 0.2]


def test_a_gap_is_shown_by_its_folder_or_its_recording(shown, tmp_path, capsys):
    film = tmp_path / "gap" / "gap.rrd"
    film.parent.mkdir()
    film.write_bytes(b"")
    picture = ["--screenshot", str(tmp_path / "a.png")]
    assert main(["view", str(film.parent)]) == 0
    assert main(["view", str(film), *picture]) == 0
    assert shown == [([film], False), (film, tmp_path / "a.png", 1.0)]
    assert "is no run" in refused(capsys, "view", str(film.parent), "--live")


def test_two_runs_are_overlaid_and_their_films_end_together(trained, shown, tmp_path):
    other = tmp_path / "other"
    assert main(["train", *RUN, "--seed", "5", "--out", str(other)]) == 0
    picture = ["--screenshot", str(tmp_path / "a.png")]
    assert main(["view", str(trained), str(other), *picture]) == 0
    assert main(["view", str(trained), str(other), "--trial", "1", *picture]) == 0
    assert [call[2] for call in shown] == [pytest.approx(2.5), pytest.approx(0.5)]


def test_runs_of_two_systems_are_not_overlaid(trained, shown, strange, capsys):
    assert main(["train", "--env", "strange:Strange/Point-v0", *RUN, "--out", "point"]) == 0
    sentence = refused(capsys, "view", str(trained), "point")
    assert "of one system" in sentence
    assert "pole_angle" in sentence


def test_run_whose_env_is_gone_is_shown_without_its_scene(trained, shown, capsys):
    path = trained / "config.json"
    path.write_text(path.read_text().replace(CART_POLE, "nowhere/Gone-v0"))
    assert main(["view", str(trained)]) == 0
    assert "without the scene" in capsys.readouterr().err
    assert len(shown) == 1


def test_trial_that_cannot_be_read_is_named_and_left_out(trained, shown, capsys):
    (trained / "trials" / "01" / "particles.npz").write_bytes(b"nothing")
    assert main(["view", str(trained)]) == 0
    assert "left out: " in capsys.readouterr().err
    assert len(shown) == 1


@pytest.mark.parametrize("more", [["--trial", "1"], ["--screenshot", "a.png"], ["."]])
def test_live_follows_one_run_as_a_whole(trained, shown, capsys, more, monkeypatch):
    monkeypatch.chdir(trained)
    assert "--live follows one run" in refused(capsys, "view", str(trained), "--live", *more)


def test_training_that_is_watched_starts_a_viewer_that_follows_it(tmp_path, fake, monkeypatch):
    started = []

    class Viewer:
        def __init__(self, command, env):
            started.append(command)

        __enter__ = lambda self: self  # noqa: E731
        __exit__ = lambda self, *_: None  # noqa: E731
        poll = lambda self: 0  # noqa: E731

    monkeypatch.setattr("mcpilco.cli.train.subprocess.Popen", Viewer)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    path = tmp_path / "run"
    assert main(["train", *RUN, "--live", "--out", str(path)]) == 0
    ((*_, view, run, live, web),) = started
    assert (view, run, live, web) == ("view", str(path), "--live", "--web")
    assert RunFolder.open(path).finished_trials() == [1, 2]


def test_trial_without_recording_is_refused(trained, shown, capsys):
    sentence = refused(capsys, "view", str(trained), "--trial", "3")
    assert "--trial must be one of 0, 1, 2, got 3" in sentence


# report -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_report_lies_in_the_run_folder_unless_told(trained, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert main(["report", str(trained)]) == 0
    assert main(["report", str(trained), "--out", str(tmp_path / "sub" / "page.html")]) == 0
    first, second = (line.strip() for line in capsys.readouterr().out.splitlines())
    assert first == str(trained / "report.html")
    assert (tmp_path / "sub" / "page.html").read_text() == (trained / "report.html").read_text()
    assert second.endswith("page.html")


@pytest.mark.slow
def test_report_that_cannot_be_written_is_refused(trained, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    (tmp_path / "file").touch()
    sentence = refused(capsys, "report", str(trained), "--out", str(tmp_path / "file" / "a.html"))
    assert "Cannot write" in sentence


# doctor -------------------------------------------------------------------------------------------


def test_doctor_prints_every_finding_and_judges_by_what_is_needed(monkeypatch, capsys):
    from mcpilco.cli import doctor

    good = doctor.Finding("torch", "2.0")
    optional = doctor.Finding("display", "none", "use --web", needed=False)
    bad = doctor.Finding("numba", "missing", "pip install numba")
    monkeypatch.setattr(doctor, "examine", lambda: iter([good, optional]))
    assert main(["doctor"]) == 0
    assert "use --web" in capsys.readouterr().out
    monkeypatch.setattr(doctor, "examine", lambda: iter([good, bad]))
    assert main(["doctor"]) == 1
    text = capsys.readouterr().out
    assert "pip install numba" in text
    assert "To mend: numba." in text


def test_doctor_names_what_is_missing(monkeypatch):
    from mcpilco.cli import doctor

    monkeypatch.setattr(doctor, "_version", lambda package: None)
    monkeypatch.setattr(doctor, "_says", lambda command: (False, "not found"))
    findings = {finding.subject: finding for finding in doctor.examine()}
    assert findings["torch"].fix == "pip install torch"
    assert findings["torch"].needed
    assert "--tensorboard" in findings["tensorboard"].fix
    assert not findings["tensorboard"].needed
    assert findings["numba compiles"].fix
    assert findings["Rerun viewer"].fix


# As a program -------------------------------------------------------------------------------------


def program(*argv: str, **kwargs) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "mcpilco.cli", *argv]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **kwargs)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("command", [[], ["train"], ["evaluate"], ["view"], ["report"], ["doctor"]])
def test_help_imports_nothing_slow(command):
    code = (
        "import sys; from mcpilco.cli import main; code = main(sys.argv[1:]);"
        "slow = {'torch', 'rerun', 'gymnasium', 'mujoco', 'numba', 'numpy'} & set(sys.modules);"
        "sys.exit(code or (str(slow) if slow else 0))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *command, "--help"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "usage: mcpilco" in done.stdout


def test_a_reader_of_the_output_may_leave_early():
    """As `| head` does."""
    command = [sys.executable, "-m", "mcpilco.cli", "train", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


@pytest.mark.slow
def test_program_refuses_an_unknown_env_with_one_sentence_and_code_2():
    done = program("train", "--env", "nowhere/Nothing-v0")
    assert done.returncode == 2
    assert done.stderr.startswith("mcpilco: error: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_program_refuses_an_unknown_flag_with_code_2():
    done = program("train", "--trails", "3")
    assert done.returncode == 2
    assert "--trials" in done.stderr


# --- envs that were not made for it ---------------------------------------------------------------

TASK_FILE = """
from mcpilco import TaskSpec
from mcpilco.policies.costs import QuadraticCost

TASK = TaskSpec(("x",), ("m",), ("u",), ("N",), 0.1, (), (), (0.0,), (0.1,),
                QuadraticCost((0.0,), (1.0,), (0.0,)))
"""


def test_a_task_file_stands_in_for_the_task_that_an_env_does_not_show(strange, fake, capsys):
    (strange / "my_task.py").write_text(TASK_FILE)
    arguments = ["--env", "strange:Strange/Unknown-v0", "--out", "run", "--quiet"]
    assert main(["train", *arguments, "--task", "my_task.py"]) == 0
    assert "no task file nowhere.py" in refused(capsys, "train", *arguments, "--task", "nowhere.py")


def test_the_number_of_random_steps_is_recorded(strange, fake):
    arguments = ["--env", "strange:Strange/Point-v0", "--out", "run", "--quiet"]
    assert main(["train", *arguments, "--exploration", "7"]) == 0
    assert RunFolder.open("run").config["config"]["exploration"] == 7


def test_check_env_tells_faults_by_its_exit_code(strange, capsys):
    steady = ["check-env", "strange:Strange/Nan-v0"]
    assert main(steady) == 1
    said = capsys.readouterr().out
    assert "no  The env must return finite numbers" in said
    assert said.endswith("To mend: 1.\n")
    assert main(["check-env", "Pendulum-v1", "--steps", "120"]) == 0
    assert capsys.readouterr().out.endswith("The agent can use this env.\n")
    assert "Cannot make the env" in refused(capsys, "check-env", "nowhere/Nothing-v0")
    assert "--steps" in refused(capsys, "check-env", "Pendulum-v1", "--steps", "0")


def test_evaluate_tells_the_rollouts_before_a_system_stopped_answering(
    trained, capsys, monkeypatch
):
    episodes, run = [], job.run_episode

    def failing(*arguments, **keywords):
        episodes.append(arguments)
        if len(episodes) == 3:
            raise EnvError("No machine answers.")
        return run(*arguments, **keywords)

    monkeypatch.setattr(job, "run_episode", failing)
    assert main(["evaluate", str(trained), "--episodes", "4", "--json"]) == 1
    told = capsys.readouterr()
    assert json.loads(told.out)["episodes"] == 2
    assert "after 2 of 4 rollouts: No machine answers." in told.err


def test_evaluate_judges_on_episodes_of_another_length(trained, capsys):
    def returns(*argv):
        assert main(["evaluate", str(trained), "--episodes", "2", "--json", *argv]) == 0
        return json.loads(capsys.readouterr().out)["return"]

    short, same, long = returns("--horizon", "2"), returns(), returns("--horizon", "25")
    assert short["max"] <= 2 < long["max"] + 23
    assert short != same != long
    assert "--horizon" in refused(capsys, "evaluate", str(trained), "--horizon", "0")
