"""One episode of one agent, and what became of its estimates."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import code_of
from agents.policy import COSINE, INVERSE_RANGE, SINE, Policy, Task
from relloc_env.envs.onboard import POINT
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.metrics import convergence_time, first_crossing
from relloc_env.samples import Bool, Float, Float32

Frame = NDArray[np.uint8]


@dataclass(frozen=True)
class Episode:
    """T + 1 instants, from the start to the end; errors are estimate less truth."""

    time: Float
    """[s] (T + 1,)"""
    poses: Float
    """[m, m, rad] (T + 1, R, 3) of the robots, {W}."""
    points: Float
    """[m] (M, 3), {W}."""
    depth_error: Float
    """[m] (T + 1, R, M) along the optical axis; NaN where a point is not known yet."""
    pose_error: Float
    """[m, rad] (T + 1, P, 2) distance and angle."""
    bound: Float
    """[m, rad] (T + 1, 2) standard deviations of the bound of the pose of B in {A}: of the position along the worse of
    A's axes, and of the heading; for one robot, of the worst range, and 0."""
    information: Float
    """[nats] (T + 1,) J of the pose; for one robot, of its depths."""
    seen: Bool
    """(T + 1, R, M)"""
    blocked: Float
    """(T + 1, R) share of the action during which the shield held the robot."""
    reward: float
    """Sum over the episode, mean over the robots."""
    frames: list[Frame] = field(default_factory=list)
    """Pictures, one for each instant, where they were asked for."""

    def summary(self, success: tuple[float, float] = (0.05, 1.5)) -> dict[str, float | None]:
        """Scores as plain data; None for a time that did not come.

        Args:
            success: [m, deg] what counts as found.
        """
        length, angle = success[0], math.radians(success[1])
        joint = np.maximum(self.bound[:, 0] / length, self.bound[:, 1] / angle)
        bound = first_crossing(self.time, joint, 1.0)
        worst = np.abs(np.nan_to_num(self.depth_error, nan=np.inf)).max(axis=(1, 2))
        error = convergence_time(self.time, worst, length)
        if self.pose_error.shape[1]:
            pose = self.pose_error.max(axis=1)
            both = np.maximum(pose[:, 0] / length, pose[:, 1] / angle)
            error = max(error, convergence_time(self.time, both, 1.0))
            pose_end: list[float | None] = [float(pose[-1, 0]), math.degrees(pose[-1, 1])]
        else:
            pose_end = [None, None]
        steps = np.linalg.norm(np.diff(self.poses[..., :2], axis=0), axis=-1)
        return {
            "information_10s_nats": float(np.interp(10.0, self.time, self.information)),
            "information_end_nats": float(self.information[-1]),
            "bound_reached_s": _finite(bound),
            "errors_settled_s": _finite(error),
            "worst_depth_error_end_m": _finite(worst[-1]),
            "position_error_end_m": pose_end[0],
            "heading_error_end_deg": pose_end[1],
            "position_bound_end_m": float(self.bound[-1, 0]),
            "heading_bound_end_deg": math.degrees(self.bound[-1, 1]),
            "all_seen_by_all": float(self.seen.all(axis=(1, 2)).mean()),
            "blocked": float(self.blocked.mean()),
            "path_m": float(steps.sum(axis=0).mean()),
            "reward": self.reward,
        }


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def rollout(
    env: RellocParallelEnv,
    policy: Policy,
    seed: int,
    *,
    frames: bool = False,
    watch: Callable[[], object] = lambda: None,
    progress: Callable[[float], None] = lambda _: None,
    name: str = "",
) -> Episode:
    """Play one episode through the PettingZoo door.

    Args:
        env: with an estimator inside; with `render_mode="rgb_array"` where frames are wanted.
        policy: built for the task of this environment.
        seed: of the scenario, and of the policy.
        frames: whether to keep a picture of each instant.
        watch: called at each instant, when the environment is there.
        progress: told the part of the episode that is over.
        name: of the agent, for errors.
    """
    task = Task.of(env)
    name = name or type(policy).__name__
    with code_of(name, policy):
        policy.reset(1, seed)
    observations, infos = env.reset(seed=seed)
    if getattr(policy, "knows_truth", False):
        world = env.core.simulation.world
        with code_of(name, policy):
            policy.see(world.pose.copy(), world.points.copy())  # type: ignore[attr-defined]
    record = _Record(env, task)
    record.add(observations, infos, frames)
    watch()
    total = 0.0
    while env.agents:
        with code_of(name, policy):
            chosen = _checked(policy.act(task.rows(observations)), task)
        observations, rewards, _, _, infos = env.step(dict(zip(env.agents, chosen, strict=True)))
        total += sum(rewards.values()) / len(rewards)
        record.add(observations, infos, frames)
        watch()
        progress(record.count / task.config.max_cycles)
    return record.episode(total)


def _checked(actions: Any, task: Task) -> Float32:
    """The actions of the one environment, (R, A), or an error where they are none."""
    array = np.asarray(actions, np.float64)
    wanted = (1, task.robots, task.config.action_size)
    if array.shape != wanted or not np.isfinite(array).all():
        what = f"{array.shape}" if array.shape != wanted else f"{array[0].tolist()}"
        raise ValueError(f"`act` must give {wanted} finite numbers, but gives {what}")
    chosen: Float32 = array[0].astype(np.float32)
    return chosen


class _Record:
    def __init__(self, env: RellocParallelEnv, task: Task) -> None:
        self._env, self._task = env, task
        self._names = ("poses", "depth", "pose", "bound", "information", "seen", "blocked")
        self._kept: dict[str, list[Any]] = {name: [] for name in self._names}
        self._points: Float = np.zeros((task.targets, 3))
        self._frames: list[Frame] = []

    @property
    def count(self) -> int:
        """Actions so far."""
        return len(self._kept["poses"]) - 1

    def add(self, observations: dict[str, Float32], infos: dict[str, dict[str, Any]], frames: bool) -> None:
        """Note one instant."""
        task, robots = self._task, self._task.robots
        rows = task.rows(observations)
        truth = next(iter(infos.values()))
        if "information/pose" not in truth:
            raise ValueError("Argument `env` must compute the information bound: make it with `bound=True`")
        poses, self._points = truth["truth/poses"], truth["truth/points"]
        points = task.field(rows, "points").reshape(robots, task.targets, POINT)
        known = np.hypot(points[..., SINE], points[..., COSINE]) > 0.5
        offset = self._points[None, :, :2] - poses[:, None, :2]
        heading = poses[:, 2, None]
        depth = np.cos(heading) * offset[..., 0] + np.sin(heading) * offset[..., 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.where(known, points[..., COSINE] / points[..., INVERSE_RANGE] - depth, np.nan)
        joint, single = truth["information/pose"], truth["information/depth"][0]
        now = (
            poses, error, truth["errors/pose"], truth["bound_sd"], joint if robots > 1 else single,
            points[..., 0] > 0.5, task.field(rows, "blocked")[0, :, 0],
        )  # fmt: skip
        for name, value in zip(self._names, now, strict=True):
            self._kept[name].append(value)
        if frames:
            self._frames.append(self._env.render())

    def episode(self, reward: float) -> Episode:
        """Put everything together."""
        kept = {name: np.array(values) for name, values in self._kept.items()}
        return Episode(
            time=self._task.action_period * np.arange(self.count + 1, dtype=np.float64),
            poses=kept["poses"],
            points=self._points,
            depth_error=kept["depth"],
            pose_error=kept["pose"],
            bound=kept["bound"],
            information=kept["information"],
            seen=kept["seen"],
            blocked=kept["blocked"],
            reward=reward,
            frames=self._frames,
        )
