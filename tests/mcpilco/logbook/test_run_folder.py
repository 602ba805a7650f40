from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from mcpilco.logbook.metrics import METRICS
from mcpilco.logbook.run_folder import FORMAT, RunFolder, versions
from mcpilco.typing import RunFolderError
from tests.mcpilco.fakes import make_result

CONFIG = {
    "env": "mcpilco/CartPoleSwingUp-v0",
    "env_kwargs": {"dt": 0.05},
    "preset": "default",
    "seed": 3,
    "trials": 4,
    "config": {"horizon": None},
}
COLUMNS = (
    "trial,experience_s,predicted_cost,real_cost,success,time_up_s,mean_abs_cart_m,wall_s,cpu_s,"
    "failure,limits_kept,limits_crossed"
)


@pytest.fixture
def run(tmp_path):
    return RunFolder.create(tmp_path / "run", CONFIG)


def leftovers(run):
    """Hidden files, such as a write that did not end."""
    return [path for path in run.path.rglob("*") if path.name.startswith(".")]


# Folder and config --------------------------------------------------------------------------------


def test_opened_run_has_the_config_it_was_created_with(run):
    opened = RunFolder.open(run.path)
    assert opened.config == run.config
    assert {key: opened.config[key] for key in CONFIG} == CONFIG
    assert opened.config["format"] == FORMAT
    assert opened.config["versions"] == versions()
    assert "numpy" in versions()


def test_new_run_has_no_trial_and_no_summary(run):
    assert run.metrics() == []
    assert run.finished_trials() == []
    assert run.summary() is None


def test_parents_are_made(tmp_path):
    path = tmp_path / "a" / "b" / "run"
    assert RunFolder.create(path, CONFIG).path == path


def test_empty_folder_is_accepted(tmp_path):
    RunFolder.create(tmp_path, CONFIG)


def test_folder_that_holds_a_run_is_refused_and_left_alone(run):
    before = (run.path / "config.json").read_bytes()
    with pytest.raises(RunFolderError, match="already holds a run"):
        RunFolder.create(run.path, {**CONFIG, "seed": 9})
    assert (run.path / "config.json").read_bytes() == before


def test_folder_that_holds_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(RunFolderError, match="is not empty"):
        RunFolder.create(tmp_path, CONFIG)


@pytest.mark.parametrize("path", ["file", "file/run"])
def test_folder_that_cannot_be_made_is_an_error(tmp_path, path):
    (tmp_path / "file").touch()
    with pytest.raises(RunFolderError, match="cannot be written"):
        RunFolder.create(tmp_path / path, CONFIG)


def test_folder_without_a_run_is_an_error(tmp_path):
    for path in (tmp_path, tmp_path / "missing"):
        with pytest.raises(RunFolderError, match="holds no run"):
            RunFolder.open(path)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b'{"format": 1', b"[1]", b"\xff\xfe\x00", b"{}", b"null", b"[" * 100_000],
    ids=lambda content: repr(content[:8]),
)
def test_damaged_config_is_an_error(run, content):
    (run.path / "config.json").write_bytes(content)
    with pytest.raises(RunFolderError, match=r"config\.json is damaged"):
        RunFolder.open(run.path)


@pytest.mark.parametrize(("key", "value"), [("env", 3), ("seed", True), ("config", [])])
def test_config_with_a_value_of_another_type_is_an_error(run, key, value):
    (run.path / "config.json").write_text(json.dumps({**run.config, key: value}))
    with pytest.raises(RunFolderError, match=f"`{key}` must be of type"):
        RunFolder.open(run.path)


@pytest.mark.parametrize("key", list(CONFIG))
def test_config_that_lacks_a_key_is_an_error(run, key):
    content = {name: value for name, value in run.config.items() if name != key}
    (run.path / "config.json").write_text(json.dumps(content))
    with pytest.raises(RunFolderError, match=f"`{key}` must be of type"):
        RunFolder.open(run.path)


def test_later_format_asks_for_a_newer_program(run):
    (run.path / "config.json").write_text(json.dumps({"format": FORMAT + 1}))
    with pytest.raises(RunFolderError, match="install a newer mcpilco"):
        RunFolder.open(run.path)


# Metrics ------------------------------------------------------------------------------------------


def test_metrics_have_exactly_the_promised_columns(run):
    fixed = COLUMNS.replace(",time_up_s,mean_abs_cart_m", "")
    assert (run.path / "metrics.csv").read_text() == fixed + "\n"
    run.add_metrics(make_result(1))
    assert (run.path / "metrics.csv").read_text().startswith(COLUMNS + "\n1,")


@pytest.mark.parametrize(
    "absent", [",limits_kept,limits_crossed", ",failure,limits_kept,limits_crossed"]
)
def test_metrics_of_older_folders_are_read(run, absent):
    run.add_metrics(make_result(1))
    [row] = run.metrics()
    header, line = (run.path / "metrics.csv").read_text().splitlines()
    cells = line.split(",")[: -absent.count(",")]
    (run.path / "metrics.csv").write_text(f"{header.removesuffix(absent)}\n{','.join(cells)}\n")
    assert run.metrics() == [row | dict.fromkeys(absent[1:].split(","))]


def test_metrics_keep_measures_that_another_env_reports(run):
    outcome = {"is_success": 0.0, "distance_m": 1.25, "spin_rad_per_s": 7.5, "score": 3.0}
    result = make_result(1, replace(make_result(1).rollout, outcome=outcome))
    run.add_metrics(result)
    (row,) = run.metrics()
    assert (row["distance_m"], row["spin_rad_per_s"]) == (1.25, 7.5)
    assert not {"score", "time_up_s"} & row.keys()


def test_metrics_of_earlier_versions_with_empty_measures_are_read(run):
    (run.path / "metrics.csv").write_text(COLUMNS + "\n1,3.0,4.0,5.0,1,,,6.0,7.0,,,\n")
    (row,) = run.metrics()
    assert row["time_up_s"] is row["mean_abs_cart_m"] is None


def test_metrics_read_back_equal(run):
    results = [make_result(1), make_result(2, told=False), replace(make_result(3), success=False)]
    for result in results:
        run.add_metrics(result)
    for row, result in zip(run.metrics(), results, strict=True):
        measures = dict.fromkeys(("time_up_s", "mean_abs_cart_m")) | dict(result.outcome)
        assert row == {column: getattr(result, column) for column in METRICS} | measures
    assert run.finished_trials() == [1, 2, 3]
    assert leftovers(run) == []


def test_metrics_do_not_depend_on_numpy_scalars(run, tmp_path):
    other = RunFolder.create(tmp_path / "other", CONFIG)
    result = make_result(1)
    as_numpy = replace(result, real_cost=np.float64(result.real_cost), success=np.bool_(True))
    run.add_metrics(result)
    other.add_metrics(as_numpy)
    texts = [(folder.path / "metrics.csv").read_text() for folder in (run, other)]
    assert texts[0] == texts[1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "trial,cost\n1,2\n",
        COLUMNS.replace("wall_s", "seconds") + "\n",
        COLUMNS + "\n1,3.0\n",
        COLUMNS + "\n1,3.0,4.0,5.0,1,,,six,7.0,\n",
        COLUMNS + "\n1,3.0,4.0,5.0,maybe,,,6.0,7.0,\n",
        COLUMNS + "\n1,3.0,4.0,5.0,1,,,6.0,7.0,,8.0\n",
        COLUMNS + "\n2,3.0,4.0,5.0,1,,,6.0,7.0,\n",
    ],
)
def test_damaged_metrics_are_an_error(run, text):
    (run.path / "metrics.csv").write_text(text)
    with pytest.raises(RunFolderError, match=r"metrics\.csv is damaged"):
        run.metrics()


def test_metrics_that_are_no_text_are_an_error(run):
    (run.path / "metrics.csv").write_bytes(b"\xff\x00")
    with pytest.raises(RunFolderError, match="is damaged"):
        run.metrics()


def test_missing_metrics_are_an_error(run):
    (run.path / "metrics.csv").unlink()
    with pytest.raises(RunFolderError, match="is missing"):
        run.metrics()


# Arrays and summary -------------------------------------------------------------------------------


def test_arrays_read_back_equal(run):
    arrays = {"states": np.arange(6.0).reshape(3, 2), "dt": np.array(0.1)}
    run.write_arrays(2, "rollout", arrays)
    back = run.read_arrays(2, "rollout")
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
    assert run.arrays_path(2, "rollout") == run.path / "trials" / "02" / "rollout.npz"
    assert leftovers(run) == []


def test_equal_arrays_give_equal_files(run):
    for trial in (1, 2):
        run.write_arrays(trial, "policy", {"weights": np.linspace(0, 1, 7)})
    first, second = (run.arrays_path(trial, "policy").read_bytes() for trial in (1, 2))
    assert first == second


class Bomb:
    """Goes off when it is unpickled."""

    def __reduce__(self):
        return (pytest.fail, ("executed while reading",))


def test_pickled_objects_are_never_executed(run):
    run.write_arrays(1, "policy", {})
    path = run.arrays_path(1, "policy")
    np.savez(path, weights=np.array([Bomb()], dtype=object))
    with pytest.raises(RunFolderError, match="plain arrays"):
        run.read_arrays(1, "policy")
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(RunFolderError, match="plain arrays"):
        run.read_arrays(1, "policy")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.99])
def test_truncated_arrays_are_an_error(run, share):
    run.write_arrays(1, "gp", {"L": np.random.default_rng(0).normal(size=(30, 30))})
    path = run.arrays_path(1, "gp")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RunFolderError, match="damaged"):
        run.read_arrays(1, "gp")


def test_missing_arrays_are_an_error(run):
    with pytest.raises(RunFolderError, match="no file"):
        run.read_arrays(1, "gp")


def test_summary_reads_back(run):
    run.write_summary({"success": None, "real_cost": 0.1})
    summary = run.summary()
    assert summary["success"] is None
    assert summary["real_cost"] == 0.1
    assert summary["versions"] == versions()


def test_failed_write_leaves_the_old_file_whole(run, monkeypatch):
    run.write_summary({"real_cost": 1.0})
    before = (run.path / "summary.json").read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(RunFolderError, match="No space left"):
        run.write_summary({"real_cost": 2.0})
    assert (run.path / "summary.json").read_bytes() == before
    assert leftovers(run) == []


# Results ------------------------------------------------------------------------------------------


def test_a_result_reads_back_as_it_was(run):
    result = replace(make_result(1), real_cost=float("inf"), failure="no robot, no result")
    (run.path / "trials" / "01").mkdir()
    run.write_result(result)
    read = run.result(1)
    assert read["real_cost"] is None  # infinity is no JSON
    assert read["failure"] == "no robot, no result"
    assert read["noise_std"] == list(result.noise_std)
    run.add_metrics(result)
    assert run.metrics() == [{column: read[column] for column in (*METRICS, *result.outcome)}]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("trial", 2), ("real_cost", "a"), ("real_cost", []), ("wall_s", None), ("success", 2)),
        *(("failure", 3), ("policy_steps", "many"), ("policy_steps", -1), ("cpu_s", {})),
    ],
)
def test_a_damaged_result_is_an_error(run, key, value):
    (run.path / "trials" / "01").mkdir()
    run.write_result(make_result(1))
    path = run.path / "trials" / "01" / "result.json"
    values = json.loads(path.read_text())
    path.write_text(json.dumps({**values, key: value}))
    with pytest.raises(RunFolderError, match=r"result\.json is damaged"):
        run.result(1)
    path.write_text(json.dumps({name: values[name] for name in values if name != key}))
    with pytest.raises(RunFolderError, match=r"result\.json is damaged"):
        run.result(1)


@pytest.mark.parametrize("name", ["metrics.csv", "agent.npz", "trials", "rollouts/01.rrd"])
def test_a_run_that_leads_outside_is_not_written_to(run, tmp_path, name):
    """A folder that somebody sent must not choose which files of the user's are written."""
    secret = tmp_path / "secret"
    secret.write_text("mine")
    if name == "trials":
        (run.path / name).rmdir()
    (run.path / name).unlink(missing_ok=True)
    (run.path / name).symlink_to(secret)
    with pytest.raises(RunFolderError, match=f"{name} is a link to .*secret"), run.writing():
        pass
    assert secret.read_text() == "mine"
