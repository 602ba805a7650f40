from __future__ import annotations

import numpy as np
import pytest

from mcpilco.show.side_by_side import Clip, Naming, write_side_by_side
from mcpilco.typing import RunFolderError
from tests.mcpilco.show.test_film import content
from tests.mcpilco.show.test_recording import chunks, rrd

DT, STEPS = 0.125, 21
NAMING = Naming(
    {"cart_position": "m", "cart_velocity": "m/s", "pole_angle": "rad", "pole_velocity": "rad/s"},
    {"force": ""},
)


def clip(number: int) -> Clip:
    rng = np.random.default_rng(number)
    states = np.cumsum(0.05 * rng.standard_normal((STEPS, 4)), axis=0)
    measured = states.copy()
    measured[:2] = np.nan
    measured[:, 1] = np.nan
    models = {"nominal": states + 0.1, "corrected": states + 0.01}
    return Clip(f"### window {number}", measured, rng.standard_normal((STEPS, 1)), models)


@pytest.fixture
def path(tmp_path, scene):
    clips = [clip(0), clip(1)]
    return write_side_by_side(tmp_path / "gap.rrd", clips, DT, NAMING, scene, "a plant")


def test_recording_is_verified_by_rerun(path) -> None:
    assert rrd("verify", path) == 0


def test_each_scene_and_each_curve_is_there_for_every_clip(path) -> None:
    rows = {entity: sum(c.num_rows for c in found) for entity, found in chunks(path).items()}
    kinds = ("measured", "nominal", "corrected")
    for kind in kinds:
        for part in ("bodies/cart", "bodies/pole", "tail"):
            assert rows[f"world/{kind}/{part}"] == 2 * STEPS
    for model in kinds[1:]:
        assert rows[f"world/{model}/measured"] == 2 * STEPS
    for state in NAMING.states:
        assert rows[f"states/{state}/measured"] == 2 * STEPS
        for model in kinds[1:]:
            assert rows[f"states/{state}/{model}"] == 2 * (STEPS + 1)  # and a gap
    assert rows["about"] == 2


def test_clips_follow_one_another_after_a_pause(path) -> None:
    steps = sorted(
        step
        for chunk in chunks(path)["states/pole_angle/measured"]
        for step in chunk.to_record_batch().column("step").to_pylist()
    )
    pause = round(0.5 / DT)
    assert steps == [*range(STEPS), *range(STEPS + pause, 2 * STEPS + pause)]


def test_equal_clips_make_equal_recordings_and_others_do_not(tmp_path, scene, path) -> None:
    def written(name: str, *numbers: int):
        clips = [clip(number) for number in numbers]
        return write_side_by_side(tmp_path / name, clips, DT, NAMING, scene, "a plant")

    assert content(written("again.rrd", 0, 1)) == content(path)
    assert content(written("other.rrd", 0, 2)) != content(path)


def test_folder_that_cannot_be_made_is_named(tmp_path, scene) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError, match="Cannot write"):
        write_side_by_side(tmp_path / "file" / "gap.rrd", [clip(0)], DT, NAMING, scene, "a plant")
