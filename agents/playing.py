"""Many episodes of one agent at once, and what became of each: scores, and how they came about over time."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from agents.errors import code_of
from agents.policy import Policy, Task
from relloc_env.config import EnvConfig
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.metrics import bound_range_sd, convergence_time, first_crossing, nees, pose_errors
from relloc_env.rewards import BLOCKED, EXCITATION
from relloc_env.samples import Float

DEPTH_SHARE = 0.05
"""[-] share of the true range at which a depth counts as found."""
POSE = (0.05, 1.5)
"""[m, deg] at which a pose counts as found."""
AFTER = 10.0
"""[s] when the information is looked at on the way."""
BROKEN = 1e3
"""[m; of the range] greatest error: that of an estimate which is not a number."""
LATE = "time_"
"""How the names of scores begin that are infinite where something never happened."""

SCORES: Mapping[str, str] = {
    "information_10s": "J after 10 s [nats]",
    "information_mean": "J, mean over time [nats]",
    "information_end": "J at the end [nats]",
    "time_bound_depth": "bound of every depth first below 5 % [s]",
    "time_bound_pose": "bound of the pose first below 0.05 m along A's axes and 1.5°; alone, of every range [s]",
    "time_depth": "errors of every depth below 5 % from then on [s]",
    "time_pose": "errors of the pose below 0.05 m and 1.5° from then on [s]",
    "depth_error_end": "RMS depth error at the end, share of the range [-]",
    "position_error_end": "position error at the end [m]",
    "heading_error_end": "heading error at the end [deg]",
    "depth_error_area": "depth error, share of the range, over time [s]",
    "position_error_area": "position error over time [m s]",
    "excitation": "smallest excitation ∫σ² dt of a point [m²/s]",
    "position_bound_end": "bound of the position at the end, along the worse of A's axes [m]",
    "heading_bound_end": "bound of the heading at the end [deg]",
    "over_bound": "errors of the pose at the end in units of the bound [-]",
    "nees": "NEES of the pose at the end [-]",
    "seen": "share of the time in which all see all [-]",
    "path": "way of a robot [m]",
    "collisions": "actions in which a robot touched something",
    "blocked": "share of the samples in which the shield held a robot [-]",
    "change_speed": "change of the commanded speed from action to action, share of the greatest [-]",
    "change_yaw_rate": "change of the commanded yaw rate from action to action, share of the greatest [-]",
}
"""What is scored in each episode, and in what unit. Times and areas are told apart by estimator; J, bounds are not."""

CURVES = (
    "information", "depth_share", "position_error", "heading_error", "depth_bound", "position_bound", "heading_bound",
    "excitation",
)  # fmt: skip
"""What is kept over time, as quartiles over the episodes."""
KEPT = 6
"""Episodes of which the ways are kept."""


def play(
    config: EnvConfig,
    build: Callable[[Task], Policy],
    seeds: Sequence[int],
    *,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[dict[str, Float], dict[str, Float]]:
    """Play one episode per seed, side by side.

    Args:
        config: of the environments; the bound is computed, and no episode ends early.
        build: makes the policy from the task.
        seeds: of the episodes; the first one is the policy's as well.
        threads: as for `RellocVectorEnv`.
        progress: told the part that is done.

    Returns:
        `SCORES` of each episode, (N,) each; and what was there over time: `time` [s] (T,), `CURVES` (N, T), `ways` of
        the first episodes [m, m, rad] (`KEPT`, T, R, 3) and their `points` [m] (`KEPT`, M, 3).
    """
    config = config.model_copy(update={"bound": True, "terminate_on_collision": False, "terminate_on_success": False})
    env = RellocVectorEnv(
        len(seeds), config, autoreset_mode="Disabled", info=(), copy=False, threads=threads
    )  # fmt: skip
    task = Task.of(env)
    with code_of(what_is(build), build):
        policy = build(task)
    what = what_is(policy)
    with code_of(what, policy):
        policy.reset(len(seeds), int(seeds[0]))
    observations, _ = env.reset(seed=[int(seed) for seed in seeds])
    if getattr(policy, "knows_truth", False):
        with code_of(what, policy):
            policy.see(env.core.simulation.world.pose.copy(), env.core.simulation.world.points.copy())  # type: ignore[attr-defined]
    record = _Record(env, task)
    record.add()
    shape = (len(seeds), task.robots, config.action_size)
    for k in range(config.max_cycles):
        with code_of(what, policy):
            actions = np.asarray(policy.act(task.rows(observations)), np.float64)
        if actions.shape != shape:
            raise ValueError(
                f"Argument `agents` must lead to policies whose `act` gives {shape} numbers with `action` "
                f'"{config.action}", but {what} gives {actions.shape}'
            )
        observations = env.step(actions.reshape(len(seeds), -1))[0]
        record.add(actions)
        progress((k + 1) / config.max_cycles)
    return record.scores(), record.curves()


def what_is(thing: Any) -> str:
    """What to call a policy, or what builds one, in errors."""
    return str(getattr(thing, "what", None) or getattr(thing, "__name__", None) or type(thing).__name__)


class _Record:
    """What is noted after each action, read from the truth and the bound."""

    def __init__(self, env: RellocVectorEnv, task: Task) -> None:
        self._core, self._task = env.core, task
        self._kept: dict[str, list[Float]] = {}
        self._touched: Float = np.zeros(env.num_envs)
        self._path: Float = np.zeros(env.num_envs)
        self._last: Float | None = None
        self._commands: list[Float] = []

    def add(self, actions: Float | None = None) -> None:
        core = self._core
        if actions is not None:
            self._commands.append(np.clip(actions[..., :2], -1.0, 1.0))
        world, score = core.simulation.world, core.score
        distance = np.linalg.norm(world.points[:, None, :, :2] - world.pose[:, :, None, :2], axis=-1)
        bound = bound_range_sd(score.bound_factor, score.bound_variances, world.pose, world.points, world.origin)
        bound /= distance
        share = np.abs(score.depth_error) / distance
        share = np.where(share < BROKEN, share, BROKEN)
        n, pair = len(distance), core.config.robots > 1
        error = self._pose_error() if pair else np.full((n, 3), np.nan)
        now = {
            "information": score.pose_information if pair else score.depth_information[:, 0],
            "depth_bound": bound.max(axis=(1, 2)),
            "depth_share": share.max(axis=(1, 2)),
            "depth_rms": np.sqrt(np.mean(np.square(share), axis=(1, 2))),
            "position_error": np.hypot(error[:, 0], error[:, 1]),
            "heading_error": np.degrees(np.abs(error[:, 2])),
            "position_bound": score.worst_sd[:, 0],
            "heading_bound": np.degrees(score.worst_sd[:, 1]),
            "excitation": score.terms[:, :, EXCITATION].min(axis=1),
            "seen": world.visible.all(axis=(1, 2)),
            "blocked": score.terms[:, :, BLOCKED].mean(axis=1),
            "ways": world.pose[:KEPT],
        }
        for name, value in now.items():
            self._kept.setdefault(name, []).append(np.array(value, np.float64))
        self._touched += world.collided.any(axis=1)
        if self._last is not None:
            self._path += np.linalg.norm(world.pose[..., :2] - self._last, axis=-1).mean(axis=1)
        self._last = world.pose[..., :2].copy()

    def _pose_error(self) -> Float:
        """Errors of B's pose in {A}, (N, 3); `BROKEN` where the estimate is not a number."""
        core = self._core
        error = pose_errors(core.onboard.estimate, core.simulation.world.pose)[:, 0]
        return np.where(np.isfinite(error).all(axis=1, keepdims=True), error, (BROKEN, BROKEN, math.pi))

    def curves(self) -> dict[str, Float]:
        """See `play`."""
        over: dict[str, Float] = {name: np.stack(self._kept[name], axis=1) for name in (*CURVES, "ways")}
        over["excitation"] = np.cumsum(over["excitation"], axis=1)
        return over | {"time": self._time, "points": self._core.simulation.world.points[:KEPT].copy()}

    @property
    def _time(self) -> Float:
        return self._task.action_period * np.arange(len(self._kept["seen"]), dtype=np.float64)

    def scores(self) -> dict[str, Float]:
        """See `SCORES`; NaN for what is none of one robot alone."""
        time = self._time
        over = {name: np.stack(values, axis=1) for name, values in self._kept.items() if name != "ways"}
        core, pair = self._core, self._core.config.robots > 1
        score, estimate = core.score, core.onboard.estimate
        length = time[-1]
        none = np.full(len(over["seen"]), np.nan)
        j = over["information"]
        changes = np.abs(np.diff(self._commands, axis=0)).sum(axis=0).mean(axis=1) / max(1, len(self._commands) - 1)
        scores = {
            "information_10s": np.array([np.interp(AFTER, time, line) for line in j]),
            "information_mean": np.trapezoid(j, time, axis=1) / length,
            "information_end": j[:, -1],
            "time_bound_depth": first_crossing(time, over["depth_bound"], DEPTH_SHARE),
            "time_depth": convergence_time(time, over["depth_share"], DEPTH_SHARE),
            "depth_error_end": over["depth_rms"][:, -1],
            "depth_error_area": np.trapezoid(over["depth_rms"], time, axis=1),
            "excitation": over["excitation"].sum(axis=1),
            "seen": over["seen"].mean(axis=1),
            "path": self._path,
            "collisions": self._touched,
            "blocked": over["blocked"][:, 1:].mean(axis=1),
            "change_speed": changes[:, 0],
            "change_yaw_rate": changes[:, 1],
        }
        if pair:
            error = self._pose_error()
            bound_at, error_at = (
                first(time, np.maximum(over[f"position_{kind}"] / POSE[0], over[f"heading_{kind}"] / POSE[1]), 1.0)
                for first, kind in ((first_crossing, "bound"), (convergence_time, "error"))
            )
            scores |= {
                "time_bound_pose": bound_at,
                "time_pose": error_at,
                "position_error_end": over["position_error"][:, -1],
                "heading_error_end": over["heading_error"][:, -1],
                "position_error_area": np.trapezoid(over["position_error"], time, axis=1),
                "position_bound_end": over["position_bound"][:, -1],
                "heading_bound_end": over["heading_bound"][:, -1],
                "over_bound": np.sqrt(nees(error, score.pose_covariance) / 3.0),
                "nees": nees(error, estimate.pose_covariance[:, 0]),
            }
        else:
            scores |= {
                "time_bound_pose": first_crossing(time, over["position_bound"], POSE[0]),
                "position_bound_end": over["position_bound"][:, -1],
            }
        return {name: np.asarray(scores.get(name, none), np.float64) for name in SCORES}


def quartiles(values: Float) -> Float:
    """First quartile, median and third quartile over the episodes, (3, T), of (N, T); NaN where any is."""
    return np.quantile(values, (0.25, 0.5, 0.75), axis=0)


def settled(values: Float) -> float:
    """Share of the episodes in which a time is finite."""
    return float(np.mean(np.isfinite(values))) if len(values) else math.nan


def empty(value: Any) -> bool:
    """Whether a score is none of this task: NaN in every episode."""
    return bool(np.all(np.isnan(value)))
