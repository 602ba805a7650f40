from __future__ import annotations

import json

import harness
import pytest
from harness import (
    BEGIN,
    END,
    costs,
    failures,
    fill,
    machines,
    marks,
    outcomes,
    read_summaries,
)

from mcpilco.typing import InputError

SPREAD = {"median": 30.0, "q1": 25.0, "q3": 35.04}
SUMMARY = {
    "trials": [{}, {}],
    "failed": {"7": "it was killed"},
    "run": dict.fromkeys(("starts", "policy_steps", "cpu_s", "wall_s"), SPREAD),
    "by_seed": {
        "0": {"success": [False, True], "p": [0.25, 0.75]},
        "1": {"success": [True, False], "p": [0.25, 0.75]},
    },
    "machines": [{"cpu": "Zen", "cores": 2, "versions": {"python": "3.11"}}],
}


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "README.md"
    path.write_text(f"# Mine\n\n{BEGIN}\nold\n{END}\n\n## Differs\n\nMy words.\n")
    return path


def test_only_what_is_between_the_marked_lines_is_rewritten(page):
    fill(page, ["one\n", "", "two"])
    expected = f"# Mine\n\n{BEGIN}\n\none\n\ntwo\n\n{END}\n\n## Differs\n\nMy words.\n"
    assert page.read_text() == expected
    fill(page, ["one", "two"])
    assert page.read_text() == expected


def test_a_part_is_rewritten_by_its_name_and_the_others_stay(tmp_path: Path) -> None:
    path = tmp_path / "README.md"
    begin, end = marks("comparison")
    path.write_text(f"{BEGIN}\nold\n{END}\n{begin}\nold too\n{end}\n")
    fill(path, ["new"], name="comparison")
    assert path.read_text() == f"{BEGIN}\nold\n{END}\n{begin}\n\nnew\n\n{end}\n"


@pytest.mark.parametrize("text", ["# Mine\n", f"{END}\n{BEGIN}\n", f"{BEGIN}\n{BEGIN}\n{END}\n"])
def test_page_without_both_lines_in_order_is_refused_and_kept(page, text):
    page.write_text(text)
    with pytest.raises(InputError, match="must hold the lines"):
        fill(page, ["one"])
    assert page.read_text() == text


def test_a_page_begins_as_its_template_which_stays(page, tmp_path):
    template, other = page.read_text(), tmp_path / "other.md"
    fill(other, ["one"], template=page)
    assert other.read_text() == template.replace("\nold\n", "\n\none\n\n")
    assert page.read_text() == template
    other.write_text(f"# Other\n{BEGIN}\n{END}\n")
    fill(other, ["one"], template=page)
    assert other.read_text().startswith("# Other\n")


def test_only_sweeps_with_a_summary_are_read_in_the_order_of_their_names(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(json.dumps({"seeds": [name]}))
    found = read_summaries(tmp_path, ("b", "missing", "a"))
    assert list(found.items()) == [("b", {"seeds": ["b"]}), ("a", {"seeds": ["a"]})]


def test_costs_are_medians_and_quartiles_of_each_preset():
    assert "| `a` | 2 | 30.0 (25.0–35.0) |" in costs({"a": SUMMARY})
    assert "| `a` |" not in costs({"a": {**SUMMARY, "trials": []}})


def test_failures_name_seeds_whose_last_rollout_failed_and_those_that_broke_off():
    text = failures({"a": SUMMARY})
    assert "- `a`, last test rollout: 1 (p 0.75)\n" in text
    assert "- `a`, seed 7 broke off: it was killed" in text
    solved = {**SUMMARY, "by_seed": {"0": SUMMARY["by_seed"]["0"]}}
    assert "- `a`, last test rollout: none\n" in failures({"a": solved})


def test_a_machine_is_named_once_with_the_presets_that_ran_on_it():
    text = machines({"a": SUMMARY, "b": SUMMARY})
    assert text.count("Zen") == 1
    assert "- `a`, `b`: Zen, 2 cores; python 3.11" in text


def test_outcomes_have_a_column_a_trial_and_leave_out_what_the_env_does_not_tell():
    share = {"rate": 0.5, "mean": 0.25, "low": 0.1, "high": 0.9}
    told = {
        **dict.fromkeys(("success", "p"), share),
        **dict.fromkeys(("time_up_s", "predicted_cost", "real_cost"), SPREAD),
        "mean_abs_cart_m": None,
    }
    text = outcomes({"trials": [{"experience_s": time, **told} for time in (2.5, 5.0)]})
    assert "| after | 2.5 s | 5 s |" in text
    assert "| success of one rollout a policy [%] | 50.0 (10–90) | 50.0 (10–90) |" in text
    assert "| p over fresh rollouts of each policy [%] | 25.0 (10–90) | 25.0 (10–90) |" in text
    assert "| real cost [-] | 30.0 (25.0–35.0) | 30.0 (25.0–35.0) |" in text
    assert "cart" not in text


def test_a_result_that_is_there_is_not_made_again(tmp_path, monkeypatch):
    made, path = [], tmp_path / "0001.json"
    monkeypatch.setattr(harness, "keep", lambda path, found, run: path.write_text(str(found)))

    def make(seed, size):
        made.append((seed, size))
        return {"seed": seed}

    assert harness.once(path, "gip", make, 1, 2) == {"seed": 1}
    assert harness.once(path, "gip", make, 1, 2) is None
    assert made == [(1, 2)]
    assert path.read_text() == "{'seed': 1}"
