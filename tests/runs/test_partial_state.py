from __future__ import annotations

import sys

import pytest


def test_settings_differ_in_the_estimator_alone(run):
    for _, config in run.SETTINGS.values():
        assert (config.model, config.search) == (run.DEFAULT.model, run.DEFAULT.search)
    modelled = {name: config.estimator.modelled for name, (_, config) in run.SETTINGS.items()}
    assert [name for name, is_modelled in modelled.items() if not is_modelled] == ["not-modelled"]
    assert run.SETTINGS["all-measured"] == (run.MEASURED, run.DEFAULT)


@pytest.mark.slow  # trains, if quickly
def test_run_trains_what_is_missing_and_writes_its_page(run, tmp_path, monkeypatch, capsys):
    arguments = ["run.py", "--quick", "--workers", "1", "--settings", "not-modelled"]
    monkeypatch.setattr(sys, "argv", [*arguments, "--out", str(tmp_path)])
    assert run.main() == 0
    text = (tmp_path / "README.md").read_text()
    assert "| `not-modelled`, one rollout | 1 | 0.0 (0–79) |" in text
    assert run.main() == 0
    assert "1 of 1 seeds are there already." in capsys.readouterr().out
