"""Look at recordings: Rerun's viewer in a window, in a browser, or as a picture."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn
from urllib.parse import quote

from mcpilco.files import write_bytes
from mcpilco.show.blueprint import TIMELINE
from mcpilco.typing import InputError, RunFolderError

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

logger = logging.getLogger(__name__)

_LOCALHOST = "127.0.0.1"
"""every server is bound here; Rerun's own default, 0.0.0.0, shows recordings to the network"""
_PORT, _WEB_PORT = 9876, 9090
"""Rerun's usual ports; others are taken where these are in use"""
_START_S = 30.0
"""how long the viewer may take to listen [s]"""
_SETTLE_S = 30.0
"""how long a picture may take to stand still [s]"""


Tell = Callable[[str], object]
"""is called with the address for a browser, once the viewer listens there"""


def open_viewer(
    paths: Sequence[str | Path], *, web: bool = False, tell: Tell = logger.info
) -> None:
    """Show recordings until the viewer is closed; in a browser, until Ctrl-C.

    With `web` it serves the viewer to a browser on this machine, instead of opening a window;
    `tell` gets the address.

    Raises:
        RunFolderError: a file is missing.
        InputError: there is no display to open a window on, or the viewer does not start.
    """
    files = [str(_existing(path)) for path in paths]
    with _viewer(web, files, tell) as (viewer, _):
        _wait(viewer)


@contextlib.contextmanager
def live_viewer(*, web: bool = False, tell: Tell = logger.info) -> Iterator[LiveViewer]:
    """A viewer that waits for what is streamed to it; it ends with the context.

    Arguments are those of `open_viewer`.

    Raises:
        InputError: there is no display to open a window on, or the viewer does not start.
    """
    with _viewer(web, [], tell) as (viewer, port):
        if not _listens(viewer, port):
            raise InputError(f"The Rerun viewer does not listen on {_LOCALHOST}:{port}.")
        yield LiveViewer(viewer, f"rerun+http://{_LOCALHOST}:{port}/proxy")


@dataclass(frozen=True)
class LiveViewer:
    """A viewer that is open."""

    process: subprocess.Popen
    """the viewer"""
    url: str
    """where `rerun.RecordingStream.connect_grpc` sends to"""

    @property
    def closed(self) -> bool:
        """Whether the user has closed it."""
        return self.process.poll() is not None

    def wait(self) -> None:
        """Until the viewer is closed; in a browser, until Ctrl-C."""
        _wait(self.process)


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Lets SIGTERM and SIGHUP end the context as SystemExit, so that what it began ends with it."""

    def end(number: int, _: object) -> NoReturn:
        raise SystemExit(128 + number)

    kinds: list[int] = []
    if threading.current_thread() is threading.main_thread():  # no other may ask for signals
        asked = (signal.SIGTERM, signal.SIGHUP)
        kinds = [kind for kind in asked if signal.getsignal(kind) is signal.SIG_DFL]
    for kind in kinds:
        signal.signal(kind, end)
    try:
        yield
    finally:
        for kind in kinds:
            signal.signal(kind, signal.SIG_DFL)


@contextlib.contextmanager
def _viewer(web: bool, files: Sequence[str], tell: Tell) -> Iterator[tuple[subprocess.Popen, int]]:
    """A viewer in a window or for a browser, and the port that it takes recordings on."""
    if not web and not has_display():
        raise InputError(
            "The viewer needs a display, and neither DISPLAY nor WAYLAND_DISPLAY is set; "
            "use --web to look with a browser, or --screenshot to write a picture."
        )
    port = _free_port(_PORT)
    command = [_executable(), "--bind", _LOCALHOST, "--port", str(port)]
    web_port = _free_port(_WEB_PORT)
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port)]
    quiet = {"RUST_LOG": "error", **os.environ}
    with ended_by_signals():
        # In a session of its own, so that Ctrl-C ends the viewer after what streams to it.
        viewer = subprocess.Popen([*command, *files], start_new_session=True, env=quiet)
        try:
            if web and _listens(viewer, web_port):
                source = quote(f"rerun+http://{_LOCALHOST}:{port}/proxy", safe="")
                tell(f"http://{_LOCALHOST}:{web_port}?url={source}")
            yield viewer, port
        finally:
            viewer.terminate()
            viewer.wait()


def _wait(viewer: subprocess.Popen) -> None:
    try:
        code = viewer.wait()
    except KeyboardInterrupt:
        return
    if code != 0:
        raise InputError(f"The Rerun viewer ended with code {code}; its own message is above.")


def screenshot(path: str | Path, png: str | Path, at_s: float) -> Path:
    """The path of a picture of a recording at one instant, 1920 x 1080; needs no display.

    Raises:
        RunFolderError: the recording is missing or damaged, or the picture cannot be written.
        InputError: the viewer does not start; most often no graphics driver is installed.
    """
    recording, png = _existing(path), Path(png)
    try:
        with tempfile.TemporaryDirectory() as folder, _headless(Path(folder)) as client:
            picture = _picture(client, recording, at_s)
    except (ConnectionError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise RunFolderError(
            f"The recording {recording} cannot be shown ({reason}); record it again."
        ) from error
    with contextlib.suppress(OSError):  # the writing then says what is wrong
        png.parent.mkdir(parents=True, exist_ok=True)
    return write_bytes(png, picture)


def _picture(client: ViewerClient, recording: Path, at_s: float) -> bytes:
    """The recording at one instant, without the viewer's menu and list.

    Views load after the recording does, so it is taken until two pictures in a row are equal.
    """
    if not client.open(str(recording)).store_ids:
        raise ConnectionError("it holds nothing that Rerun can read")
    client.set_time(TIMELINE, duration=at_s, play_state="paused")
    for panel in ("top", "blueprint"):
        client.run_command(f"ui.toggle_{panel}_panel")
    deadline = time.monotonic() + _SETTLE_S
    before, picture = b"", client.take_screenshot()
    while picture != before and time.monotonic() < deadline:
        time.sleep(0.3)
        before, picture = picture, client.take_screenshot()
    return picture


@contextlib.contextmanager
def _headless(folder: Path) -> Iterator[ViewerClient]:
    """A client of a viewer without a window, which keeps its files in `folder`."""
    from rerun.experimental import ViewerClient

    port = _free_port()
    command = [_executable(), "--headless", "--bind", _LOCALHOST, "--port", str(port)]
    # No question about analytics, no notices over the picture, no files left behind.
    quiet = {"RERUN_APP_ONLY": "true", "RUST_LOG": "error", "TMPDIR": str(folder)}
    log = folder / "viewer.log"
    with log.open("wb") as sink:
        viewer = subprocess.Popen(command, stdout=sink, stderr=sink, env={**os.environ, **quiet})
    try:
        if not _listens(viewer, port):
            raise _no_graphics(log)
        yield ViewerClient.connect(f"rerun+http://{_LOCALHOST}:{port}/proxy")
    except (ConnectionError, RuntimeError) as error:
        if _ends(viewer):
            raise _no_graphics(log) from error
        raise
    finally:
        viewer.kill()
        viewer.wait()


def _no_graphics(log: Path) -> InputError:
    said = log.read_text(errors="replace").partition("stack backtrace")[0].split()
    return InputError(
        "The Rerun viewer does not run without a window; it needs a graphics driver, be it in "
        "software: on Debian, apt-get install mesa-vulkan-drivers. "
        f"It said: {' '.join(said) or 'nothing'}"
    )


def _ends(viewer: subprocess.Popen) -> bool:
    """Whether the viewer has broken down, or does within a moment."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        viewer.wait(timeout=2)
    return viewer.poll() is not None


def _listens(viewer: subprocess.Popen, port: int) -> bool:
    """Wait until the viewer accepts connections; False when it ends first or takes too long."""
    deadline = time.monotonic() + _START_S
    while viewer.poll() is None and time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex((_LOCALHOST, port)) == 0:
                return True
        time.sleep(0.1)
    return False


def _executable() -> str:
    """Rerun's own binary, by its absolute path: the folder of this Python need not be on PATH."""
    spec = find_spec("rerun_cli")
    name = "rerun.exe" if os.name == "nt" else "rerun"
    folders = (spec.submodule_search_locations if spec else None) or []
    for candidate in (
        *(Path(folder) / name for folder in folders),
        Path(sys.executable).with_name(name),
    ):
        if candidate.is_file():
            return str(candidate)
    raise InputError("The Rerun viewer is not installed; run: pip install rerun-sdk")


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_file():
        raise RunFolderError(
            f"There is no recording at {path}; name an .rrd file, or the run that holds it."
        )
    return path.resolve()


def has_display() -> bool:
    """Whether a window can be opened."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return sys.platform in ("win32", "darwin") or bool(named)


def _free_port(preferred: int = 0) -> int:
    """The preferred port where it is free, else any that is."""
    for port in (preferred, 0):
        with socket.socket() as probe:
            try:
                probe.bind((_LOCALHOST, port))
            except OSError:
                continue
            return probe.getsockname()[1]
    raise InputError(f"No port is free on {_LOCALHOST}; close other viewers.")
