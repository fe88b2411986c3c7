"""The paper's depth observer on the paper's four points: where they are in the image decides how fast it converges."""

from pathlib import Path

import gymnasium as gym
import numpy as np

import relloc_env
from docs.figures.style import MUTED, POINT, page
from relloc_env.metrics import point_errors
from relloc_env.samples import Float

NAMES = ("p₁ on the optical axis", "p₂ above it", "p₃ beside it", "p₄ above and beside it")
SPEED = 0.5
"""Share of the greatest speed, 0.2 m/s: the paper's 0.1 m/s straight ahead."""


def errors(actions: int = 400) -> tuple[Float, Float]:
    """Times (T,) [s], and estimated less true depth (T, 4) [m] of each point."""
    relloc_env.__version__  # noqa: B018 - the import registers the ids
    env = gym.make("relloc_env/ActiveDepth-v0", config="paper-depth", bound=False, reward={"excitation": 1.0})
    core = env.unwrapped.core  # type: ignore[attr-defined]
    heights = np.array([core.config.camera_of(0).mount_height])
    kept = []
    env.reset(seed=0)
    for _ in range(actions):
        env.step(np.array([SPEED, 0.0], np.float32))
        world = core.simulation.world
        kept.append(point_errors(core.onboard.estimate, world.pose, world.points, heights).depth[0, 0])
    env.close()
    return core.config.sample_period * np.arange(1, actions + 1), np.array(kept)


def draw(path: Path) -> None:
    """The image at the start, and the errors over time."""
    time, error = errors()
    image = np.array([(0.0, 0.0), (0.0, -1.0), (1.0, 0.0), (1.0, -1.0)])  # x right, y down
    with page(path, 3.4) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
        left.set(xlim=(-0.4, 1.4), ylim=(0.4, -1.4), title="in the image", xlabel="x [-]", ylabel="y [-]")
        left.set_aspect("equal")
        for i, (x, y) in enumerate(image):
            left.plot(x, y, "o", color=POINT[i], ms=8)
            if i:
                left.annotate(
                    "", (1.35 * x, 1.35 * y), (x, y), arrowprops={"arrowstyle": "->", "color": POINT[i], "lw": 1.8}
                )
            right.plot(time, np.abs(error[:, i]), color=POINT[i], label=NAMES[i], ls="--" if i == 2 else "-")
        right.axhline(0.1, color=MUTED, lw=0.9, ls="--")
        right.annotate("0.1 m", (20.0, 0.12), ha="right", color=MUTED)
        right.set(xlabel="time [s]", title="|depth error| [m]", ylim=(0.0, 1.1), xlim=(0.0, 20.0))
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=2)
