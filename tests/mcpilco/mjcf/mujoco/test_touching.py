"""Where recorded machines touch something, and what `mcpilco gap` makes of it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import mcpilco.gap
from mcpilco.cli import main
from mcpilco.mjcf import MujocoPlant, spans_touching
from mcpilco.plant import ChainPlant
from mcpilco.typing import InputError

RAIL = """
<mujoco model="rail">
  <option timestep="0.005"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" range="-0.5 0.5" limited="true"/>
      <geom type="box" size="0.1 0.05 0.05" mass="0.5"/>
      <body name="rod">
        <joint name="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="rail" gear="1"/></actuator>
</mujoco>
"""
DT = 0.02


@pytest.fixture
def rail(tmp_path: Path) -> Path:
    path = tmp_path / "rail.xml"
    path.write_text(RAIL)
    return path


def moved(push: float, once: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Readings and forces of a cart that is pushed there and back, and for half a second once."""
    model = mujoco.MjModel.from_xml_string(RAIL)
    data, rows, forces = mujoco.MjData(model), [], []
    for k in range(400):
        rows.append([data.qpos[0], data.qvel[0], data.qpos[1], data.qvel[1]])
        data.ctrl[0] = push * np.sin(2.0 * k * DT) - 0.5 * data.qpos[0] - 0.2 * data.qvel[0]
        data.ctrl[0] += once * (200 <= k < 225)
        forces.append(data.ctrl[0])
        for _ in range(4):
            mujoco.mj_step(model, data)
    return np.array(rows), np.array(forces)


def logged(tmp_path: Path, states: np.ndarray, forces: np.ndarray) -> Path:
    names = ["rail_position", "rail_velocity", "hinge_position", "hinge_velocity", "motor"]
    table = np.column_stack([DT * np.arange(len(states)), states, forces])
    path = tmp_path / "log.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(["time", *names]), comments="")
    return path


def test_no_time_at_an_end_is_outside_of_the_spans(rail: Path) -> None:
    states, _ = moved(2.0)
    t = DT * np.arange(len(states))
    spans = spans_touching(rail, t, {"rail": states[:, 0], "hinge": states[:, 2]})
    inside = np.any([(t > a) & (t < b) for a, b in spans], axis=0)
    stopped = np.abs(states[:, 0]) > 0.5
    assert stopped.any()
    assert inside[stopped].all()
    assert inside.mean() < 0.5


def test_a_stop_between_two_samples_is_seen_by_the_speed_before_and_after(rail: Path) -> None:
    q = np.array([0.3, 0.38, 0.46, 0.44, 0.36, 0.28])  # it turned at 0.5, somewhere in between
    t = DT * np.arange(len(q))
    assert spans_touching(rail, t, {"rail": q}) == ((t[1], t[4]),)
    assert spans_touching(rail, t, {"rail": q - 0.05}) == ()


def test_a_body_touches_where_mujoco_has_a_contact(rail: Path) -> None:
    floor = '<worldbody><geom type="plane" size="2 2 1" pos="0 0 -0.3"/>'
    rail.write_text(RAIL.replace("<worldbody>", floor))
    t = DT * np.arange(101)
    lifted = np.linspace(0.0, 0.5 * np.pi, 101)  # the rod's end is 0.4 cos(angle) + 0.02 below it
    ((begin, end),) = spans_touching(rail, t, {"rail": np.zeros(101), "hinge": lifted})
    assert begin == 0.0
    assert lifted[round(end / DT)] == pytest.approx(np.arccos(0.28 / 0.4), abs=0.04)


def test_what_has_no_ends_or_was_not_recorded_is_at_none(rail: Path) -> None:
    t = DT * np.arange(50)
    assert spans_touching(rail, t, {"hinge": 3.0 * t}) == ()
    assert (
        spans_touching(rail, t, {"rail": np.full(50, np.nan)}) == spans_touching(rail, t, {}) == ()
    )
    with pytest.raises(InputError, match="must be an MJCF or a URDF file"):
        spans_touching(rail.with_name("none.xml"), t, {})


class AskedError(Exception):
    """It carries the plant and the recordings that would have been investigated."""


@pytest.fixture
def asked(rail: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The plant and the recording that the command would investigate."""

    def investigate(plant, recordings, **how):
        raise AskedError(plant, recordings)

    def ask(states: np.ndarray, forces: np.ndarray, *more: str):
        log, out = logged(tmp_path, states, forces), tmp_path / "out"
        with pytest.raises(AskedError) as caught:
            main(["gap", str(log), "--plant", str(rail), "--out", str(out), "--accept", *more])
        plant, (recording,) = caught.value.args
        return plant, recording

    monkeypatch.setattr(mcpilco.gap, "investigate", investigate)
    return ask


def test_a_machine_above_a_table_that_it_never_touches_is_compared_by_equations(
    rail: Path, asked, capsys: pytest.CaptureFixture[str]
) -> None:
    table = '<worldbody><geom type="plane" size="2 2 1" pos="0 0 {}"/>'
    for height, kind in ((-1.0, ChainPlant), (-0.38, MujocoPlant)):
        rail.write_text(RAIL.replace("<worldbody>", table.format(height)))
        states, forces = moved(0.2)
        plant, recording = asked(states, forces)
        assert isinstance(plant, kind)
        assert not recording.gaps
    assert "100% of the recordings the machine touches" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("pushes", "more", "kind", "says"),
    [
        ((0.2, 0.0), (), ChainPlant, ""),
        ((0.2, 2.0), (), ChainPlant, "has: left out."),
        (
            (6.0, 0.0),
            (),
            MujocoPlant,
            "has: MuJoCo is taken.",
        ),
        ((6.0, 0.0), ("--physics", "equations"), ChainPlant, "has: kept."),
    ],
    ids=["never there", "now and then", "often", "often, and equations asked for"],
)
def test_equations_are_compared_where_nothing_is_touched_and_mujoco_where_that_is_rare(
    pushes: tuple[float, float],
    more: tuple[str, ...],
    kind: type,
    says: str,
    asked,
    capsys: pytest.CaptureFixture[str],
) -> None:
    states, forces = moved(*pushes)
    plant, recording = asked(states, forces, *more)
    assert isinstance(plant, kind)
    said = capsys.readouterr().err
    assert (says in said) if says else ("touches" not in said)
    assert bool(recording.gaps) == ("left out" in says)
    if recording.gaps:
        beyond = np.abs(states[:, 0]) > 0.5
        assert np.isnan(recording.states[beyond]).all()


def test_recordings_that_are_too_short_to_be_followed_are_not_told_to_touch_something(
    asked, capsys: pytest.CaptureFixture[str]
) -> None:
    states, forces = moved(0.2)
    plant, _ = asked(states[:50], forces[:50])
    assert isinstance(plant, ChainPlant)
    assert "touches" not in capsys.readouterr().err
