"""One episode as an animation; or two motions from the same start, side by side."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import relloc_env
from agents.policy import Task
from agents.registry import make, short
from agents.rollout import rollout
from relloc_env.envs.picture import Picture
from relloc_env.rendering import Renderer, Scene, save_animation
from relloc_env.rendering.rerun_file import recorder

EVERY = 2
"""Actions between two pictures."""
PAUSE = 2.0
"""[s] that the last picture stays."""
TALL = 1.04
"""Height over width of each of two panels."""


def film(
    out: Path,
    *,
    motion: str,
    beside: str | None = None,
    names: tuple[str, ...] = (),
    estimator: str,
    seed: int,
    width: int,
    faster: float,
    theme: Literal["light", "dark"] = "light",
    rerun: Path | None = None,
) -> None:
    """Draw an episode of the default task, every second action, and write it as GIF or MP4.

    Args:
        out: file to write.
        motion, beside: names of agents; the second one starts from the same place, in a panel of its own.
        names: what to call them in the picture; default: their names.
        estimator: name of the estimator.
        seed: of the episode.
        width: [px] of the picture.
        faster: times as fast as the robots.
        theme: `light` or `dark`.
        rerun: file for the first motion's recording for Rerun; None for none.
    """
    motions = [motion] if beside is None else [motion, beside]
    if names and len(names) != len(motions):
        raise ValueError(f"Argument `names` must have one for each of {len(motions)} motions, but has {len(names)}")
    shown = names or tuple(map(short, motions))
    episodes = [scenes(name, estimator, seed, title) for name, title in zip(motions, shown, strict=True)]
    with recorder(rerun) as write:
        for scene in episodes[0] if write is not None else ():
            write(scene)
    size = (width, 2 * round(width * 9 / 32)) if beside is None else (width // 2, round(TALL * (width // 2)))
    panels = [Renderer(size, theme=theme) for _ in episodes]
    frames: list[NDArray[np.uint8]] = []
    for instants in zip(*(episode[::EVERY] for episode in episodes), strict=True):
        drawn = [panel.draw(scene) for panel, scene in zip(panels, instants, strict=True)]
        frames.append(np.concatenate([picture for picture in drawn if picture is not None], axis=1))
    rate = faster / (episodes[0][EVERY].time - episodes[0][0].time)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_animation(frames + frames[-1:] * round(PAUSE * rate), out, rate)


def scenes(motion: str, estimator: str, seed: int, title: str) -> list[Scene]:
    """Play an episode, and return what there was to see at its start and after each action."""
    env = relloc_env.parallel_env(estimator=estimator)
    picture, seen = Picture(env.core, "rgb_array"), list[Scene]()

    def watch() -> None:
        picture.follow(new=not seen)
        seen.append(replace(picture.scene(), title=title))

    rollout(env, make(motion, Task.of(env)), seed, watch=watch)
    env.close()
    return seen
