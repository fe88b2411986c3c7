"""One episode as an animation."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from agents.policy import Policy, Task
from agents.rollout import rollout
from relloc_env.config import EnvConfig
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.rendering.animation import save_animation


def film(
    out: Path, config: EnvConfig, build: Callable[[Task], Policy], *, seed: int, width: int = 720, faster: float = 3.0
) -> None:
    """Draw an episode, every second action, and write it as GIF or MP4."""
    env = RellocParallelEnv(config, bound=True, render_mode="rgb_array")
    episode = rollout(env, build(Task.of(env)), seed, frames=True)
    env.close()
    frames = episode.frames[::2]
    size = (width, 2 * round(0.5 * width * frames[0].shape[0] / frames[0].shape[1]))
    pages = [np.asarray(Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS)) for frame in frames]
    out.parent.mkdir(parents=True, exist_ok=True)
    save_animation(pages, out, faster * len(frames) / float(episode.time[-1]))
