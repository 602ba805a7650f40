"""Laws of thresholds and of the detector."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from envs.arms.sticky_arm import Push
from mcpilco.files import read_arrays, write_arrays
from mcpilco.identification.collision import (
    CollisionDetector,
    Sample,
    ThresholdConfig,
    debounced,
    detect,
    events,
    load_collision_model,
    save_collision_model,
    thresholds,
)
from mcpilco.recordings import arm_samples
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.identification.collision.free_arm import arm, fitted, log, samples

PUSHES = (Push(4.0, 40.0), Push(9.0, -40.0))
RULES = (
    ThresholdConfig(),
    ThresholdConfig(rule="deviations"),
    ThresholdConfig(by_phase=True, quantile=0.99),
)


def stream(told, start: int = 0, velocity: bool = True):
    for k in range(start, len(told.time)):
        yield Sample(
            time=float(told.time[k]),
            position=told.position[k],
            current=told.current[k],
            target_position=told.target_position[k],
            target_velocity=told.target_velocity[k],
            target_current=told.target_current[k],
            velocity=told.velocity[k] if velocity else None,
        )


def cut(told, rows: slice):
    """Some samples of a log."""
    arrays = {k: v[rows] for k, v in vars(told).items() if isinstance(v, np.ndarray)}
    return dataclasses.replace(told, **{**arrays, "time": arrays["time"] - arrays["time"][0]})


@pytest.fixture(scope="module")
def model():
    return fitted("FC")[0]


@pytest.mark.slow
@pytest.mark.parametrize("config", RULES)
@pytest.mark.parametrize("velocity", [True, False])
def test_sample_by_sample_is_all_at_once(model, config, velocity):
    told = cut(log(3, 3, PUSHES[:1]), slice(420, 620))
    limits = thresholds(model, samples(2), config)
    detector = CollisionDetector(model, limits)
    one_by_one = [detector.update(sample) for sample in stream(told, velocity=velocity)]
    shown = told if velocity else dataclasses.replace(told, velocity=np.nan * told.velocity)
    at_once = detect(model, limits, arm_samples(shown))
    known = [d for d in one_by_one if np.isfinite(d.residual).all()]
    assert len(known) == len(at_once.time)
    assert at_once.collision.any()
    assert [d.collision for d in known] == at_once.collision.tolist()
    np.testing.assert_array_equal([d.joints for d in known], at_once.joints)
    np.testing.assert_allclose([d.residual for d in known], at_once.residual, atol=1e-8)
    np.testing.assert_allclose([d.threshold for d in known], at_once.threshold, rtol=1e-5)


def test_strong_pushes_are_found_at_once(model):
    limits = thresholds(model, samples(2), ThresholdConfig(quantile=1.0))
    found = events(detect(model, limits, samples(3, 12, PUSHES)), model.joints)
    for push in PUSHES:
        hits = [event for event in found if 0.0 <= event.start_s - push.start_s < 0.1]
        assert len(hits) == 1
        assert "base" in hits[0].joints
        assert hits[0].end_s - push.start_s > 0.1
    assert len(found) <= len(PUSHES) + 3


def test_the_share_above_a_quantile_is_what_it_leaves(model):
    some = samples(2)
    for config in RULES:
        size = np.abs(some.i - model.mean(some))
        limits = thresholds(model, some, config)(model, some)
        share = (size > limits).mean(axis=0)
        assert (share <= 1.0 - config.quantile + 1e-12).all()
        assert (share > 0.8 * (1.0 - config.quantile)).all()


def test_thresholds_by_phase_are_those_of_each_phase(model):
    some = samples(2)
    limits = thresholds(model, some, ThresholdConfig(quantile=1.0, by_phase=True))
    size, still = np.abs(some.i - model.mean(some)), model.quiet(some)
    np.testing.assert_allclose(limits.resting, np.where(still, size, 0.0).max(axis=0))
    np.testing.assert_allclose(limits.moving, np.where(still, 0.0, size).max(axis=0))


def test_more_samples_before_an_alarm_make_fewer_alarms(model):
    limits = [
        thresholds(model, samples(2), ThresholdConfig(quantile=0.98, debounce=count))
        for count in (1, 2, 5)
    ]
    alarms = [int(detect(model, limit, samples(4)).collision.sum()) for limit in limits]
    assert alarms[0] > alarms[1] > alarms[2]


def test_debouncing_waits_for_successive_samples():
    over = np.array([1, 1, 0, 1, 1, 1, 1, 0], dtype=bool)[:, None]
    assert debounced(over, 3)[:, 0].tolist() == [False] * 5 + [True, True, False]
    np.testing.assert_array_equal(debounced(over, 1), over)
    assert not debounced(over[:2], 3).any()


def test_a_gap_begins_anew(model):
    """No derivative is taken across it, and no alarm carried over it."""
    told = log(3, 3)
    detector = CollisionDetector(model, thresholds(model, samples(2)))
    for sample in list(stream(told))[:50]:
        detector.update(sample)
    late = next(stream(told, 60))
    assert np.isnan(detector.update(late).residual).all()
    assert not detector.update(dataclasses.replace(late, time=late.time - 1.0)).collision


def test_samples_that_are_none_are_refused(model):
    detector = CollisionDetector(model, thresholds(model, samples(2)))
    good = next(stream(log(3, 3)))
    with pytest.raises(InputError, match=r"current must be finite numbers of shape \(6,\)"):
        detector.update(dataclasses.replace(good, current=np.full(6, np.nan)))
    with pytest.raises(InputError, match="time must be finite"):
        detector.update(dataclasses.replace(good, time=float("inf")))


@pytest.mark.usefixtures("unchecked_shapes")
def test_samples_of_another_robot_are_refused(model):
    detector = CollisionDetector(model, thresholds(model, samples(2)))
    good = next(stream(log(3, 3)))
    with pytest.raises(InputError, match=r"position must be .* the joints base, shoulder"):
        detector.update(dataclasses.replace(good, position=np.zeros(7)))


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (ThresholdConfig(quantile=0.4), "quantile must be within 0.5..1, got 0.4"),
        (ThresholdConfig(debounce=0), "debounce must be at least 1 sample, got 0"),
        (ThresholdConfig(quantile=0.99999), "needs at least 1000000 samples"),
    ],
)
def test_thresholds_that_make_no_sense_are_refused(model, config, said):
    with pytest.raises(InputError, match=said):
        thresholds(model, samples(2), config)


def test_a_phase_without_samples_has_no_threshold(model):
    still = samples(2)
    still = still[model.quiet(still)[:, 0]]
    with pytest.raises(InputError, match="in which base moves, got 0"):
        thresholds(model, still, ThresholdConfig(by_phase=True, quantile=0.9))


@pytest.mark.slow
def test_events_are_told_with_their_joints():
    assert arm().joints[0] == "base"
    model = fitted("FC")[0]
    found = detect(model, thresholds(model, samples(2)), samples(3, 12, PUSHES))
    quiet = dataclasses.replace(found, joints=np.zeros_like(found.joints))
    assert events(quiet, model.joints) == []
    alarms = np.zeros_like(found.joints)
    alarms[10:13, 1] = alarms[20:22, 2] = alarms[100, 0] = True
    first, second = events(dataclasses.replace(found, joints=alarms), model.joints)
    assert (first.joints, second.joints) == (("shoulder", "elbow"), ("base",))
    assert first.start_s == found.time[10]
    assert first.end_s == found.time[21]


@pytest.mark.parametrize("kind", [pytest.param("PP", marks=pytest.mark.slow), "FC"])
def test_what_is_loaded_is_what_was_saved(kind, tmp_path):
    model, _ = fitted(kind)
    limits = thresholds(model, samples(2), ThresholdConfig(debounce=4, by_phase=True, quantile=0.9))
    first = save_collision_model(tmp_path / "a.npz", model, limits)
    again, told = load_collision_model(first)
    test = samples(2)[:200]
    np.testing.assert_array_equal(again.mean(test), model.mean(test))
    np.testing.assert_array_equal(again.std(test), model.std(test))
    assert (again.joints, again.dt, again.config) == (model.joints, model.dt, model.config)
    assert told.config == limits.config
    np.testing.assert_array_equal(told.resting, limits.resting)
    second = save_collision_model(tmp_path / "b.npz", again, told)
    assert first.read_bytes() == second.read_bytes()


def test_what_is_no_model_is_refused(tmp_path):
    model, _ = fitted("PP")
    path = save_collision_model(tmp_path / "m.npz", model, thresholds(model, samples(2)))
    arrays = read_arrays(path)
    with pytest.raises(RunFolderError, match="There is no file"):
        load_collision_model(tmp_path / "none.npz")
    write_arrays(path, {name: array for name, array in arrays.items() if "limits" not in name})
    with pytest.raises(RunFolderError, match="damaged"):
        load_collision_model(path)
    write_arrays(path, {**arrays, "limits/moving": np.zeros(2)})
    with pytest.raises(RunFolderError, match="damaged"):
        load_collision_model(path)
    write_arrays(path, {**arrays, "about": np.array('{"format": "policy"}')})
    with pytest.raises(RunFolderError, match="no model of `mcpilco collisions learn`"):
        load_collision_model(path)
