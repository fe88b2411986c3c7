"""One episode as an animation; or two motions from the same start, side by side."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agents.errors import code_of
from agents.policy import Policy, Task
from agents.rollout import rollout
from relloc_env.config import EnvConfig
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.envs.picture import Picture
from relloc_env.folders import open_file
from relloc_env.rendering import Renderer, Scene, save_animation
from relloc_env.rendering.animation import check_animation
from relloc_env.rendering.rerun_file import recorder

EVERY = 2
"""Actions between two pictures."""
PAUSE = 2.0
"""[s] that the last picture stays."""
TALL = 1.04
"""Height over width of each of two panels."""


def film(
    out: Path,
    config: EnvConfig | Sequence[EnvConfig],
    motions: Mapping[str, Callable[[Task], Policy]],
    *,
    seed: int,
    width: int = 720,
    faster: float = 3.0,
    theme: Literal["light", "dark"] = "light",
    rerun: Path | None = None,
) -> None:
    """Draw an episode, every second action, and write it as GIF or MP4.

    Args:
        out: file to write.
        config: of the environment; or one for each motion.
        motions: what builds one agent or two, by what to call it in the picture; two start from the same place, each
            in a panel of its own.
        seed: of the episode.
        width: [px] of the picture.
        faster: times as fast as the robots.
        theme: `light` or `dark`.
        rerun: file for the first motion's recording for Rerun; None for none.

    Raises:
        ValueError: no motion, or more than two.
    """
    if not 1 <= len(motions) <= 2:
        raise ValueError(f"Argument `motions` must have one entry or two, but has {len(motions)}")
    configs = [config] * len(motions) if isinstance(config, EnvConfig) else config
    rate = faster * configs[0].sample_rate / (EVERY * configs[0].samples_per_action)
    out = check_animation(out, rate)
    rerun = None if rerun is None else open_file(rerun, "rerun")
    episodes = [scenes(one, build, seed, title) for one, (title, build) in zip(configs, motions.items(), strict=True)]
    alone = len(episodes) == 1
    with recorder(rerun) as write:
        if write is not None:
            for scene in episodes[0]:
                write(scene)
    size = (width, 2 * round(width * 9 / 32)) if alone else (width // 2, round(TALL * (width // 2)))
    panels = [Renderer(size, theme=theme) for _ in episodes]
    frames: list[NDArray[np.uint8]] = []
    for instants in zip(*(episode[::EVERY] for episode in episodes), strict=True):
        drawn = [panel.draw(scene) for panel, scene in zip(panels, instants, strict=True)]
        frames.append(np.concatenate([picture for picture in drawn if picture is not None], axis=1))
    save_animation(frames + frames[-1:] * round(PAUSE * rate), out, rate)


def scenes(config: EnvConfig, build: Callable[[Task], Policy], seed: int, title: str) -> list[Scene]:
    """Play an episode, and return what there was to see at its start and after each action."""
    env = RellocParallelEnv(config, bound=True)
    picture, seen = Picture(env.core, "rgb_array"), list[Scene]()

    def watch() -> None:
        picture.follow(new=not seen)
        seen.append(replace(picture.scene(), title=title))

    with code_of(title, build):
        policy = build(Task.of(env))
    rollout(env, policy, seed, watch=watch, name=title)
    env.close()
    return seen
