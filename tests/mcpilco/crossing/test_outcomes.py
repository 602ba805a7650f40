from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from envs import CartPoleSwingUpEnv
from mcpilco.crossing import (
    Crossing,
    Place,
    cross,
    outcomes,
    read_crossing,
    write_crossing,
)
from mcpilco.show.scene import Scene
from mcpilco.show.side_by_side import write_crossing_film
from mcpilco.typing import RunFolderError

ID = "mcpilco/CartPoleSwingUp-v0"
STEPS = 30


def pushing(force: float):
    """What makes a policy that always pushes alike."""
    return lambda: lambda observation: np.full((*np.shape(observation)[:-1], 1), force)


@pytest.fixture(scope="module")
def crossing() -> Crossing:
    hindered = {"effects": None, "cart_friction": 5.0}
    controllers = {1: pushing(10.0), 2: pushing(0.0), 3: pushing(-10.0)}
    return cross(controllers, Place(ID, {}), Place(ID, hindered), STEPS, seed=3, episodes=4)


def test_the_policy_is_chosen_by_its_own_simulation(
    crossing: Crossing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system, where another does better, has no say."""
    share = {("sim", 1): 0.2, ("sim", 2): 0.9, ("sim", 3): 0.5, ("real", 2): 0.1, ("real", 3): 1.0}

    def judged(begin, place, horizon, seed, episodes, kept=None):
        return replace(crossing.promised, success=share[place.kwargs["kind"], seed[1]])

    monkeypatch.setattr(outcomes, "judged", judged)
    monkeypatch.setattr(outcomes, "_task", lambda place: CartPoleSwingUpEnv().task)
    places = Place(ID, {"kind": "sim"}), Place(ID, {"kind": "real"})
    found = cross(dict.fromkeys((1, 2, 3), pushing(0.0)), *places, STEPS, seed=0, episodes=4)
    assert (found.trial, found.promised.success, found.happened.success) == (2, 0.9, 0.1)


def test_the_episode_that_is_kept_begins_alike_in_both_places(crossing: Crossing) -> None:
    np.testing.assert_array_equal(crossing.promised.states[0], crossing.happened.states[0])
    assert crossing.promised.states.shape == (STEPS + 1, 4)
    assert not np.array_equal(crossing.promised.states, crossing.happened.states)


def test_equal_seeds_give_equal_outcomes(crossing: Crossing) -> None:
    again = cross(
        {crossing.trial: pushing((10.0, 0.0, -10.0)[crossing.trial - 1])},
        Place(ID, {}),
        Place(ID, {"effects": None, "cart_friction": 5.0}),
        STEPS,
        seed=3,
        episodes=4,
    )
    np.testing.assert_array_equal(again.happened.states, crossing.happened.states)
    assert again.happened.returns == crossing.happened.returns


def test_success_counts_before_the_return(crossing: Crossing) -> None:
    poor = replace(crossing.promised, success=0.5, returns=0.0)
    rich = replace(crossing.promised, success=0.0, returns=20.0)
    assert poor.worth > rich.worth


def test_a_crossing_comes_back_from_its_file(crossing: Crossing, tmp_path: Path) -> None:
    path = tmp_path / "nominal.json"
    write_crossing(path, crossing)
    back = read_crossing(path)
    np.testing.assert_array_equal(back.happened.states, crossing.happened.states)
    np.testing.assert_array_equal(back.promised.inputs, crossing.promised.inputs)
    assert (back.trial, back.states, back.dt) == (crossing.trial, crossing.states, crossing.dt)
    assert back.promised.returns == crossing.promised.returns


@pytest.mark.parametrize("text", ["{}", '{"format": 2}', "[", '{"format": 1, "promised": 3}'])
def test_a_damaged_file_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "nominal.json").write_text(text)
    with pytest.raises(RunFolderError, match="damaged"):
        read_crossing(tmp_path / "nominal.json")


def test_the_film_holds_both_policies(crossing: Crossing, scene: Scene, tmp_path: Path) -> None:
    legs = {"nominal": crossing, "corrected": crossing}
    one = write_crossing_film(tmp_path / "one.rrd", {"nominal": crossing}, scene, "one")
    both = write_crossing_film(tmp_path / "both.rrd", legs, scene, "both")
    assert both.stat().st_size > one.stat().st_size > 0


@pytest.fixture
def scene() -> Scene:
    from envs.cartpole import CartPoleSwingUpEnv
    from envs.plants import cart_pole

    return CartPoleSwingUpEnv.scene_of(cart_pole())
