"""Laws of the film of an arm that is pushed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mcpilco.identification.collision import Detection, events
from mcpilco.show.collision_film import write_collision_film
from tests.mcpilco.identification.collision.free_arm import arm, body, samples
from tests.mcpilco.show.test_recording import chunks, rrd

ROWS = slice(100, 160)


@pytest.fixture(scope="module")
def told():
    """Samples, what a detector could say of them, and a force."""
    some = samples(3, 3)[ROWS]
    alarms = np.zeros_like(some.q, dtype=bool)
    alarms[20:24, 0] = alarms[22:24, 3] = True
    residual = np.where(alarms, 2.0, 0.1)
    found = Detection(
        some.time, some.i - residual, residual, np.ones_like(residual), alarms, alarms
    )
    force = np.zeros((len(some), 3))
    force[18:26, 1] = 30.0
    return some, found, force


@pytest.fixture
def path(tmp_path, told):
    some, found, force = told
    alarms = events(found, arm().joints)
    return write_collision_film(tmp_path / "a.rrd", "a", body().chain, some, found, alarms, force)


def test_rerun_verifies_it(path):
    assert rrd("verify", path) == 0


def counts(found: dict, entity: str, component: str) -> list[int]:
    """How many of a thing there are at each sample."""
    told = []
    for chunk in found[entity]:
        batch = chunk.to_record_batch()
        name = next((n for n in batch.schema.names if n.endswith(component)), None)
        if name is not None and chunk.num_rows > 1:
            told += [len(cell) for cell in batch.column(name).to_pylist()]
    return told


def test_the_push_and_the_alarms_are_shown_when_they_are(path, told):
    _, found, force = told
    seen = chunks(path)
    assert counts(seen, "world/alarm", "positions") == found.joints.sum(axis=1).tolist()
    assert sum(c.num_rows for c in seen["residuals/base/alarm"]) == 4
    assert "residuals/elbow/alarm" not in seen
    assert counts(seen, "world/push", "vectors") == (force[:, 1] > 0).astype(int).tolist()


def test_each_joint_has_its_curves_and_each_link_its_body(path, told):
    seen = chunks(path)
    for joint in arm().joints:
        assert {f"currents/{joint}/{k}" for k in ("measured", "expected")} <= set(seen)
        assert {f"residuals/{joint}/{k}" for k in ("residual", "upper", "lower")} <= set(seen)
    for link in body().chain.bodies:
        rows = sum(c.num_rows for c in seen[f"world/bodies/{link.name}"])
        assert rows >= len(told[0])


def test_without_a_known_push_there_is_no_arrow(tmp_path, told):
    some, found, _ = told
    path = write_collision_film(tmp_path / "b.rrd", "b", body().chain, some, found, [])
    assert "world/push" not in chunks(path)


def test_equal_arguments_make_equal_recordings(tmp_path, told):
    some, found, force = told
    quiet = dataclasses.replace(found, joints=np.zeros_like(found.joints))
    first, again, other = (
        write_collision_film(tmp_path / f"{k}.rrd", "a", body().chain, some, what, [], force)
        for k, what in enumerate((found, found, quiet))
    )
    assert rrd("compare", "--unordered", first, again) == 0
    assert rrd("compare", "--unordered", first, other) != 0
