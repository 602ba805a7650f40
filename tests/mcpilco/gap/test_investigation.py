"""The whole workflow on recordings with a hidden effect."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import envs
import mcpilco.gap
from mcpilco.cli import main
from mcpilco.gap import Gap, investigate, investigation
from mcpilco.gap.comparison import Comparison
from mcpilco.gap.data import Event, GapProblem, Windows
from mcpilco.gap.decide import Weighed
from mcpilco.gap.disturbance import Evidence
from mcpilco.gap.fit import fit_nominal
from mcpilco.gap.report import summary, to_json
from mcpilco.gap.search import SearchResult
from mcpilco.gap.thresholds import VERDICT
from mcpilco.mjcf import mjcf_of_plant, plant_of
from mcpilco.plant import Plant, Spread
from mcpilco.recordings import Recording, write_recording
from mcpilco.typing import InputError
from tests.mcpilco.gap import machines
from tests.mcpilco.gap.pendulum import STD, dry_friction, hidden, record
from tests.mcpilco.gap.pushed import HIDDEN_FRICTION

PLANT = envs.PLANTS["mcpilco/Pendulum-v0"]


def nothing(q: float, v: float) -> float:
    return 0.0


def recordings(seed: int) -> tuple[str, dict[str, float], list[Recording]]:
    rng = np.random.default_rng(seed)
    name, parameters, force = hidden(rng)
    return name, parameters, [record(rng, force, number) for number in range(4)]


def test_a_hidden_friction_is_named_with_its_size(found: Gap) -> None:
    assert found.verdict == "named"
    (named,) = found.named
    assert (named.name, named.target) == ("coulomb_friction", "pendulum")
    size = named.parameters["f_c"]
    assert size.value == pytest.approx(HIDDEN_FRICTION, rel=0.05)
    assert size.low < HIDDEN_FRICTION < size.high
    assert found.comparison is not None
    assert found.comparison.closed.value > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["Pendulum", "CartPoleSwingUp"])
def test_samples_may_be_a_tenth_of_a_second_apart(machine: str) -> None:
    """That is how the cart-pole's env is recorded; a motor is too weak, or acts the other way."""
    plant = envs.PLANTS[f"mcpilco/{machine}-v0"]()
    name = {"Pendulum": "pendulum", "CartPoleSwingUp": "cart_pole"}[machine]
    (gain,) = investigate(plant, machines.recorded(name, 0, gain=0.8, dt=0.1)).named
    assert gain.name == "actuator_gain"
    assert gain.parameters["k"].low < 0.8 < gain.parameters["k"].high
    assert gain.parameters["k"].value == pytest.approx(0.8, rel=0.02)
    turned = machines.recorded(name, 0, gain=-1.0, dt=0.1)
    with pytest.raises(InputError, match=f"negate {plant.layout.inputs[0]}?"):
        investigate(plant, turned)
    assert investigate(plant, turned, accepted=()).verdict == "unknown"


def test_effects_that_are_all_too_unsure_to_be_named_are_told_as_what_comes_closest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    measured = [record(rng, dry_friction(HIDDEN_FRICTION), number) for number in range(4)]
    weighed = investigation.weighed

    def unsure(*given: Any) -> Weighed:
        """As where a force that is left over, and may be alike in all windows, would do as much."""
        whole = weighed(*given)
        return replace(whole, best=whole.null, evidence=whole.nominal, whole=whole)

    monkeypatch.setattr(investigation, "weighed", unsure)
    monkeypatch.setattr(investigation, "leaves_something", lambda judged: True)
    gap = investigate(PLANT(), measured)
    assert (gap.verdict, gap.named) == ("unknown", ())
    assert gap.closest is not None
    assert [effect.name for effect in gap.closest.effects] == ["coulomb_friction"]
    assert gap.closest.reduction.value > 0.8


SERVOS = """
<mujoco><option integrator="implicitfast" timestep="0.004"/><worldbody><body name="upper">
  <joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1.5"/>
  <body name="lower" pos="0 0 -0.3">
    <joint name="elbow" axis="0 1 0" damping="0.1" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.025" mass="0.8"/>
  </body></body></worldbody>
  <actuator><position joint="shoulder" kp="40" kv="4"/><position joint="elbow" kp="15" kv="1"/>
  </actuator></mujoco>
"""
FORGOTTEN = 1.3
"""times as heavy is the lower link"""


def simulated(plant: Plant, number: int, step_s: float) -> Recording:
    """Five seconds of the arm with its heavy link, by a plain loop of mj_step."""
    model, rng = mujoco.MjModel.from_xml_string(SERVOS), np.random.default_rng([5, number])
    model.opt.timestep = step_s
    model.body_mass[2] *= FORGOTTEN
    model.body_inertia[2] *= FORGOTTEN
    data, time = mujoco.MjData(model), 0.02 * np.arange(250)
    tones, sizes, phases = (rng.uniform(*r, (3, 2)) for r in ((0.2, 1.5), (0.2, 0.5), (0.0, 6.0)))
    waves = np.sin(2.0 * np.pi * tones * time[:, None, None] + phases)
    targets, states = (sizes * waves).sum(axis=1), np.zeros((250, 4))
    for k, target in enumerate(targets):
        states[k] = np.stack([data.qpos, data.qvel], axis=1).ravel()
        data.ctrl[:] = target
        mujoco.mj_step(model, data, round(0.02 / step_s))
    states += rng.standard_normal(states.shape) * [1e-3, 2e-2, 1e-3, 2e-2]
    names, pairs = (plant.layout.states, plant.layout.inputs), ((0, 1), (2, 3))
    return Recording(f"run{number}", time, states, targets, *names, velocities=pairs)


@pytest.mark.parametrize("step_s", [4e-3, 1e-3])
def test_the_timesteps_of_a_simulator_are_no_missing_mass(tmp_path: Path, step_s: float) -> None:
    """In those of 4 ms the exact equations lack 0.236 kg, and not the 0.24 that are hidden."""
    (tmp_path / "arm.xml").write_text(SERVOS)
    plant = plant_of(tmp_path / "arm.xml")
    gap = investigate(plant, [simulated(plant, number, step_s) for number in range(4)])
    (named,) = gap.named
    assert (named.name, named.target) == ("body_mass", "lower")
    hidden = (FORGOTTEN - 1.0) * 0.8
    assert named.parameters["m_d"].value == pytest.approx(hidden, abs=1.5e-3)
    assert f"in timesteps of {1e3 * step_s:g} ms" in " ".join(gap.remarks)
    assert gap.corrected.in_steps(0.0) == gap.corrected != gap.corrected.in_steps()


def test_the_spread_is_around_the_corrected_plant_and_as_wide_as_the_intervals(found: Gap) -> None:
    best, *others = found.correction.spread
    name = "coulomb_friction.pendulum.f_c"
    size = found.named[0].parameters["f_c"]
    assert best.values[name] == pytest.approx(size.value)
    assert best.values["mass"] == pytest.approx(found.corrected.values["mass"])
    assert 3.9 * best.std[name] < size.high - size.low < 6.0 * best.std[name]
    assert best.probability >= max([0.5, *(other.probability for other in others)])
    again = Spread(found.corrected, found.spread)
    drawn = again.rows(np.random.default_rng(0).normal(size=(4_000, again.dimensions)))
    errors = np.corrcoef(drawn[:, [again.names.index(n) for n in best.std]].T)
    if not others:
        np.testing.assert_allclose(errors, best.correlation, atol=0.1)


@pytest.mark.claim
@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_hidden_force_is_named_with_its_size(seed: int) -> None:
    name, parameters, measured = recordings(seed)
    gap = investigate(PLANT(), measured)
    assert gap.verdict == "named"
    assert [(named.name, named.target) for named in gap.named] == [(name, "pendulum")]
    for symbol, truth in parameters.items():
        found = gap.named[0].parameters[symbol]
        assert found.value == pytest.approx(truth, rel=0.05)
        assert found.low - 0.02 * truth < truth < found.high + 0.02 * truth
    assert gap.comparison is not None
    assert gap.comparison.closed.value > 0.8
    assert gap.comparison.corrected < 0.2 * gap.comparison.nominal


def test_nothing_is_named_where_nothing_is_hidden() -> None:
    rng = np.random.default_rng(5)
    gap = investigate(PLANT(), [record(rng, nothing, number) for number in range(3)])
    assert gap.verdict == "none"
    assert gap.named == ()


@pytest.mark.parametrize(("times", "verdict"), [(0.5, "none"), (2.0, "unknown")])
def test_a_plant_that_misses_held_out_motions_by_far_more_than_noise_does_lacks_something(
    times: float, verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where each fitted window that shows it was taken for one with an event."""
    compare = investigation.compare

    def far(*given: Any) -> Comparison:
        found = compare(*given)
        return replace(found, corrected=times * VERDICT.nothing * found.noise_floor)

    monkeypatch.setattr(investigation, "compare", far)
    rng = np.random.default_rng(4)
    gap = investigate(PLANT(), [record(rng, nothing, number) for number in range(5)])
    assert (gap.verdict, gap.named) == (verdict, ())


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.033, 0.2])
def test_a_delay_of_part_of_a_sample_or_of_many_is_found(delay: float) -> None:
    rng = np.random.default_rng(6)
    measured = [record(rng, nothing, number, delay=delay) for number in range(3)]
    gap = investigate(PLANT(), measured)
    assert [named.name for named in gap.named] == ["actuator_delay"]
    assert gap.named[0].parameters["d"].value == pytest.approx(delay, abs=1e-3)


@pytest.mark.slow
def test_a_gain_within_three_prior_std_is_no_finding_and_beyond_it_is() -> None:
    for gain, names in ((1.02, []), (1.3, ["actuator_gain"])):
        rng = np.random.default_rng(7)
        measured = [record(rng, nothing, number, gain=gain) for number in range(3)]
        gap = investigate(PLANT(), measured)
        assert [named.name for named in gap.named] == names


@pytest.mark.slow
def test_a_detent_that_is_not_in_the_catalogue_is_unknown() -> None:
    rng = np.random.default_rng(8)

    def detent(q: float, v: float) -> float:
        return -2.0 * (q - 0.4) * float(np.exp(-(((q - 0.4) / 0.1) ** 2)))

    gap = investigate(PLANT(), [record(rng, detent, number) for number in range(3)])
    assert gap.verdict == "unknown"


@pytest.mark.slow
def test_an_integrator_of_first_order_is_no_effect() -> None:
    """MuJoCo's default one, in steps of 2 ms, reads velocities half a step late."""
    rng, plant = np.random.default_rng(0), PLANT()
    model = mujoco.MjModel.from_xml_string(mjcf_of_plant(plant))
    model.opt.timestep, model.dof_damping[:] = 2e-3, plant.values["friction"]
    measured = []
    for number in range(3):
        data, rows = mujoco.MjData(model), []
        data.qpos[0] = rng.uniform(-1.0, 1.0)
        torque = np.repeat(rng.uniform(-0.5, 0.5, 20), 25)[:, None]
        for data.ctrl[:] in torque:
            rows.append((data.qpos[0], data.qvel[0]))
            mujoco.mj_step(model, data, nstep=10)
        states = np.array(rows) + rng.normal(size=(len(rows), 2)) * [1e-3, 1e-2]
        names, time = plant.layout, 0.02 * np.arange(len(rows))
        measured.append(Recording(str(number), time, states, torque, names.states, names.inputs))
    gap = investigate(plant, measured)
    assert gap.verdict == "none"
    assert gap.named == ()


@pytest.mark.slow
def test_a_push_by_hand_is_an_event_and_no_effect() -> None:
    rng = np.random.default_rng(10)

    def push(time: float) -> float:
        return 3.0 if 4.0 <= time < 4.3 else 0.0

    measured = [record(rng, dry_friction(0.1), number) for number in range(4)]
    measured[1] = record(rng, dry_friction(0.1), 1, outside=push)
    gap = investigate(PLANT(), measured)
    assert [named.name for named in gap.named] == ["coulomb_friction"]
    assert {event.recording for event in gap.events} == {"recording_1"}
    assert len(gap.events) == 1
    assert gap.events[0].start_s <= 4.0
    assert gap.events[0].end_s >= 4.3
    assert gap.events[0].end_s - gap.events[0].start_s < 3.5


@pytest.mark.slow
def test_samples_that_were_read_wrongly_are_no_sign_beside_a_weak_push() -> None:
    rng = np.random.default_rng(11)

    def push(time: float) -> float:
        return 0.6 if 4.0 <= time < 4.6 else 0.0

    measured = [record(rng, dry_friction(0.1), number) for number in range(3)]
    measured[0] = record(rng, dry_friction(0.1), 0, outside=push)
    for recording in measured:
        wrong = rng.choice(len(recording), len(recording) // 100, replace=False)
        recording.states[wrong, 0] += rng.choice([-1.0, 1.0], len(wrong)) * 20.0 * STD
    gap = investigate(PLANT(), measured)
    assert gap.verdict == "named"
    assert [named.name for named in gap.named] == ["coulomb_friction"]
    assert [event.recording for event in gap.events] == ["recording_0"]


def test_too_little_is_refused_with_what_would_do() -> None:
    rng = np.random.default_rng(9)
    long = record(rng, nothing, 0)
    short = Recording("short", long.time[:150], long.states[:150], long.inputs[:150], *long_names)
    gap = investigate(PLANT(), [short])
    assert gap.verdict == "too_poor"
    assert "Record longer" in gap.experiments[0]


long_names = (("angle", "velocity"), ("torque",))


def test_recordings_of_another_plant_are_refused() -> None:
    rng = np.random.default_rng(10)
    with pytest.raises(InputError, match="must have the states and inputs of mcpilco/CartPole"):
        investigate(envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](), [record(rng, nothing, 0)])


def test_an_unknown_parameter_is_named_with_those_there_are() -> None:
    rng = np.random.default_rng(11)
    with pytest.raises(InputError, match="has no parameter weight; it has mass, length"):
        investigate(PLANT(), [record(rng, nothing, 0)], free=["weight"])


def test_the_command_writes_what_an_env_can_load(
    found: Gap,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mcpilco.gap, "investigate", lambda plant, recordings, **how: found)
    for recording in found.recordings:
        write_recording(tmp_path / f"{recording.name}.csv", recording)
    files = sorted(map(str, tmp_path.glob("*.csv")))
    out = tmp_path / "gap"
    assert main(["gap", *files, "--plant", "mcpilco/Pendulum-v0", "--out", str(out)]) == 0
    told = json.loads((out / "gap.json").read_text())
    assert told["verdict"] == "named"
    assert [effect["name"] for effect in told["effects"]] == ["coulomb_friction"]
    assert "coulomb_friction" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {
        "corrected.json",
        "gap.json",
        "gap.rrd",
        "report.html",
    }
    env = gym.make("mcpilco/Pendulum-v0", effects=str(out / "corrected.json"))
    env.reset(seed=0)
    env.step(np.array([0.5], dtype=np.float32))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--plant", "none.xml"], "MJCF"),
        (["--plant", "mcpilco/Nothing-v0"], "--plant must be one of"),
        (["--set", "mass"], "--set must be NAME=VALUE"),
        (["--set", "weight=1"], "has no parameter 'weight'"),
        (["--uncertainty", "some"], "must be a number"),
    ],
)
def test_wrong_arguments_get_a_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.csv"
    write_recording(path, record(np.random.default_rng(0), nothing, 0))
    plant = [] if "--plant" in arguments else ["--plant", "mcpilco/Pendulum-v0"]
    assert main(["gap", str(path), "--out", str(tmp_path), *plant, *arguments]) == 2
    assert sentence in capsys.readouterr().err


def waved(name: str, dt: float, seconds: float) -> Recording:
    """A pendulum that is led along two sines, and a motor that is said to have been off."""
    time = dt * np.arange(round(seconds / dt))
    angle = np.sin(time) + 0.3 * np.sin(2.7 * time)
    states = np.stack([angle, np.cos(time) + 0.3 * 2.7 * np.cos(2.7 * time)], axis=1)
    return Recording(name, time, states, np.zeros((len(time), 1)), *long_names)


@pytest.mark.slow
def test_a_motion_that_the_plant_cannot_have_made_is_unknown() -> None:
    found = investigate(
        PLANT(), [waved(name, 0.02, 2.0 + k) for k, name in enumerate("abc")], accepted=()
    )
    assert found.verdict == "unknown"


@pytest.mark.slow
def test_recordings_without_noise_are_not_taken_to_be_exact() -> None:
    rng = np.random.default_rng(5)
    exact = [record(rng, dry_friction(0.1), number, std=0.0) for number in range(3)]
    (named,) = investigate(PLANT(), exact).named
    assert named.name == "coulomb_friction"
    assert named.parameters["f_c"].value == pytest.approx(0.1, rel=5e-3)


def test_recordings_of_several_sampling_times_are_read_at_the_longest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, dt in (("a", 0.005), ("b", 0.02), ("c", 0.01)):
        write_recording(tmp_path / f"{name}.csv", waved(name, dt, 1.6))
    files = sorted(map(str, tmp_path.glob("*.csv")))
    out = tmp_path / "gap"
    plant = ["--plant", "mcpilco/Pendulum-v0"]
    assert main(["gap", *files, *plant, "--out", str(out), "--accept"]) == 0
    told = capsys.readouterr()
    assert "sampling times are 0.005, 0.01, 0.02 s: all are read at 0.02 s" in told.err
    assert json.loads((out / "gap.json").read_text())["verdict"] == "too_poor"


def test_a_summary_is_ten_lines_at_most(found: Gap) -> None:
    assert 3 <= len(summary(found)) <= 10
    assert set(to_json(found)) >= {"format", "verdict", "effects", "where", "error", "events"}


def test_the_recordings_that_no_fit_may_see_can_be_named() -> None:
    time = 0.02 * np.arange(100)
    states, torque = np.zeros((100, 2)), np.zeros((100, 1))
    measured = [Recording(name, time, states, torque, *long_names) for name in "abc"]
    problem = GapProblem.of(PLANT(), measured, 0.01, (), {}, held_out=["a"])
    assert problem.names == (("b", "c"), ("a",))
    for wrong in (["d"], ["a", "b", "c"]):
        with pytest.raises(InputError, match="must be some of the recordings a, b, c, and leave"):
            GapProblem.of(PLANT(), measured, 0.01, (), {}, held_out=wrong)


@pytest.mark.slow  # two searches
def test_where_the_commands_went_out_otherwise_the_search_begins_with_what_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As the best model tells, and not the nominal plant: most steps are spent by then."""
    rng = np.random.default_rng(0)
    measured = [record(rng, dry_friction(HIDDEN_FRICTION), number) for number in range(3)]
    begun, search = [], investigation.search

    def spied(*given: Any) -> SearchResult:
        begun.append((given[3], search(*given)))
        return begun[-1][1]

    monkeypatch.setattr(investigation, "search", spied)
    monkeypatch.setattr(investigation, "possible_origins", lambda *given: 2 * [given])
    monkeypatch.setattr(investigation, "likeliest", lambda each, fit=None: each[bool(fit)])
    investigate(PLANT(), measured)
    (first, result), (then, _) = begun
    assert first == ()
    assert then
    for hint, fit in zip(then, result.fits, strict=False):
        assert hint.theta is fit.theta
        assert hint.model.effects == fit.model.effects


@pytest.mark.slow
def test_the_search_after_pushes_begins_without_windows_that_hold_an_event(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    measured = [record(rng, nothing, number) for number in range(2)]
    problem = GapProblem.of(PLANT(), measured, 0.01, (), {})
    fit, windows = fit_nominal(problem.model(problem.windows()), problem.windows())
    evidence = Evidence(0.0, np.zeros(1), np.ones(2), 1000, np.zeros(2))
    result = SearchResult(fit, fit, ((fit, 0.0),), (), windows, evidence)
    explained = investigation._Explanation(result, fit, windows, windows[:0])
    searched = []

    def spied(_: GapProblem, everything: Windows, masked: Windows, *hints: Any) -> Any:
        searched.append((everything.start_s, masked.start_s))
        return explained

    pushes = (Event("recording_0", 4.0, 5.0),)
    monkeypatch.setattr(investigation, "_explain", spied)
    monkeypatch.setattr(investigation, "without_bursts", lambda *_: (problem, pushes))
    monkeypatch.setattr(investigation, "recurring", lambda *_: None)
    monkeypatch.setattr(
        investigation, "windows_with_events", lambda fit, some: np.arange(len(some)) == 3
    )
    *_, found, place = investigation._leave_out_pushes(problem, explained)
    start = problem.enough_windows().start_s
    np.testing.assert_array_equal(searched[0][0], np.delete(start, 3))
    np.testing.assert_array_equal(searched[0][1], start[3:4])
    assert (found, place) == (pushes, None)
