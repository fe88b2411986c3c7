"""What an estimator checks of what it is given, before compiled code runs over the arrays."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.samples import Prior, Rows, Samples


def check_array(name: str, array: NDArray[Any], dtype: Any, shape: tuple[int, ...]) -> None:
    """Raise where an array is not what compiled code expects."""
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous:
        raise ValueError(
            f"Argument `{name}` must be a C-contiguous array of {np.dtype(dtype)} with shape {shape}, "
            f"but is {array.dtype} with shape {array.shape}."
        )


def check_prior(prior: Prior, num_envs: int, robots: int, points: int) -> None:
    """Raise where a prior does not fit the estimator."""
    check_array("prior.depth", prior.depth, np.float64, (num_envs, robots, points))
    check_array("prior.pose", prior.pose, np.float64, (num_envs, robots * (robots - 1), 3))
    check_array("prior.pose_sd", prior.pose_sd, np.float64, (3,))
    if not (prior.depth_sd > 0.0 and (prior.pose_sd > 0.0).all()):
        raise ValueError(
            "Arguments `prior.depth_sd` and `prior.pose_sd` must be positive, "
            f"but are {prior.depth_sd} and {prior.pose_sd.tolist()}."
        )


def check_samples(samples: Samples, num_envs: int, robots: int, points: int) -> None:
    """Raise where samples do not fit the estimator."""
    n, k = num_envs, samples.period.shape[-1]
    check_array("samples.period", samples.period, np.float64, (n, k))
    check_array("samples.odometry", samples.odometry, np.float32, (n, k, robots, 3))
    check_array("samples.image", samples.image, np.float32, (n, k, robots, points, 2))
    check_array("samples.seen", samples.seen, np.bool_, (n, k, robots, points))
    check_array("samples.arrived", samples.arrived, np.uint64, (n, k, robots * (robots - 1)))


def check_finite(samples: Samples, rows: Rows) -> None:
    """Raise at the first sample of `rows` that holds what is no number; coordinates of points not seen may be anything.

    Estimators call this themselves, and drivers of estimators for the samples that they read from elsewhere. The
    simulator's are finite as they are made: see `trust`.
    """
    image = np.isfinite(samples.image[rows]) | ~samples.seen[rows][..., None]
    image[..., 1] |= np.isnan(samples.image[rows][..., 1])  # a bearing without a height
    period = np.isfinite(samples.period[rows]) & (samples.period[rows] >= 0.0)
    for name, good in (("period", period), ("odometry", np.isfinite(samples.odometry[rows])), ("image", image)):
        if not good.all():
            n, k, *rest = (int(i) for i in np.argwhere(~good)[0])
            where = f" of robot {rest[0]}" if rest else ""
            where += f" and point {rest[1]}" if name == "image" else ""
            value = getattr(samples, name)[(rows[n], k, *rest)]
            must = "finite and not negative" if name == "period" else "finite"
            raise ValueError(
                f"Argument `samples.{name}` must be {must}, but is {value} in sample {k} (from 0) of environment "
                f"{rows[n]}{where}."
            )


def trust(estimator: Any) -> None:
    """Have an estimator of this package take samples and priors as they are, since they are known to be finite."""
    if hasattr(estimator, "trusted"):
        estimator.trusted = True


def check_finite_prior(prior: Prior, rows: Rows) -> None:
    """Raise where a prior of `rows` holds what is no number, or no depth."""
    depth, pose = prior.depth[rows], prior.pose[rows]
    if not (np.isfinite(depth) & (depth > 0.0)).all():
        raise ValueError(f"Argument `prior.depth` must be finite and positive, but is {depth.tolist()}.")
    if not np.isfinite(pose).all() or not np.isfinite([prior.depth_sd, *prior.pose_sd]).all():
        raise ValueError(
            "Arguments `prior.pose`, `prior.depth_sd` and `prior.pose_sd` must be finite, "
            f"but are {pose.tolist()}, {prior.depth_sd} and {np.asarray(prior.pose_sd).tolist()}."
        )


def check_rows(rows: Rows, num_envs: int) -> None:
    """Raise where `rows` are not indices of environments."""
    if rows.dtype != np.int64 or rows.ndim != 1:
        raise ValueError(f"Argument `rows` must be a vector of int64, but is {rows.dtype} with shape {rows.shape}.")
    if len(rows) and not (rows.min() >= 0 and rows.max() < num_envs):
        raise IndexError(f"Argument `rows` must lie in [0, {num_envs}), but is {rows.tolist()}.")


def put_state(arrays: Mapping[str, NDArray[Any]], state: Mapping[str, NDArray[Any]], rows: Rows) -> None:
    """Put back into `arrays` (N first) what was remembered of as many rows; raise first where it does not fit."""
    if state.keys() != arrays.keys():
        raise ValueError(f"Argument `state` must have the keys {sorted(arrays)}, but has {sorted(state)}.")
    for name, array in arrays.items():
        check_array(f"state[{name!r}]", state[name], array.dtype, (len(rows), *array.shape[1:]))
    for name, array in arrays.items():
        array[rows] = state[name]
