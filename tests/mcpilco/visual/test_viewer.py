from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from mcpilco.typing import InputError, RunFolderError
from mcpilco.visual import viewer
from mcpilco.visual.recording import write_recording


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "01.rrd"
    path.touch()
    return path


@pytest.fixture
def started(monkeypatch) -> list[list[str]]:
    """Commands that would have been run."""
    commands = []

    def run(command, **_):
        commands.append(command)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(viewer.subprocess, "run", run)
    return commands


def without_display(monkeypatch) -> None:
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def test_window_needs_a_display_and_the_error_names_the_ways_out(
    recording, started, monkeypatch
) -> None:
    without_display(monkeypatch)
    with pytest.raises(InputError, match=r"--web .*--screenshot"):
        viewer.open_viewer([recording])
    assert started == []


@pytest.mark.parametrize("web", [False, True])
def test_viewer_listens_on_this_machine_only(recording, started, monkeypatch, web) -> None:
    without_display(monkeypatch)
    if not web:
        monkeypatch.setenv("DISPLAY", ":0")
    viewer.open_viewer([recording], web=web)
    (command,) = started
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert command[-1] == str(recording)
    assert ("--serve-web" in command) == web


def test_viewer_is_started_by_its_absolute_path(recording, started) -> None:
    viewer.open_viewer([recording], web=True)
    assert viewer.Path(started[0][0]).is_absolute()


def test_failed_viewer_is_an_error(recording, monkeypatch) -> None:
    monkeypatch.setattr(
        viewer.subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 3)
    )
    with pytest.raises(InputError, match="code 3"):
        viewer.open_viewer([recording], web=True)


def test_missing_recording_is_named(tmp_path) -> None:
    with pytest.raises(RunFolderError, match="no recording at .*02.rrd"):
        viewer.open_viewer([tmp_path / "02.rrd"], web=True)
    with pytest.raises(RunFolderError, match="no recording at .*02.rrd"):
        viewer.screenshot(tmp_path / "02.rrd", tmp_path / "a.png", 0.0)


def test_viewer_that_cannot_draw_names_the_remedy(recording, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(viewer, "_listens", lambda *_: False)
    with pytest.raises(InputError, match="mesa-vulkan-drivers"):
        viewer.screenshot(recording, tmp_path / "a.png", 0.0)
    assert not (tmp_path / "a.png").exists()


def test_viewer_takes_another_port_where_its_own_is_in_use(recording, started) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert viewer._free_port(port) not in (0, port)


def picture(path, png, at_s: float) -> bytes:
    try:
        return viewer.screenshot(path, png, at_s).read_bytes()
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.slow
def test_picture_shows_the_instant_asked_for(tmp_path, rollout, prediction, task, scene) -> None:
    path = write_recording(tmp_path / "01.rrd", rollout, prediction, task, scene, "trial 1")
    early, late = (picture(path, tmp_path / "sub" / f"{at}.png", at) for at in (0.5, 2.5))
    assert early.startswith(b"\x89PNG")
    assert early != late


@pytest.mark.slow
def test_damaged_recording_is_answered_with_a_sentence(tmp_path) -> None:
    path = tmp_path / "01.rrd"
    path.write_bytes(b"not a recording" * 20)
    with pytest.raises(RunFolderError, match="cannot be shown"):
        picture(path, tmp_path / "01.png", 0.0)


def test_neither_rerun_nor_matplotlib_is_loaded_before_it_is_used() -> None:
    script = (
        "import sys, mcpilco.visual\n"
        "assert not {'rerun', 'matplotlib', 'torch'} & set(sys.modules)\n"
        "assert mcpilco.visual.write_recording.__name__ == 'write_recording'\n"
    )
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0
