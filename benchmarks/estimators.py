"""How far each estimator is from the information bound, and how honest about it: scenes, estimators, figures."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.estimator_cost import cost
from benchmarks.estimator_targets import targets
from benchmarks.scenarios import DT, POINTS, Runs, Scene, bounds, draw
from relloc_env.estimators import make
from relloc_env.estimators.config import PRESETS, BuiltIn
from relloc_env.files import write_json
from relloc_env.folders import open_folder
from relloc_env.metrics import nees, pose_errors, wrap
from relloc_env.samples import Bool, Float, Samples

Tell = Callable[[float, str], object]
BATCH = 100
"""Runs at once."""
TIMES = (5.0, 10.0, 20.0, 40.0)
"""[s] at which the errors are looked at."""
FAR = (0.5, math.radians(20.0))
"""[m, rad] an error beyond either is a lost run."""
BROKEN = (1e3, 1e3, math.pi)
"""[m, m, rad] error that stands for an estimate which is not a number."""


@dataclass(frozen=True)
class Row:
    """One scene with some estimators."""

    words: str
    scene: Scene
    estimators: tuple[str, ...] = ("map-alignment", "inverse-depth", "cascade", "cascade-critical")
    """Names of the registry."""
    late: int = 0
    """[samples] before each of the times at which the errors are looked at: just before the next alignment."""
    judged_from: float = 5.0
    """[s] from which on the targets are meant."""
    options: tuple[tuple[str, Any], ...] = ()
    """Options of map-alignment besides the noise."""


OURS = ("map-alignment",)
BASE = Scene()
ROWS: Mapping[str, Row] = {
    "paper": Row("paper-like geometry, 0.002 / 0.005", Scene(paper=True, missed=0.0)),
    "random": Row("random, 20 % missed", BASE),
    "outliers": Row("20 % missed, 2 % outliers, 0.005 / 0.0075", Scene(0.005, 0.0075, outliers=0.02)),
    "noisy": Row("random, 20 % missed, 0.01 / 0.01", Scene(0.01, 0.01)),
    "still": Row("w_A = 0", Scene(still_a=True)),
    "straight": Row("straight motion", Scene(straight=True)),
    "no-prior": Row("no prior on the pose", Scene(no_prior=True), judged_from=20.0),
    "height": Row("2 cm of height error", Scene(height=0.02)),
    "scale": Row("2 % of odometry scale", Scene(scale=0.02)),
    "every-1": Row("random, aligned at 20 Hz", BASE, OURS, 1),
    "every-2": Row("random, aligned at 10 Hz", BASE, OURS, 1, options=(("align_every", 2),)),
    "every-4": Row("random, aligned at 5 Hz", BASE, OURS, 1, options=(("align_every", 4),)),
    "every-20": Row("random, aligned at 1 Hz", BASE, OURS, 1, options=(("align_every", 20),)),
}


def configuration(name: str, row: Row) -> BuiltIn:
    """Options of an estimator in a row: it is told the noise, and what it does not know where it has a state for it."""
    scene = row.scene
    told: dict[str, Any] = {"image_noise": scene.image_noise, "odometry_noise": (scene.odometry_noise,) * 2}
    if name == "map-alignment":
        told |= {"height_sd": scene.height, "scale_sd": (scene.scale,) * 2, "align_every": 1, **dict(row.options)}
    return PRESETS[name].model_copy(update=told)


def run(
    out: Path, *, only: Sequence[str] | None = None, runs: int = 1000, seconds: float = 40.0, seed: int = 0,
    timed: int = 4, tell: Tell = lambda *_: None,
) -> dict[str, Any]:  # fmt: skip
    """Measure, and write `estimators.json` into a folder, anew after each row.

    Args:
        out: folder, made where it is missing.
        only: rows to measure; None for all.
        runs: of each row.
        seconds: how long each run is.
        seed: of everything random, with the name of the first row that has the scene.
        timed: runs for each number of points over which the time of a sample is measured; 0: it is not.
        tell: told the part that is done.

    Returns:
        What `estimators.json` holds.

    Raises:
        ValueError: a name that no row has.
    """
    for name in only or ():
        if name not in ROWS:
            raise ValueError(f"Argument `only` must be among {', '.join(ROWS)}, but has `{name}`")
    out = open_folder(out)
    names, scenes = list(only or ROWS), {name: row.scene for name, row in ROWS.items()}
    results: dict[str, Any] = {"settings": {"runs": runs, "seconds": seconds, "seed": seed}, "rows": []}
    if timed:
        tell(0.0, "cost of a sample")
        results["cost"] = cost(seed, timed, seconds)
    for index, name in enumerate(names):
        row = ROWS[name]
        parts: dict[str, list[Found]] = {which: [] for which in row.estimators}
        batches = math.ceil(runs / BATCH)
        for batch in range(batches):
            tell((index + batch / batches) / len(names), row.words)
            count = min(BATCH, runs - batch * BATCH)
            for which, found in measure(name, count, seconds, seed, batch):
                parts[which].append(found)
        for which, some in parts.items():
            results["rows"].append({"name": name, "words": row.words, "estimator": which, **figures(some)})
        results["targets"] = list(targets(results, scenes, {name: row.judged_from for name, row in ROWS.items()}))
        write_json(out / "estimators.json", results)
    return results


@dataclass(frozen=True)
class Found:
    """Errors (T, N, 3) of B's pose in A's frame at T times, claimed covariances and bounds (T, N, 3, 3)."""

    times: tuple[float, ...]
    errors: Float
    claimed: Float
    bound: Float
    back: Float
    """(T, N) NEES of A's pose in B's frame."""


def measure(name: str, runs: int, seconds: float, seed: int, batch: int) -> Iterator[tuple[str, Found]]:
    """Run all estimators of a row over the same runs; yields the name of each with what was found."""
    row = ROWS[name]
    times = tuple(time for time in TIMES if time <= seconds)
    at = [round(time / DT) - row.late for time in times]
    # Rows of one scene have the same runs.
    first = next(other for other, entry in ROWS.items() if entry.scene == row.scene)
    drawn = draw(row.scene, runs, seconds, np.random.default_rng([seed, batch, *first.encode()]))
    bound = bounds(drawn, row.scene, at)
    for which in row.estimators:
        errors, claimed = follow(drawn, configuration(which, row), at)
        back = nees(errors[:, :, 1], claimed[:, :, 1])
        yield which, Found(times, errors[:, :, 0], claimed[:, :, 0], bound, back)


def follow(runs: Runs, config: BuiltIn, at: list[int]) -> tuple[Float, Float]:
    """Errors (T, N, 2, 3) and claimed covariances (T, N, 2, 3, 3) of one estimator after the samples `at`."""
    n = len(runs.truth.points)
    estimator, rows = make(config, n, 2, POINTS), np.arange(n)
    estimator.reset(runs.prior, rows)
    errors, claimed, first = [], [], 0
    for k in at:
        estimator.update(Samples._make(np.ascontiguousarray(x[:, first : k + 1]) for x in runs.samples), rows)
        first = k + 1
        errors.append(pose_errors(estimator.estimate, runs.truth.poses[:, k]))
        claimed.append(estimator.estimate.pose_covariance.copy())
    return np.array(errors), np.array(claimed)


def figures(parts: Sequence[Found]) -> dict[str, Any]:
    """What is said of a row: lists by time."""
    times = parts[0].times
    errors, claimed, bound, back = (
        np.concatenate([getattr(part, field) for part in parts], axis=1)
        for field in ("errors", "claimed", "bound", "back")
    )
    errors[..., 2] = wrap(errors[..., 2])
    broken = ~(np.isfinite(errors).all(axis=-1) & np.isfinite(claimed).all(axis=(-2, -1)))
    errors[broken], claimed[broken] = BROKEN, np.eye(3)
    square, honest = nees(errors, bound), nees(errors, claimed)
    rmse = np.sqrt(np.mean(errors**2, axis=1))
    least = np.sqrt(np.mean(np.diagonal(bound, axis1=-2, axis2=-1), axis=1))
    normal = np.random.default_rng(0).standard_normal((*errors.shape, 100))
    at_bound = np.moveaxis(np.linalg.cholesky(bound) @ normal, -2, -1)
    return {
        "runs": errors.shape[1],
        "times": list(times),
        "whitened": np.sqrt(np.mean(square, axis=1) / 3.0).tolist(),
        "rmse": rmse.tolist(),
        "bound": least.tolist(),
        "ratio": (rmse / least).tolist(),
        "nees": np.mean(honest, axis=1).tolist(),
        "nees_median": np.median(honest, axis=1).tolist(),
        "nees_quantile": np.quantile(honest, 0.95, axis=1).tolist(),
        "inconsistent": np.mean(honest > 30.0, axis=1).tolist(),
        "lost": np.mean(_far(errors), axis=1).tolist(),
        "lost_at_bound": np.mean(_far(at_bound), axis=(1, 2)).tolist(),
        "broken": np.mean(broken, axis=1).tolist(),
        "nees_back": np.mean(np.where(np.isfinite(back), back, BROKEN[0] ** 2), axis=1).tolist(),
    }


def _far(errors: Float) -> Bool:
    """Which errors (..., 3) are of a lost run."""
    return (np.hypot(errors[..., 0], errors[..., 1]) > FAR[0]) | (np.abs(errors[..., 2]) > FAR[1])
