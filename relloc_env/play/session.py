"""One drive after another: the world, the estimator that watches, and the log of what happened. No window."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from relloc_env.config import EnvConfig, load_config
from relloc_env.envs.core import ROBOT_NAMES, Core
from relloc_env.envs.picture import Picture
from relloc_env.estimators.config import PRESETS, CascadeConfig
from relloc_env.folders import open_folder
from relloc_env.kernels.world import Truth, World
from relloc_env.logs.episode import LogWriter
from relloc_env.samples import Bool, Float, Float32, Rows, Samples
from relloc_env.vision.eyes import Eyes

if TYPE_CHECKING:
    from relloc_env.rendering.scene import Scene

View = tuple[Float32, Bool]
"""(R, M, 2) image coordinates, (R, M) what was seen."""
ESTIMATORS = ("map-alignment", "cascade", "cascade-critical", "inverse-depth")
"""What can be switched to."""
HORIZON = 60.0
"""[s] of the past that the strips show."""
_ROW = np.zeros(1, np.int64)


class Session:
    """Drives with one configuration; each sample has an action of its own.

    Args:
        config: of the world; how long episodes last, and when they end, is for the driver to say.
        seed: of the first drive.
        logs: folder for a log of each drive; None writes none.
        options: over the configuration, as for `load_config`.
    """

    def __init__(
        self,
        config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
        *,
        seed: int = 0,
        logs: str | Path | None = None,
        **options: Any,
    ) -> None:
        mine: dict[str, Any] = {"action": "motion", "samples_per_action": 1, "max_cycles": 10**9, "bound": True}
        self.config = load_config(config, **{**options, **mine})
        self.seed, self._logs = seed, None if logs is None else open_folder(logs, "logs")
        self.written: list[Path] = []
        """Logs of the drives that are over."""
        self._names = [*ESTIMATORS]
        chosen = self.config.estimator
        self.estimator = next((name for name, preset in PRESETS.items() if preset == chosen), "")
        if self.estimator not in self._names:
            self.estimator = self.estimator or ("own" if chosen is not None else "none")
            self._names.insert(0, self.estimator)
        self._first = self.estimator
        self.core = Core(self.config)
        self.picture = Picture(self.core, "rgb_array", past=HORIZON)
        self._actions: list[Float] = []
        self._views: list[View] = []
        self._writer: LogWriter | None = None
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Finish the drive, and start the next: the same again, or with another seed."""
        self.finish()
        self.seed = self.seed if seed is None else seed
        self._actions = []
        self._begin()
        self._views = [_view(self.core.simulation.first)]
        if self._logs is not None:
            simulation = self.core.simulation
            self._writer = LogWriter(
                self._free(self._logs),
                simulation.prior,
                simulation.world.points[0],
                robots=ROBOT_NAMES[: self.config.robots],
                configuration=self.config.to_dict(),
            )
            self._writer.add(simulation.first, simulation.first_truth.pose[0])

    def step(self, action: Float) -> None:
        """Drive for one sample.

        Args:
            action: [-] (R, 2) speed and yaw rate as shares of the limits.
        """
        self._actions.append(np.array(action, np.float64))
        self._move(action)
        self._views.append(_view(self.core.simulation.samples))
        if self._writer is not None:
            self._writer.add(self.core.simulation.samples, self.core.simulation.truth.pose[0])

    def next_estimator(self) -> None:
        """Let the next estimator watch the same drive, from its start; its gains are those it comes with.

        The world is driven again with the same seed and actions: it is the same to the last bit. Pictures, which take
        long, are not taken again: what was found in them is remembered.
        """
        place = self._names.index(self.estimator) + 1
        self.estimator = self._names[place % len(self._names)]
        chosen = self.config.estimator if self.estimator == self._first else self.estimator
        before = self.core.simulation
        self.core = Core(load_config(self.config, estimator=chosen))
        self.picture = Picture(self.core, "rgb_array", past=HORIZON)
        simulation = self.core.simulation
        if before.eyes is not None:
            simulation.eyes = _Memory(self._views)
        self._begin()
        for action in self._actions:
            self._move(action)
        if before.eyes is not None:
            simulation.eyes = before.eyes
            simulation.world.streams[:] = before.world.streams

    @property
    def gains(self) -> Float | None:
        """(R, M, 2) gains H [1/s] and alpha Lambda [1/m²] of the cascade, a live array; None for other estimators."""
        config = self.core.config.estimator
        return self.core.onboard.estimator.gains[0] if isinstance(config, CascadeConfig) else None  # type: ignore[union-attr]

    def scale_gain(self, which: int, factor: float) -> None:
        """Multiply a gain of all observers from now on: 0 is H, 1 alpha Lambda. Others than the cascade have none."""
        if self.gains is not None:
            self.gains[..., which] = np.clip(factor * self.gains[..., which], 1e-2, 1e5)

    def scene(self) -> "Scene":
        """What there is to see."""
        return self.picture.scene()

    def finish(self) -> None:
        """Write the log of the drive, if anything was driven."""
        if self._writer is not None and self._actions:
            self.written.append(self._writer.close())
        self._writer = None

    def _begin(self) -> None:
        self.core.reset(_ROW, [self.seed])
        self.picture.follow(new=True)

    def _move(self, action: Float) -> None:
        self.core.step(action[None], _ROW)
        self.picture.follow()

    @staticmethod
    def _free(folder: Path) -> Path:
        """A new folder's path."""
        number = 0
        while (folder / f"drive_{number:03d}").exists():
            number += 1
        return folder / f"drive_{number:03d}"


def _view(samples: Samples) -> View:
    """What the cameras gave in the one sample of one environment."""
    return samples.image[0, -1].copy(), samples.seen[0, -1].copy()


class _Memory(Eyes):
    """Stands in for the eyes of a simulation, one call after another, with what they saw."""

    def __init__(self, views: list[View]) -> None:
        self._views, self._at = views, 0

    def start(self, world: World, samples: Samples, truth: Truth, rows: Rows, thread: int = 0) -> None:
        self.look(world, samples, truth, rows, thread)

    def look(self, world: World, samples: Samples, truth: Truth, rows: Rows, thread: int = 0) -> None:  # noqa: ARG002
        samples.image[0, -1], samples.seen[0, -1] = self._views[self._at]
        truth.visible[0, -1] = samples.seen[0, -1]
        self._at += 1
