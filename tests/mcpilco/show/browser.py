"""A page in headless Chromium, driven through its DevTools pipe: load, press keys, look."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
"""None where there is none"""


class Page:
    """One page; commands and answers are JSON objects that end with a zero byte."""

    def __init__(self, reader: Any, writer: Any) -> None:
        self._reader, self._writer = reader, writer
        self._count = 0
        self._session: str | None = None
        self.problems: list[str] = []
        """what the page's console called an error, and its uncaught exceptions"""
        self.requests: list[str] = []
        """addresses that the page asked for"""

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """The answer to a command; events that come before it are kept."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._writer.write(json.dumps(message).encode() + b"\0")
        self._writer.flush()
        while (answer := self._read()).get("id") != self._count:
            self._note(answer)
        assert "error" not in answer, answer["error"]
        return answer["result"]

    def open(self, address: str, width: int = 1200, height: int = 800) -> None:
        size = {"width": width, "height": height}
        made = self.call("Target.createTarget", url="about:blank", newWindow=True, **size)
        answer = self.call("Target.attachToTarget", targetId=made["targetId"], flatten=True)
        self._session = answer["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setDeviceMetricsOverride", deviceScaleFactor=1, mobile=False, **size)
        self.call("Page.navigate", url=address)

    def ask(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    def wait_for(self, expression: str, patience_s: float = 60.0) -> None:
        """Until a JavaScript expression is true."""
        deadline = time.monotonic() + patience_s
        while not self.ask(expression):
            assert time.monotonic() < deadline, f"{expression} does not become true"
            time.sleep(0.1)

    def picture(self, whole: bool = False) -> bytes:
        """What is to be seen, as PNG; or the whole page, however long."""
        answer = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        return base64.b64decode(answer["data"])

    def click(self, x: float, y: float) -> None:
        at = {"x": x, "y": y, "button": "left", "clickCount": 1}
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, **at)

    def press(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            code = {" ": "Space"}.get(key, key)
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, text=key)

    def _read(self) -> dict[str, Any]:
        content = bytearray()
        while (byte := self._reader.read(1)) != b"\0":
            assert byte, "Chromium has ended"
            content += byte
        return json.loads(content)

    def _note(self, event: dict[str, Any]) -> None:
        params = event.get("params", {})
        if event.get("method") == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        if event.get("method") == "Runtime.exceptionThrown":
            self.problems.append(str(params["exceptionDetails"].get("text")))
        if event.get("method") == "Runtime.consoleAPICalled" and params["type"] == "error":
            self.problems.append(" ".join(str(a.get("value")) for a in params["args"]))


@contextmanager
def page(folder: Path) -> Iterator[Page]:
    """An empty page; the browser keeps its files in `folder`."""
    assert CHROMIUM is not None
    to_browser, ours = os.pipe()
    theirs, from_browser = os.pipe()
    flags = ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    flags += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    quoted = " ".join([CHROMIUM, *flags, "--remote-debugging-pipe", f"--user-data-dir={folder}"])
    # Chromium reads commands from file descriptor 3 and answers on 4.
    command = f"exec {quoted} 3<&{to_browser} 4>&{from_browser}"
    browser = subprocess.Popen(
        ["bash", "-c", command], pass_fds=(to_browser, from_browser), stderr=subprocess.DEVNULL
    )
    for end in (to_browser, from_browser):
        os.close(end)
    try:
        with os.fdopen(theirs, "rb") as reader, os.fdopen(ours, "wb") as writer:
            yield Page(reader, writer)
    finally:
        browser.kill()
        browser.wait()
