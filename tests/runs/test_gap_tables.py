from __future__ import annotations

from dataclasses import replace

from gap_tables import effects_table, errors_table, events_table, steps_table

from mcpilco.gap import Event, Gap


def test_the_tables_tell_what_was_found(found: Gap) -> None:
    assert "Verdict: **named**" in effects_table(found)
    assert "| coulomb_friction | pendulum | f_c = " in effects_table(found)
    assert found.comparison is not None
    told = found.comparison.channels["angle"]
    less = 100.0 * (1.0 - told["corrected"] / told["refit"])
    assert f"| {told['corrected']:.4f} |" in errors_table(found)
    assert f"| {less:.0f} |" in errors_table(found)
    assert steps_table(found).count("\n| ") == 2 + len(found.comparison.steps)


def test_events_are_listed_where_there_are_any(found: Gap) -> None:
    assert events_table(found) == "Nothing was left out as an event."
    pushed = replace(found, events=(Event("recording_1", 4.0, 4.7),))
    assert "| recording_1 | 4.0 | 4.7 |" in events_table(pushed)
