"""Episodes of an environment, written as logs."""

import re
import shutil
import warnings
import weakref
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from relloc_env.config import ConfigError
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.core import ROBOT_NAMES, Core
from relloc_env.folders import FolderLock, open_folder
from relloc_env.logs.episode import HEADER, LogWriter
from relloc_env.metrics import relative_poses, wrap
from relloc_env.samples import Float, Prior, Samples

_NAME = re.compile(r"episode_(\d+)")


class RecordLog(gym.Wrapper[Any, Any, Any, Any]):
    """Write every episode as a log that `relloc_env.replay` and `python -m relloc_env replay` read.

    An episode is written to `folder/episode_000`, `episode_001`, … when it ends, when the next starts, or at `close`.
    Where the folder has episodes of an earlier run, numbers go on after them. What is not written when the recorder is
    let go of without `close` is written then, with a warning. After `set_state` of the environment a new log begins:
    robots are told of that start what `guess` of the configuration says, with errors drawn anew.

    Args:
        env: an environment of this package.
        folder: where the logs go; made now.
        truth: whether to write the truth beside the samples; replays need it to score.
        overwrite: whether to remove the episodes of an earlier run from the folder.

    Raises:
        ConfigError: an environment of another package.
        OSError: a folder that cannot be made or not be written into, or that another recorder writes into.
    """

    def __init__(
        self, env: gym.Env[Any, Any], folder: str | Path, *, truth: bool = True, overwrite: bool = False
    ) -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, RellocEnv):
            raise ConfigError(f"Argument `env` must be an environment of relloc_env, but is {type(inner).__name__}")
        self._core = inner.core
        self._recording = _Recording(self._core, folder, truth=truth, overwrite=overwrite)
        self._finalizer = weakref.finalize(self, self._recording.abandon)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Finish the log of the last episode, if there is one, and begin the next."""
        self._recording.finish()
        result = self.env.reset(seed=seed, options=options)
        simulation = self._core.simulation
        self._recording.begin(simulation.prior, simulation.first, simulation.first_truth.pose[0])
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Act, and note the samples; the log is written at the end of the episode."""
        start = _start_here(self._core) if self._recording.jumped else None
        result = self.env.step(action)
        if start is not None:
            self._recording.finish()
            self._recording.begin(*start)
        self._recording.add()
        if result[2] or result[3]:
            self._recording.finish()
        return result

    def close(self) -> None:
        """Write what is left, and let others write into the folder."""
        try:
            self._recording.finish()
        finally:
            self._recording.release()
            super().close()


class _Recording:
    """The folder and the log that is being written; it outlives the wrapper that is never closed."""

    def __init__(self, core: Core, folder: str | Path, *, truth: bool, overwrite: bool) -> None:
        self._core, self._truth, self._restored = core, truth, core.restored
        self._configuration = core.config.to_dict()
        self._folder = open_folder(folder, "folder")
        self._lock: FolderLock | None = FolderLock(self._folder)
        self._writer: LogWriter | None = None
        earlier = [path for path in self._folder.iterdir() if _NAME.fullmatch(path.name)]
        if overwrite:
            for path in [path for path in earlier if (path / HEADER).is_file()]:
                shutil.rmtree(path)
                earlier.remove(path)
        self._episode = 1 + max((int(path.name.partition("_")[2]) for path in earlier), default=-1)

    @property
    def jumped(self) -> bool:
        """Whether the environment was put into another state since the log began."""
        return self._core.restored != self._restored

    def begin(self, prior: Prior, first: Samples, poses: Float) -> None:
        """Begin a log with one sample; `poses` [m, m, rad] (1, R, 3) are the true ones at it."""
        self._restored = self._core.restored
        if self._lock is None:
            self._lock = FolderLock(self._folder)
        points = self._core.simulation.world.points[0]
        self._writer = LogWriter(
            self._folder / f"episode_{self._episode:03d}",
            prior,
            points if self._truth else None,
            robots=ROBOT_NAMES[: self._core.config.robots],
            configuration=self._configuration,
        )
        self._count = 0
        self._note(first, poses)

    def add(self) -> None:
        """Note the samples of an action."""
        if self._writer is not None:
            self._note(self._core.simulation.samples, self._core.simulation.truth.pose[0])

    def _note(self, samples: Samples, poses: Float) -> None:
        """Write K samples down; messages that were made before the log began are no part of it."""
        assert self._writer is not None
        count = samples.arrived.shape[1]
        ages = np.arange(self._count + 1, self._count + 1 + count, dtype=np.uint64)  # of its first sample, and one more
        kept = np.where(ages < 64, (np.uint64(1) << np.minimum(ages, 63)) - np.uint64(1), ~np.uint64(0))
        samples = samples._replace(arrived=samples.arrived & kept[:, None])
        self._writer.add(samples, poses if self._truth else None)
        self._count += count

    def finish(self) -> Path | None:
        """Write the log, if there is one; a log that cannot be written is not tried again."""
        writer, self._writer = self._writer, None
        if writer is None:
            return None
        self._episode += 1
        return writer.close()

    def release(self) -> None:
        """Let others write into the folder; may be called twice."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def abandon(self) -> None:
        """Write what is left of a recorder that was never closed."""
        path = self.finish()
        self.release()
        if path is not None:
            warnings.warn(f"`RecordLog` was never closed: {path} holds its last episode so far", stacklevel=2)


def _start_here(core: Core) -> tuple[Prior, Samples, Float]:
    """What a log begins with that starts in mid-episode: prior, one sample, and the true poses at it."""
    simulation = core.simulation
    world, prior = simulation.world, simulation.prior
    if core.elapsed[0]:
        depth, pose = _guess(core)
        prior = prior._replace(depth=depth, pose=pose)
    first = Samples._make(part[:, -1:].copy() for part in simulation.samples)
    first.period[:] = 0.0
    first.odometry[:] = 0.0
    return prior, first, world.pose[:1].copy()


def _guess(core: Core) -> tuple[Float, Float]:
    """Depths [m] (1, R, M) and poses [m, m, rad] (1, P, 3) that robots are told, as at a start where they are now."""
    guess, world = core.config.guess, core.simulation.world
    rng = np.random.default_rng(world.streams[0].ravel().tolist())

    def error(size: Any, shape: tuple[int, ...]) -> Float:
        signs = np.ones(shape) if guess.kind == "positive" else rng.choice((-1.0, 1.0), shape)
        drawn: Float = size * (rng.standard_normal(shape) if guess.kind == "gaussian" else signs)
        return drawn

    to = world.points[0, None, :, :2] - world.pose[0, :, None, :2]
    heading = world.pose[0, :, None, 2]
    depth = np.cos(heading) * to[..., 0] + np.sin(heading) * to[..., 1]
    near = np.array([[core.config.camera_of(r).near] for r in range(core.config.robots)])
    depth = np.where((depth < near) | (depth <= 0.0), np.hypot(to[..., 0], to[..., 1]), depth)
    depth = np.maximum(depth + error(guess.depth, depth.shape), 0.3)
    pose = relative_poses(world.pose[0])
    pose += error((guess.position, guess.position, np.radians(guess.heading)), pose.shape)
    pose[:, 2] = wrap(pose[:, 2])
    return depth[None], pose[None]
