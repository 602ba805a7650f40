"""Laws of a run that is killed, or finds the disk full: no trial is lost, and the rest is as if
nothing had happened."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mcpilco.agent import MCPILCO
from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.logbook import RunFolder
from tests.mcpilco import point
from tests.mcpilco.cli.test_cli import refused
from tests.mcpilco.point import TINY
from tests.mcpilco.survival import (
    TRIALS,
    KilledAtWrite,
    command,
    content,
    equal_recordings,
    exit_code,
    resume,
    train,
)

KILLED = -9


@pytest.fixture(autouse=True)
def small_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also for what runs in this process."""
    default = dataclasses.replace(PRESETS["default"], config=TINY)
    monkeypatch.setitem(PRESETS, "default", default)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing happened to."""
    path = tmp_path_factory.mktemp("survival") / "undisturbed"
    assert exit_code(train(path)) == 0
    return path


@pytest.fixture
def finished(undisturbed: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(undisturbed, tmp_path / "run"))


def go_on(path: Path) -> list[str]:
    """The command after an interruption: resume what is there, else begin."""
    return resume(path) if (path / "config.json").exists() else train(path)


def check_readable(path: Path) -> int:
    """How many trials are finished; all that the folder holds of them can be read."""
    if not (path / "config.json").exists():
        return 0
    run = RunFolder.open(path)
    trials = run.finished_trials() if (path / "metrics.csv").exists() else []
    for trial in trials:
        run.result(trial)
        for name in ("rollout", "transitions", "particles", "policy", "gp"):
            run.read_arrays(trial, name)
        assert run.recording_path(trial).stat().st_size > 0
    if run.agent_path.exists():
        assert MCPILCO.load(run.agent_path).trials in (len(trials), len(trials) + 1)
    else:
        assert not trials
    return len(trials)


# --- killed


@pytest.mark.slow
@pytest.mark.parametrize(("number", "after"), [(1, True), (7, False)])
def test_a_run_killed_between_files_ends_as_if_nothing_had_been(
    tmp_path: Path, undisturbed: Path, number: int, after: bool
) -> None:
    path = tmp_path / "run"
    assert exit_code(train(path), KilledAtWrite(number, after)) == KILLED
    check_readable(path)
    assert exit_code(go_on(path)) == 0
    assert content(path) == content(undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("after", [False, True])
def test_a_run_may_be_killed_at_any_of_its_files(
    tmp_path: Path, undisturbed: Path, after: bool
) -> None:
    """Each file in its turn, until the run has none left to be killed at."""
    for number in range(1, 100):
        path = tmp_path / str(number)
        code = exit_code(train(path), KilledAtWrite(number, after))
        check_readable(path)
        if code == 0:
            break
        assert code == KILLED
        # while it goes on; 2: it had ended
        assert exit_code(go_on(path), KilledAtWrite(3, after)) in (0, 2, KILLED)
        assert exit_code(resume(path)) in (0, 2)
        assert content(path) == content(undisturbed), number
    assert number > 30


@pytest.mark.slow
def test_two_hundred_kills_at_random_moments_lose_nothing(
    tmp_path: Path, undisturbed: Path, record_property
) -> None:
    rng = np.random.default_rng(0)
    kills = runs = 0
    while kills < 200:
        path, trials, code = tmp_path / str(runs), 0, None
        while code not in (0, 2):  # 2: it had ended, and was killed after its last file
            process = command(go_on(path))
            process.join(rng.uniform(0, 1.5))
            process.kill()  # nothing happens where it has ended
            process.join()
            code = process.exitcode
            assert code in (0, 2, KILLED)
            kills += code == KILLED
            found = check_readable(path)
            assert found >= trials, "a trial was lost"
            trials = found
        assert trials == TRIALS
        assert content(path) == content(undisturbed)
        assert equal_recordings(path, undisturbed)
        shutil.rmtree(path)
        runs += 1
    record_property("kills", kills)
    record_property("runs", runs)


@pytest.mark.slow
def test_a_cart_pole_run_of_the_compiled_loops_survives_kills(tmp_path: Path) -> None:
    """As the user starts it: a fresh interpreter each time, and the signal of the task manager."""
    argv = ["--seed", "2", "--horizon", "8", "--trials", "2", "--quiet", "--preset", "default"]
    program = [sys.executable, "-m", "mcpilco.cli", "train"]
    rng = np.random.default_rng(1)
    begin, undisturbed, path = [*program, *argv, "--out"], tmp_path / "whole", tmp_path / "killed"
    subprocess.run([*begin, str(undisturbed)], check=True)
    kills, code = 0, None
    while code not in (0, 2):  # 2: it had ended, and was killed after its last file
        there = (path / "config.json").exists()
        rest = ["--resume", str(path), "--quiet"]
        process = subprocess.Popen([*program, *rest] if there else [*begin, str(path)])
        patience = rng.uniform(0.5, 4) * (1 + kills / 5)  # the whole takes more than 4 s
        try:
            code = process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            kills += 1
    assert kills > 0
    assert content(path) == content(undisturbed)
    assert equal_recordings(path, undisturbed)


# --- no room


@dataclass(frozen=True)
class SmallFiles:
    """No file of the process may be larger than this [bytes], much as on a full disk."""

    size: int

    def __call__(self) -> None:
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (self.size, hard))


@pytest.mark.parametrize("size", [pytest.param(3000, marks=pytest.mark.slow), 20_000])
def test_a_run_without_room_stops_with_a_sentence_and_goes_on_when_there_is(
    tmp_path: Path, undisturbed: Path, size: int
) -> None:
    path = tmp_path / "run"
    assert exit_code(train(path), SmallFiles(size)) == 2
    check_readable(path)
    assert exit_code(go_on(path)) == 0
    assert content(path) == content(undisturbed)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 2 MB of its own."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2048k", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("this user cannot mount a file system")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.parametrize("room", [20_000, pytest.param(120_000, marks=pytest.mark.slow), 200_000])
def test_a_full_disk_leaves_what_was_there(
    small_disk: Path, undisturbed: Path, capsys: pytest.CaptureFixture[str], room: int
) -> None:
    ballast, path = small_disk / "ballast", small_disk / "run"
    ballast.write_bytes(bytes(2048 * 1024 - room))
    sentence = refused(capsys, *train(path))
    assert "No space left on device" in sentence
    check_readable(path)
    ballast.unlink()
    assert exit_code(go_on(path)) == 0
    assert content(path) == content(undisturbed)


def test_a_read_only_folder_is_refused_and_stays_readable(
    small_disk: Path, undisturbed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = small_disk / "run"
    shutil.copytree(undisturbed, path)
    before = content(path)
    with read_only(small_disk):
        for argv in ([*resume(path), "--trials", "5"], train(small_disk / "new")):
            assert "Read-only file system" in refused(capsys, *argv)
        assert check_readable(path) == TRIALS
    assert content(path) == before


@contextlib.contextmanager
def read_only(disk: Path) -> Iterator[None]:
    for option in ("ro", "rw"):
        subprocess.run(["mount", "-o", f"remount,{option}", str(disk)], check=True)
        if option == "ro":
            yield


# --- going on


@pytest.mark.slow
def test_more_trials_are_what_a_longer_run_would_have_had(finished: Path, tmp_path: Path) -> None:
    assert exit_code([*resume(finished), "--trials", "5"]) == 0
    assert exit_code(train(tmp_path / "longer", trials=5)) == 0
    assert content(finished) == content(tmp_path / "longer")
    seconds = sum(row["wall_s"] for row in RunFolder.open(finished).metrics())
    assert RunFolder.open(finished).summary()["wall_s"] >= seconds


@pytest.mark.parametrize("trials", [[], ["--trials", "2"], ["--trials", "3"]])
def test_a_finished_run_is_not_resumed(finished: Path, capsys, trials: list[str]) -> None:
    before = content(finished)
    sentence = refused(capsys, *resume(finished), *trials)
    assert "has 3 finished trials" in sentence
    assert "--trials 7" in sentence
    assert content(finished) == before


@pytest.mark.parametrize("given", [["--seed", "5"], ["--horizon", "6"], ["--preset", "thesis"]])
def test_what_the_run_says_is_not_said_again(finished: Path, capsys, given: list[str]) -> None:
    assert "--resume takes env, its keywords, algo, preset, seed" in refused(
        capsys, *resume(finished), *given
    )


def test_a_run_of_the_first_format_is_read_and_not_resumed(finished: Path, capsys) -> None:
    change(finished, format=1)
    table = finished / "metrics.csv"
    rows = [line.rpartition(",")[0] for line in table.read_text().splitlines()]
    table.write_text("\n".join(rows) + "\n")
    assert RunFolder.open(finished).metrics()[2]["failure"] is None
    assert main(["evaluate", str(finished), "--episodes", "1"]) == 0
    assert "drew other random numbers" in refused(capsys, *resume(finished), "--trials", "4")


def change(path: Path, **entries: object) -> None:
    config = json.loads((path / "config.json").read_text())
    (path / "config.json").write_text(json.dumps({**config, **entries}))


def test_an_agent_of_another_run_is_refused(finished: Path, capsys) -> None:
    change(finished, seed=6)
    assert "is of another run" in refused(capsys, *resume(finished), "--trials", "4")


def test_finished_trials_are_never_taken_away(finished: Path, tmp_path: Path, capsys) -> None:
    """Also not where agent.npz was lost, or comes from an earlier trial."""
    before = content(finished)
    agent = (finished / "agent.npz").read_bytes()
    (finished / "agent.npz").unlink()
    sentence = refused(capsys, *resume(finished), "--trials", "4")
    assert "3 finished trials, but its agent.npz knows of 0" in sentence
    (finished / "agent.npz").write_bytes(agent)
    assert content(finished) == before


def test_nothing_outside_of_the_run_is_taken_away(finished: Path, tmp_path: Path, capsys) -> None:
    mine = tmp_path / "mine" / "2020"
    mine.mkdir(parents=True)
    shutil.rmtree(finished / "rollouts")
    (finished / "rollouts").symlink_to(mine.parent)
    assert "outside of the folder" in refused(capsys, *resume(finished), "--trials", "4")
    assert mine.is_dir()


def test_two_processes_do_not_write_to_one_run(finished: Path, capsys) -> None:
    with RunFolder.open(finished).writing():
        sentence = refused(capsys, *resume(finished), "--trials", "4")
    assert "Another process is writing" in sentence


def test_other_versions_are_told_of(finished: Path, capsys) -> None:
    versions = {**RunFolder.open(finished).config["versions"], "numpy": "1.0"}
    change(finished, versions=versions)
    assert main([*resume(finished), "--trials", "4"]) == 0
    assert "numpy 1.0 -> " in capsys.readouterr().err


def test_event_files_go_on_counting(finished: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    for trials in "45":  # the second finds the folder, and needs no telling
        tensorboard = ["--tensorboard"] if trials == "4" else []
        assert main([*resume(finished), "--trials", trials, *tensorboard]) == 0
    events = accumulator.EventAccumulator(str(finished / "tensorboard"))
    events.Reload()
    steps = TINY.search.steps[0]
    counted = [event.step for event in events.Scalars("policy/cost")]
    assert counted == list(range(3 * steps + 1, 5 * steps + 1))


def test_a_module_in_the_run_folder_is_not_executed(
    finished: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark = finished.parent / "executed"
    (finished / "evil.py").write_text(f"import os; os.mkdir({str(mark)!r})")
    for folder, module in ((finished, "evil"), (finished.parent, "run.evil")):
        monkeypatch.chdir(folder)
        change(finished, env=f"{module}:Any-v0")
        for argv in (["evaluate", str(finished)], [*resume(finished), "--trials", "4"]):
            assert "no module is imported because a file names it" in refused(capsys, *argv)
    assert not mark.exists()


# --- trials that fail


def test_a_trial_that_breaks_off_is_told_of_and_the_run_goes_on(
    tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps, step = iter(range(1, 100)), point.PointEnv.step

    def breaks(self, action):
        if next(steps) == point.STEPS + 3:
            raise ConnectionError("no answer,\nno robot")
        return step(self, action)

    monkeypatch.setattr(point.PointEnv, "step", breaks)
    path = tmp_path / "run"
    assert main(train(path, trials=2)) == 0
    run = RunFolder.open(path)
    reason = (
        "The env raised ConnectionError at step 3: no answer, no robot; mend the env, or the "
        "connection to its system."
    )
    assert [row["failure"] for row in run.metrics()] == [reason, None]
    assert [len(run.read_arrays(trial, "rollout")["inputs"]) for trial in (1, 2)] == [2, 6]
    assert run.metrics()[0]["success"] is False
    assert main(["evaluate", str(path), "--trial", "1", "--episodes", "1"]) == 0


def test_an_env_that_is_gone_stops_the_run_which_can_be_resumed(
    tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run"
    with monkeypatch.context() as patch:
        resets, reset = iter(range(1, 100)), point.PointEnv.reset

        def gone(self, *, seed=None, options=None):
            if next(resets) == 3:
                raise ConnectionError("gone")
            return reset(self, seed=seed, options=options)

        patch.setattr(point.PointEnv, "reset", gone)
        assert main(train(path, trials=2)) == 2
    told = capsys.readouterr().err.splitlines()
    assert "trial 1 is saved" in told[-2]
    assert f"mcpilco train --resume {path}" in told[-2]
    assert "ConnectionError at step 0: gone" in told[-1]
    assert main(resume(path)) == 0
    assert main(train(tmp_path / "whole", trials=2)) == 0
    assert content(path) == content(tmp_path / "whole")
