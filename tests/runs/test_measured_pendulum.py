from __future__ import annotations

import sys

import pytest

PUSHED = (6.5, 7.7), (11.0, 12.5), (16.0, 16.5)
"""when a hand pushes in `pendulum_energy` [s], by the file's description"""


@pytest.mark.slow
def test_dry_friction_of_a_real_pendulum_is_named_and_helps_on_a_recording_not_seen(
    run, data, tmp_path, monkeypatch
):
    folder = data / "dfki_pendulum"
    words = ["run.py", "--data", str(folder), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    assert run.main() == 0
    page = (tmp_path / "README.md").read_text()
    assert "Verdict: **named**" in page
    assert "coulomb_friction" in page
    gap = run.find(folder, 0.02)
    assert gap.comparison is not None
    assert gap.comparison.corrected < 0.5 * gap.comparison.refit
    left_out = [event for event in gap.events if event.recording == "pendulum_energy"]
    last = PUSHED[-1]
    assert any(last[0] < event.end_s and event.start_s < last[1] for event in left_out)
    for event in left_out:  # what is left out follows a push
        assert any(a < event.end_s and event.start_s < b + 2.0 for a, b in PUSHED)
