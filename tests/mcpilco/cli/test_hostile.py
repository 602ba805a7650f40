"""Commands that read a run folder import no module that lies in it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import mcpilco.agent.agent
from mcpilco.cli import main
from tests.mcpilco.fakes import FakeAgent

NAMES = ("evilm:X-v0", "run.evilm:X-v0", "run.inner.evilm:X-v0")
COMMANDS = (
    ["view", "run", "--screenshot", "picture.png"],
    ["view", "run", "other", "--screenshot", "picture.png"],
    ["record", "--policy", "run", "--out", "recordings"],
    ["evaluate", "run", "--episodes", "1"],
    ["train", "--resume", "run", "--trials", "9", "--quiet"],
    ["report", "run"],
    ["compare", "run", "--out", "tables"],
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two short runs."""
    path = tmp_path_factory.mktemp("hostile")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcpilco.agent.agent, "MCPILCO", FakeAgent)
        for name in ("run", "other"):
            out = str(path / name)
            assert main(["train", "--trials", "2", "--quiet", "--out", out]) == 0
    return path


@pytest.mark.parametrize("field", ["env", "algo"])
@pytest.mark.parametrize("name", NAMES)
def test_no_module_of_a_run_folder_is_imported(
    runs: Path, monkeypatch: pytest.MonkeyPatch, field: str, name: str
) -> None:
    """Neither beside config.json, from where the user works in the folder, nor below it."""
    run, marker = runs / "run", runs / "executed"
    config = json.loads((run / "config.json").read_text())
    monkeypatch.setattr(mcpilco.agent.agent, "MCPILCO", FakeAgent)
    monkeypatch.setattr(sys, "path", [*sys.path, str(run)])
    monkeypatch.setattr("mcpilco.show.viewer.screenshot", lambda *_: runs / "picture.png")
    monkeypatch.chdir(runs)
    (run / "inner").mkdir(exist_ok=True)
    for folder in (run, run / "inner"):
        (folder / "evilm.py").write_text(f"open({str(marker)!r}, 'w').close()")
    try:
        (run / "config.json").write_text(json.dumps({**config, field: name}))
        export = ["export", "run", "policy.npz"]  # it makes no env
        for command in (*COMMANDS, *([export] if field == "algo" else [])):
            main(command)
            assert not marker.exists(), command
    finally:
        (run / "config.json").write_text(json.dumps(config))
        marker.unlink(missing_ok=True)
