"""Why filtered depths must not be fed in as white measurements: the figure of docs/estimator.md, and its numbers."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from relloc_env.envs.onboard import informed
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.estimators import make, resolve
from relloc_env.extras import extra
from relloc_env.files import whole, write_json
from relloc_env.folders import open_folder
from relloc_env.metrics import nees, nees_band, point_errors, pose_errors
from relloc_env.samples import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ESTIMATORS: Mapping[str, tuple[str, str]] = {
    "cascade": ("cascade: filtered depths fed in as white", "#d62728"),
    "cascade-critical": ("the same, with the depths' own covariances", "#ff7f0e"),
    "map-alignment": ("map-alignment", "#1f77b4"),
}
"""What each line is, and its colour."""
HEIGHT = 0.3
"""[m] of both cameras."""
SCENE: Mapping[str, Any] = {
    "arena": None,
    "shield": None,
    "bound": True,
    "samples_per_action": 10,
    "robot": {
        "max_speed": 0.2,
        "max_yaw_rate": 0.1,
        "odometry_noise": (0.005, 0.005),
        "radius": 0.01,
        "height": 0.05,
    },
    "camera": {"preset": "unlimited", "pixel_noise": 0.64, "mount_height": HEIGHT},
    "poses": [(0.0, -0.8, -0.1), (0.0, 1.0, 0.25)],
    "points": [(7.0, 0.8, HEIGHT + 0.4), (7.0, -1.2, HEIGHT + 0.3)],
}
"""The paper-like geometry of docs/equations.md, section 5; a pixel is 1/320. Initial errors have random signs. Robots
are tiny, since their ways meet."""
ACTION = np.array([0.5, 0.2, 0.5, -0.3], np.float32)
"""0.1 m/s each, 0.02 and -0.03 rad/s."""
FROM = 10.0
"""[s] from which the correlation of the depths' errors is counted."""


class Course(NamedTuple):
    """One estimator over N runs, at T times."""

    error: Float
    """[m, m, rad] (T, N, 3) of B's pose in A's frame."""
    claimed: Float
    """(T, N, 3, 3) covariance."""
    depth: Float
    """[m] (T, N, M) errors of the depths that A believes."""
    depth_claimed: Float
    """[m²] (T, N, M) their claimed variances."""


def run(
    out: Path, *, runs: int = 200, seconds: float = 40.0, seed: int = 0, tell: Callable[[float, str], object]
) -> dict[str, Any]:
    """Run the estimators on the paper-like geometry; write `consistency.json` and `consistency.png` into a folder.

    Args:
        out: folder, made where it is missing.
        runs: with fresh noise and fresh signs of the initial errors each.
        seconds: how long each run is, a multiple of 0.5, more than `FROM`.
        seed: of everything random.
        tell: told the part that is done, and with what.

    Returns:
        What `consistency.json` holds.
    """
    out = open_folder(out)
    time, bound, courses = _simulate(runs, round(seconds / 0.5), seed, tell)
    sd = np.sqrt(np.diagonal(bound, axis1=1, axis2=2))
    results: dict[str, Any] = {
        "settings": {"runs": runs, "seconds": seconds, "seed": seed},
        "time_s": _plain(time),
        "bound": {"position_m": _plain(np.hypot(sd[:, 0], sd[:, 1])), "heading_deg": _plain(np.degrees(sd[:, 2]))},
        "nees_band_95": list(nees_band(3, runs)),
        "estimators": {name: figures(time, course) for name, course in courses.items()},
    }
    write_json(out / "consistency.json", results, indent=None)
    _draw(results, out / "consistency.png")
    return results


def _simulate(
    runs: int, actions: int, seed: int, tell: Callable[[float, str], object]
) -> tuple[Float, Float, dict[str, Course]]:
    """Times (T,) [s] after each action, the bound (T, 3, 3) of B's pose, and the estimators' courses."""
    env = RellocVectorEnv(runs, SCENE, estimator=None, max_cycles=actions + 1, info=())
    simulation, rows = env.core.simulation, np.arange(runs)
    env.reset(seed=seed)
    heights = np.array([HEIGHT, HEIGHT])
    chosen = {name: make(informed(env.config, resolve(name)), runs, 2, 2) for name in ESTIMATORS}
    kept: dict[str, list[tuple[Float, ...]]] = {name: [] for name in chosen}
    for estimator in chosen.values():
        estimator.reset(simulation.prior, rows)
        estimator.update(simulation.first, rows)
    bound = []
    for k in range(actions):
        tell(k / actions, f"{k} of {actions}")
        env.step(np.tile(ACTION, (runs, 1)))
        bound.append(env.core.score.pose_covariance[0].copy())
        poses, points = simulation.world.pose, simulation.world.points
        for name, estimator in chosen.items():
            estimator.update(simulation.samples, rows)
            estimate = estimator.estimate
            depth = point_errors(estimate, poses, points, heights).depth[:, 0]
            claimed = _depth_variance(estimate.points[:, 0], estimate.points_covariance[:, 0])
            error = pose_errors(estimate, poses)[:, 0]
            kept[name].append((error, estimate.pose_covariance[:, 0].copy(), depth, claimed))
    courses = {name: Course(*map(np.array, zip(*parts, strict=True))) for name, parts in kept.items()}
    return np.linspace(0.5, 0.5 * actions, actions), np.array(bound), courses


def _depth_variance(points: Float, covariance: Float) -> Float:
    """Variance [m²] of the depths cos(beta)/rho of polar points."""
    beta, rho = points[..., 0], points[..., 2]
    slope = np.stack([-np.sin(beta) / rho, np.zeros_like(rho), -np.cos(beta) / rho**2], axis=-1)
    return np.asarray(np.einsum("...i,...ij,...j->...", slope, covariance, slope))


def figures(time: Float, course: Course) -> dict[str, Any]:
    """What is said of an estimator, as plain data: over time, and over the time that passes from `FROM` on."""
    variance = np.diagonal(course.claimed, axis1=-2, axis2=-1).mean(axis=1)
    square = np.mean(course.error**2, axis=1)
    late = np.flatnonzero(time >= FROM - 1e-9)
    error = course.depth[late] - course.depth[late].mean(axis=1, keepdims=True)
    product = np.mean(error[0] * error, axis=1) / np.sqrt(np.mean(error[0] ** 2, axis=0) * np.mean(error**2, axis=1))
    return {
        "rmse_position_m": _plain(np.sqrt(square[:, 0] + square[:, 1])),
        "claimed_position_m": _plain(np.sqrt(variance[:, 0] + variance[:, 1])),
        "rmse_heading_deg": _plain(np.degrees(np.sqrt(square[:, 2]))),
        "claimed_heading_deg": _plain(np.degrees(np.sqrt(variance[:, 2]))),
        "nees": _plain(np.mean(nees(course.error, course.claimed), axis=1)),
        "rmse_depth_m": _plain(np.sqrt(np.mean(course.depth**2, axis=(1, 2)))),
        "claimed_depth_m": _plain(np.sqrt(np.mean(course.depth_claimed, axis=(1, 2)))),
        "lag_s": _plain(time[late] - time[late[0]]),
        "depth_correlation": _plain(np.mean(product, axis=1)),
    }


def _plain(values: Float) -> list[float]:
    """Five digits of each."""
    return [float(f"{value:.5g}") for value in values]


def _draw(results: Mapping[str, Any], path: Path) -> None:
    with extra("logs"):
        from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 7.4), layout="constrained")
    (first, second), (third, fourth) = figure.subplots(2, 2)
    time, bound = results["time_s"], results["bound"]
    for name, found in results["estimators"].items():
        words, colour = ESTIMATORS[name]
        if name == "cascade":
            first.plot(found["lag_s"], found["depth_correlation"], color=colour, lw=1.6)
        for axis, part in ((second, "position_m"), (third, "heading_deg")):
            axis.plot(time, found[f"rmse_{part}"], color=colour, lw=1.6)
            axis.plot(time, found[f"claimed_{part}"], color=colour, lw=1.4, ls="--")
        fourth.plot(time, found["nees"], color=colour, lw=1.6, label=words)
    first.plot([0.0, 0.05, results["estimators"]["cascade"]["lag_s"][-1]], [1.0, 0.0, 0.0], color="grey", lw=1.2)
    first.annotate(
        "white: what the pose filter assumes", (0.97, 0.12), xycoords="axes fraction", ha="right", color="grey"
    )
    first.set(
        title=f"a filtered depth's error at {FROM:.0f} s and later", xlabel="time between [s]", ylabel="correlation",
        ylim=(-0.1, 1.05),
    )  # fmt: skip
    for axis, part, words in ((second, "position_m", "position [m]"), (third, "heading_deg", "heading [deg]")):
        axis.plot(time, bound[part], color="black", lw=1.2, ls=":", label="bound")
        axis.plot([], [], color="grey", lw=1.6, label="RMS error")
        axis.plot([], [], color="grey", lw=1.4, ls="--", label="claimed")
        _logarithmic(axis, words)
        axis.legend(loc="best", fontsize="small", ncols=3)
    fourth.axhspan(*results["nees_band_95"], color="grey", alpha=0.35, lw=0, label="95 % when right")
    _logarithmic(fourth, "mean NEES (3 is right)")
    fourth.axhline(3.0, color="grey", lw=0.8)
    for axis in (first, second, third, fourth):
        axis.grid(alpha=0.3)
    figure.legend(*fourth.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    with whole(path) as partial:
        figure.savefig(partial, dpi=110)


def _logarithmic(axis: "Axes", words: str) -> None:
    axis.set(yscale="log", title=words, xlabel="time [s]")
