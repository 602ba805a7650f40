"""Videos of rollouts: GIF by Pillow, which Rerun brings; MP4 by imageio-ffmpeg, an extra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from mcpilco.files import replacing
from mcpilco.typing import InputError


def write_video(path: Path, frames: Sequence[UInt8[np.ndarray, "H W 3"]], dt: float) -> Path:
    """The path of the video written, in which each frame lasts one sampling time.

    A .gif or .mp4 file that is there is replaced; frames are pictures of one size, dt is in [s].

    Raises:
        InputError: another kind of file, or imageio-ffmpeg is missing.
        RunFolderError: the file cannot be written.
    """
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    if path.suffix not in writers:
        raise InputError(f"A video must be a .gif or .mp4 file, got {path}; name one of these.")
    with replacing(path) as temporary:
        writers[path.suffix](temporary, frames, dt)
    return path


def _write_gif(path: Path, frames: Sequence[np.ndarray], dt: float) -> None:
    from PIL import Image

    first, *others = map(Image.fromarray, frames)
    first.save(path, "GIF", save_all=True, append_images=others, duration=1000.0 * dt, loop=0)


def _write_mp4(path: Path, frames: Sequence[np.ndarray], dt: float) -> None:
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise InputError(
            "An .mp4 file needs imageio-ffmpeg; install it with: pip install 'mcpilco[video]', "
            "or write a .gif."
        ) from error
    height, width = frames[0].shape[:2]
    video = write_frames(
        str(path), (width, height), fps=1.0 / dt, macro_block_size=2, output_params=["-f", "mp4"]
    )
    video.send(None)  # it waits for the first frame then
    for frame in frames:
        video.send(np.ascontiguousarray(frame))
    video.close()
