"""`runs/crossing_the_gap`: what seeds hide, and what the page says of results."""

from __future__ import annotations

import copy
import json
import math

import gymnasium as gym
import numpy as np
import pytest
from harness import BEGIN, END

import envs  # noqa: F401  registers its ids
from mcpilco.config import CART_POLE

TRANSFER = {"promised": 1.0, "happened": 0.05, "return": 9.0, "experience_s": 0.0, "cpu_s": 60.0}
LEARNED = {"experience_s": [3.0, 6.0, 9.0], "p": [0.0, 0.2, 0.95], "cpu_s": 20.0}


@pytest.fixture
def results(run, tmp_path):
    """Two seeds: one that is done, one with its first leg."""
    folder = tmp_path / "results" / "seeds"
    folder.mkdir(parents=True)
    done, begun = run.begun(0), run.begun(1)
    crossed = {**TRANSFER, "verdict": "named", "named": ["coulomb_friction at cart"]}
    done["legs"] = {
        "a": crossed,
        "b": {**crossed, "happened": 0.98},
        "c": LEARNED,
        "d": {**LEARNED, "p": [0.97, 1.0, 1.0]},
        "e": {"nominal": crossed, "corrected": {**crossed, "happened": 0.9, "experience_s": 60.0}},
    }
    begun["legs"] = {"a": copy.deepcopy(crossed)}
    for seed, content in enumerate((done, begun)):
        (folder / f"{seed:04d}.json").write_text(json.dumps(content))
    return tmp_path


@pytest.mark.parametrize("seed", range(6))
def test_what_a_seed_hides_makes_another_system(run, seed):
    hidden = run.begun(seed)["hidden"]
    assert hidden == run.begun(seed)["hidden"]
    motions = []
    for effects in (None, hidden):
        env = gym.make(CART_POLE, effects=effects)
        env.reset(seed=0)
        for _ in range(10):
            *_, info = env.step(np.array([10.0], dtype=np.float32))
        motions.append(info["state"])
        env.close()
    assert np.linalg.norm(motions[0] - motions[1]) > 0.1


def test_kinds_take_turns(run):
    kinds = [run.begun(seed)["kind"] for seed in range(6)]
    assert kinds[:3] == kinds[3:]
    assert set(kinds) == set(run.KINDS)


def test_solved_is_the_experience_behind_the_first_good_policy(run):
    assert run.pages.solved(LEARNED) == 9.0
    assert run.pages.solved({**LEARNED, "p": [0.0, 0.2, 0.8]}) == math.inf


def test_page_holds_every_leg_and_every_seed(run, results):
    run.pages.write(results)
    text = (results / "README.md").read_text().split(BEGIN)[1].split(END)[0]
    assert (results / "crossing.png").read_bytes().startswith(b"\x89PNG")
    assert "| a: MC-PILCO in the nominal simulation | 2 |" in text
    assert "| b: MC-PILCO in the corrected simulation | 1 | 100 (100–100) | 98 (98–98) |" in text
    assert "| c: from nothing | 1 | 0 (0–0) | 20 (20–20) | 95 (95–95) | 9 (1) |" in text
    assert "| d: corrected simulation as prior mean | 1 | 97 (97–97) |" in text
    assert "| e: SAC in the nominal simulation | 1 | 100 (100–100) | 5 (5–5) |" in text
    assert "| e: SAC in the corrected simulation | 1 | 100 (100–100) | 90 (90–90) |" in text
    assert "| friction and lag | 1 | 5 (5–5) | 98 (98–98) | 90 (90–90) | 95 (95–95) |" in text
    assert "| stiction and delay | 1 | 5 (5–5) |  |  |  |  |" in text
    assert "coulomb_friction at cart | 5 | 98 | 90 | 9 | 3 |" in text


def test_story_says_what_each_leg_took_of_the_system(run, results):
    found = [json.loads(path.read_text()) for path in (results / "results" / "seeds").iterdir()]
    rows = run.pages.story(found).splitlines()[2:]
    assert rows == [
        "| in the nominal simulation | 2 | 100 | 5 (5–5) | 0 of 2 | 0 |",
        "| in the corrected simulation | 1 | 100 | 98 (98–98) | 1 of 1 | 0 |",
        "| in the nominal simulation, by SAC | 1 | 100 | 5 (5–5) | 0 of 1 | 0 |",
        "| in the corrected simulation, by SAC | 1 | 100 | 90 (90–90) | 1 of 1 | 60 |",
        "| on the system, from nothing | 1 |  | 95 (95–95) | 1 of 1 | 9 |",
        "| on the system, with the corrected simulation's equations | 1 |  "
        "| 100 (100–100) | 1 of 1 | 60 and 9 |",
    ]


def test_page_without_results_says_so(run, tmp_path):
    run.pages.write(tmp_path)
    assert "Not measured yet." in (tmp_path / "README.md").read_text()
