from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mcpilco.show import viewer
from mcpilco.show.recording import write_recording
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.show import browser


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "01.rrd"
    path.touch()
    return path


@pytest.fixture
def started(monkeypatch) -> list[list[str]]:
    """Commands that would have been run."""
    commands = []

    class Ended:
        def __init__(self, command, **_):
            commands.append(command)

        def wait(self):
            return 0

        def poll(self):
            return 0

        def terminate(self):
            pass

    monkeypatch.setattr(viewer.subprocess, "Popen", Ended)
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
    monkeypatch.setattr(viewer, "_executable", lambda: "false")
    with pytest.raises(InputError, match="code 1"):
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


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="Linux tells of open ports")
def test_ports_of_the_web_viewer_are_open_to_this_machine_only() -> None:
    """Asked of the system, while the viewer runs: nothing else may reach a recording."""
    with viewer.live_viewer(web=True) as shown:
        port = int(re.search(r":(\d+)/", shown.url)[1])
        deadline = time.monotonic() + 30
        while len(ports := listening(shown.process.pid)) < 2 and time.monotonic() < deadline:
            time.sleep(0.1)
    assert len(ports) == 2
    assert port in {number for _, number in ports}
    assert {address for address, _ in ports} == {"127.0.0.1"}
    assert shown.closed


def listening(pid: int) -> set[tuple[str, int]]:
    """Addresses and ports on which a process accepts connections."""
    sockets = set()
    for end in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            sockets.add(os.readlink(end))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *_, inode = line.split()[:10]
            if state == "0A" and f"socket:[{inode}]" in sockets:  # 0A: listens
                address, port = local.split(":")
                four = len(address) == 8
                name = ".".join(str(b) for b in bytes.fromhex(address)[::-1]) if four else address
                found.add((name, int(port, 16)))
    return found


def picture(path, png, at_s: float) -> bytes:
    try:
        return viewer.screenshot(path, png, at_s).read_bytes()
    except InputError as error:
        pytest.skip(str(error))


def colors_and_drawn(png: bytes) -> tuple[int, float]:
    """How many colours a picture has, and the share of it that is not its commonest one."""
    image = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).reshape(-1, 3)
    _, counts = np.unique(image, axis=0, return_counts=True)
    return len(counts), 1 - counts.max() / counts.sum()


@pytest.mark.slow
def test_picture_is_drawn_and_shows_the_instant_asked_for(
    tmp_path, rollout, prediction, task, scene
) -> None:
    path = write_recording(tmp_path / "01.rrd", rollout, prediction, task, scene, "trial 1")
    early, late = (picture(path, tmp_path / "sub" / f"{at}.png", at) for at in (0.5, 2.5))
    for png in (early, late):
        assert png.startswith(b"\x89PNG")
        colors, drawn = colors_and_drawn(png)
        assert colors > 1000
        assert drawn > 0.1
    first, second = (
        np.asarray(Image.open(io.BytesIO(png)).convert("RGB"), dtype=float) for png in (early, late)
    )
    scene_part = np.s_[100:800, :900]  # the left half, without the bar of the time
    assert np.abs(first[scene_part] - second[scene_part]).max() > 50


@pytest.mark.slow
@pytest.mark.skipif(browser.CHROMIUM is None, reason="no chromium; apt-get install chromium")
def test_browser_draws_the_recording_and_time_moves(
    tmp_path, rollout, prediction, task, scene
) -> None:
    """As a user sees it: the served viewer in Chromium, then a click on the bar of the time."""
    path = write_recording(tmp_path / "01.rrd", rollout, prediction, task, scene, "trial 1")
    ports = viewer._free_port(), viewer._free_port()
    command = [viewer._executable(), "--serve-web", "--bind", "127.0.0.1"]
    command += ["--port", str(ports[0]), "--web-viewer-port", str(ports[1]), str(path)]
    served = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert viewer._listens(served, ports[1])
        with browser.page(tmp_path / "profile") as page:
            source = f"rerun%2Bhttp://127.0.0.1:{ports[0]}/proxy"
            page.open(f"http://127.0.0.1:{ports[1]}/?url={source}&theme=dark", 1200, 800)
            page.wait_for("document.readyState == 'complete'")
            playing = [drawn_picture(page) for _ in range(2)]
            assert playing[0] != playing[1]  # it opens playing
            page.press(" ")
            still = standing(page)
            page.click(400, 780)  # on the bar of the time, early
            early = standing(page)
            page.click(1000, 780)
            late = standing(page)
        assert early not in (still, late)
        assert not [problem for problem in page.problems if "panic" in problem]
    finally:
        served.kill()
        served.wait()


def drawn_picture(page, patience_s: float = 120) -> bytes:
    """A picture of the page once more than the empty viewer is to be seen."""
    deadline = time.monotonic() + patience_s
    while True:
        png = page.picture()
        colors, drawn = colors_and_drawn(png)
        if colors > 1500 and drawn > 0.05:
            return png
        assert time.monotonic() < deadline, (colors, drawn)
        time.sleep(1)


def standing(page, patience_s: float = 60) -> bytes:
    """A picture of the page once two in a row are equal."""
    deadline = time.monotonic() + patience_s
    before, png = b"", page.picture()
    while png != before:
        assert time.monotonic() < deadline
        time.sleep(1)
        before, png = png, page.picture()
    return png


@pytest.mark.slow
def test_damaged_recording_is_answered_with_a_sentence(tmp_path) -> None:
    path = tmp_path / "01.rrd"
    path.write_bytes(b"not a recording" * 20)
    with pytest.raises(RunFolderError, match="cannot be shown"):
        picture(path, tmp_path / "01.png", 0.0)


@pytest.mark.slow
def test_neither_rerun_nor_matplotlib_is_loaded_before_it_is_used() -> None:
    script = (
        "import sys, mcpilco.show\n"
        "assert not {'rerun', 'matplotlib', 'torch'} & set(sys.modules)\n"
        "assert mcpilco.show.write_recording.__name__ == 'write_recording'\n"
    )
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0


STAND_IN = """#!{python}
import os, pathlib, socket, sys, time
port = int(sys.argv[sys.argv.index("--web-viewer-port") + 1])
pathlib.Path("pid").write_text(str(os.getpid()))
sys.stderr.write(os.environ["RUST_LOG"])
sys.stderr.flush()
server = socket.create_server(("127.0.0.1", port))
time.sleep(60)
"""
WATCHER = """
import signal
from pathlib import Path
from mcpilco.show import viewer
signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # and so does what nohup began
viewer._executable = lambda: str(Path("rerun").resolve())
try:
    viewer.open_viewer(["01.rrd"], web=True, tell=lambda address: print(address, flush=True))
except KeyboardInterrupt:  # where it comes before the wait
    pass
"""


@pytest.mark.one_in(3)
@pytest.mark.xdist_group("viewer")  # two at a time may find the same port free
@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_the_viewer_ends_with_the_command(recording: Path, kind: signal.Signals) -> None:
    """Which prints the address alone; the stand-in for Rerun is told to keep its own log quiet."""
    folder = recording.parent
    (folder / "rerun").write_text(STAND_IN.format(python=sys.executable))
    (folder / "rerun").chmod(0o755)
    command = subprocess.Popen(
        [sys.executable, "-c", WATCHER],
        cwd=folder,
        env={name: value for name, value in os.environ.items() if name != "RUST_LOG"}
        | {"PYTHONPATH": str(Path(__file__).parents[3])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert command.stdout is not None
    address = command.stdout.readline()
    pid = int((folder / "pid").read_text())
    command.send_signal(kind)
    said, errors = command.communicate()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert (said, errors) == ("", "error")
    assert re.fullmatch(
        r"http://127.0.0.1:\d+\?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A\d+%2Fproxy\n", address
    )
    assert command.returncode == (0 if kind is signal.SIGINT else 128 + kind)
