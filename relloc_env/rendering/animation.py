"""Pictures in a row, as a GIF or MP4 file."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relloc_env.extras import extra
from relloc_env.files import whole
from relloc_env.folders import open_file

Picture = NDArray[np.uint8]

_PALETTE_FROM = 12
_GIF_TICK = 0.01


def save_animation(frames: Sequence[Picture], path: str | Path, fps: float = 20.0) -> None:
    """Write pictures as an animation; the ending of `path` (.gif or .mp4) says as what.

    A GIF has one palette for all pictures and stores what changes from one to the next; it repeats for ever. Its
    pictures last a whole number of 1/100 s each, shared out so that the whole keeps the rate.

    Args:
        frames: pictures (height, width, 3) uint8, all of one size.
        path: file to write.
        fps: [1/s] pictures a second, at most 50 in a GIF.
    """
    path = check_animation(path, fps)
    if not len(frames):
        raise ValueError("Argument `frames` must hold at least one picture, but is empty.")
    for picture in frames:
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape != (*frames[0].shape[:2], 3):
            raise ValueError(
                f"Argument `frames` must hold uint8 pictures of one shape (height, width, 3), but has {picture.dtype} "
                f"of {picture.shape}."
            )
    with whole(path) as partial:
        save = _save_gif if path.suffix == ".gif" else _save_mp4
        save(frames, partial, fps)


def check_animation(path: str | Path, fps: float) -> Path:
    """Return where an animation goes.

    Raises:
        ValueError: another ending than .gif or .mp4, or a rate that cannot be.
        OSError: a folder that cannot be made or not be written into.
    """
    if Path(path).suffix not in {".gif", ".mp4"}:
        raise ValueError(f"Argument `path` must end in .gif or .mp4, but is {str(path)!r}.")
    if not 0.0 < fps < float("inf"):
        raise ValueError(f"Argument `fps` must be positive, but is {fps}.")
    if Path(path).suffix == ".gif" and fps > 50.0:
        raise ValueError(f"Argument `fps` must be at most 50 in a GIF, but is {fps}.")
    return open_file(path, "path")


def _save_gif(frames: Sequence[Picture], partial: Path, fps: float) -> None:
    with extra("render"):
        from PIL import Image

    chosen = np.linspace(0, len(frames) - 1, min(len(frames), _PALETTE_FROM)).round().astype(int)
    sample = Image.fromarray(np.concatenate([frames[k] for k in chosen]))
    palette = sample.quantize(colors=255, method=Image.Quantize.MEDIANCUT, kmeans=1, dither=Image.Dither.NONE)
    pictures = (Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames)
    ends = [round((k + 1) / fps / _GIF_TICK) for k in range(len(frames))]
    durations = [10 * (end - start) for start, end in zip([0, *ends], ends, strict=False)]
    first = next(pictures)
    first.save(partial, save_all=True, append_images=pictures, duration=durations, loop=0, optimize=False)


def _save_mp4(frames: Iterable[Picture], partial: Path, fps: float) -> None:
    with extra("render"):
        import imageio_ffmpeg

    writer = None
    for picture in frames:
        height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
        if writer is None:
            writer = imageio_ffmpeg.write_frames(
                str(partial),
                (width, height),
                fps=fps,
                codec="libx264",
                pix_fmt_out="yuv420p",
                quality=None,
                output_params=["-crf", "20", "-preset", "medium", "-threads", "1", "-fflags", "+bitexact"],
                macro_block_size=2,
                ffmpeg_log_level="error",
            )
            writer.send(None)
        writer.send(np.ascontiguousarray(picture[:height, :width]))
    assert writer is not None
    writer.close()
