from __future__ import annotations

import sys

import pytest

PUSHED = (6.5, 7.7), (11.0, 12.5), (16.0, 16.5)
"""when a hand pushes in `pendulum_energy` [s], by the file's description"""
TIMING = {"actuator_delay", "actuator_lag", "sensor_delay"}


@pytest.mark.slow
def test_friction_timing_and_pushes_of_a_real_pendulum_are_found(run, data, tmp_path, monkeypatch):
    folder = data / "dfki_pendulum"
    words = ["run.py", "--data", str(folder), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    assert run.main() == 0
    assert "Verdict: **named**" in (tmp_path / "README.md").read_text()
    gap = run.find(folder, 0.02)
    names = {named.name for named in gap.named}
    assert "coulomb_friction" in names
    assert names & TIMING
    assert gap.comparison is not None
    assert gap.comparison.corrected < 0.4 * gap.comparison.refit
    left_out = [event for event in gap.events if event.recording == "pendulum_energy"]
    for a, b in PUSHED:
        assert any(a < event.end_s and event.start_s < b for event in left_out)
    for event in left_out:
        assert any(a < event.end_s and event.start_s < b for a, b in PUSHED)
