"""One episode as an animation."""

from pathlib import Path

import numpy as np
from PIL import Image

import relloc_env
from agents.policy import Task
from agents.registry import make
from agents.rollout import rollout
from relloc_env.rendering.animation import save_animation


def film(out: Path, *, motion: str, estimator: str, seed: int, width: int, faster: float) -> None:
    """Draw an episode of the default task, every second action, and write it as GIF or MP4."""
    env = relloc_env.parallel_env(estimator=estimator, render_mode="rgb_array")
    episode = rollout(env, make(motion, Task.of(env)), seed, frames=True)
    env.close()
    frames = episode.frames[::2]
    size = (width, 2 * round(0.5 * width * frames[0].shape[0] / frames[0].shape[1]))
    pages = [np.asarray(Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS)) for frame in frames]
    out.parent.mkdir(parents=True, exist_ok=True)
    save_animation(pages, out, faster * len(frames) / float(episode.time[-1]))
