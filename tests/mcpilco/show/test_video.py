from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mcpilco.show import write_video
from mcpilco.typing import InputError, RunFolderError

DT = 0.05
FRAMES = [np.full((40, 60, 3), shade, dtype=np.uint8) for shade in (0, 100, 200)]


def test_each_frame_of_a_gif_lasts_one_sampling_time(tmp_path: Path) -> None:
    with Image.open(write_video(tmp_path / "a.gif", FRAMES, DT)) as video:
        assert (video.n_frames, video.size) == (3, (60, 40))
        for number, frame in enumerate(FRAMES):
            video.seek(number)
            assert video.info["duration"] == 1000 * DT
            np.testing.assert_array_equal(np.asarray(video.convert("RGB")), frame)


def test_an_mp4_holds_the_frames_at_their_rate(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = write_video(tmp_path / "a.mp4", FRAMES, DT)
    frames = ffmpeg.read_frames(str(path))
    about = next(frames)
    assert (about["fps"], about["size"]) == (1 / DT, (60, 40))
    shades = [np.frombuffer(frame, np.uint8).mean() for frame in frames]
    np.testing.assert_allclose(shades, (0, 100, 200), atol=6)  # the codec rounds


def test_an_mp4_without_ffmpeg_says_what_to_install(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'mcpilco\[video\]', or write a .gif"):
        write_video(tmp_path / "a.mp4", FRAMES, DT)
    assert not list(tmp_path.iterdir())


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must be a .gif or .mp4 file, got .*a.avi"):
        write_video(tmp_path / "a.avi", FRAMES, DT)


@pytest.mark.parametrize("name", ["a.gif", "a.mp4"])
def test_a_folder_that_is_not_there_is_named(tmp_path: Path, name: str) -> None:
    if name == "a.mp4":
        pytest.importorskip("imageio_ffmpeg")
    with pytest.raises(RunFolderError, match="Cannot write .*nowhere"):
        write_video(tmp_path / "nowhere" / name, FRAMES, DT)
