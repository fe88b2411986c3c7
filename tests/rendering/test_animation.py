"""Animations read back: number of pictures, rate, colours."""

import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from relloc_env.rendering import Renderer, save_animation
from tests.rendering.scenes import random_scene

Picture = NDArray[np.uint8]


@pytest.fixture(scope="module")
def frames() -> list[Picture]:
    renderer = Renderer((480, 270))
    drawn = [renderer.draw(random_scene(0, time=float(k))) for k in range(1, 8)]
    return [picture for picture in drawn if picture is not None]


def test_gif_plays_all_pictures_at_the_rate_in_their_colours(frames: list[Picture], tmp_path: Path) -> None:
    save_animation(frames, tmp_path / "a.gif", fps=30.0)
    with Image.open(tmp_path / "a.gif") as animation:
        read = [
            (np.asarray(f.convert("RGB")).astype(int), f.info["duration"]) for f in ImageSequence.Iterator(animation)
        ]
        assert animation.info["loop"] == 0
    assert len(read) == len(frames)
    assert sum(duration for _, duration in read) == pytest.approx(1000.0 * len(frames) / 30.0, abs=10.0)
    for (picture, _), frame in zip(read, frames, strict=True):
        assert np.abs(picture - frame).mean() < 3.0
        assert np.percentile(np.abs(picture - frame), 99) < 40.0


def test_mp4_plays_all_pictures_at_the_rate(frames: list[Picture], tmp_path: Path) -> None:
    save_animation(frames, tmp_path / "a.mp4", fps=10.0)
    reader = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-i",
        str(tmp_path / "a.mp4"),
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    read = subprocess.run(reader, capture_output=True, check=True)
    assert b" 10 fps" in read.stderr
    pictures = np.frombuffer(read.stdout, np.uint8).reshape(-1, 270, 480, 3).astype(int)
    assert len(pictures) == len(frames)
    assert np.abs(pictures[3] - frames[3]).mean() < 6.0


@pytest.mark.parametrize(
    ("name", "fps", "message"),
    [
        ("a.webp", 20.0, "`path` must end in .gif or .mp4"),
        ("a.gif", 0.0, "`fps` must be positive, but is 0.0"),
        ("a.gif", 60.0, "`fps` must be at most 50 in a GIF, but is 60.0"),
    ],
)
def test_wrong_wishes_are_refused(frames: list[Picture], tmp_path: Path, name: str, fps: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        save_animation(frames, tmp_path / name, fps)


def test_wrong_pictures_are_refused(frames: list[Picture], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one picture"):
        save_animation([], tmp_path / "a.gif")
    with pytest.raises(ValueError, match="of one shape"):
        save_animation([frames[0], frames[0][:100]], tmp_path / "a.gif")
