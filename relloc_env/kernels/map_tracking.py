"""The local maps of a batch of environments, sample by sample, with a ring of the last W of them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.local_map import (
    calibrated_velocity,
    depth_prior,
    map_correct,
    map_enter,
    map_forget,
    map_predict,
)

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]


class Maps(NamedTuple):
    """Local maps: N environments, a ring of W samples, R robots, M points, D numbers a map."""

    state: Float
    """(N, W, R, D)."""
    covariance: Float
    """(N, W, R, D, D)."""
    known: Bool
    """(N, W, R, M) which points are in the map."""
    confirmed: Bool
    """(N, W, R, M) which of them have been seen again, where they were expected, since their bearing began."""
    motion: Float
    """(N, W, R, 4) length of the interval before the sample [s], and the measured velocity over it."""
    cursor: Int
    """(N,) place of the newest sample in the ring."""
    ticks: Int
    """(N,) samples since the start."""
    rejected: Int
    """(N, R, M) how often the gate refused the point since it was last accepted."""
    unseen: Float
    """(N, R, M) [s] since the point was last accepted."""
    depth: Float
    """(N, R, M) [m] guess of the depth at first sight."""
    depth_sd: Float
    """(N,) [m] its standard deviation."""


class Options(NamedTuple):
    """Numbers of the configuration; see `estimators.config.MapAlignmentConfig`."""

    image_variance: float
    speed_variance: float
    lateral_variance: float
    yaw_variance: float
    noise_period: float
    rest_share: float
    gate: float
    bearing_gate: float
    most_rejections: int
    forget_after: float
    rho: float
    rho_variance: float
    height_sd: float
    every: int
    challenger_every: int
    challengers: int
    grid_period: float
    mirror: bool
    iterations: int
    tolerance: float
    unheard_speed_variance: float
    unheard_yaw_variance: float


@kernel
def velocity_variance(options, dt, v, lateral, w):
    """Variances of (speed, lateral speed, yaw rate) measured over an interval of `dt` as (v, lateral, w)."""
    scale = options.noise_period / dt if options.noise_period > 0.0 and dt > 0.0 else 1.0
    if v == 0.0 and lateral == 0.0 and w == 0.0:
        scale *= options.rest_share * options.rest_share
    return scale * options.speed_variance, scale * options.lateral_variance, scale * options.yaw_variance


@kernel
def observe(maps, options, n, dt, odometry, image, seen, work):
    """Take one sample into the local maps of environment n: predict, then correct with each seen point.

    Args:
        maps, options: see there.
        n: the environment.
        dt: [s] length of the interval before the sample.
        odometry, image, seen: (R, 3), (R, M, 2), (R, M) what the robots measured.
        work: (≥ D, ≥ 3) scratch.
    """
    robots, points = seen.shape
    old, window = maps.cursor[n], maps.state.shape[1]
    now = (old + 1) % window
    maps.cursor[n] = now
    for r in range(robots):
        state, covariance, known = maps.state[n, now, r], maps.covariance[n, now, r], maps.known[n, now, r]
        confirmed, rejected, unseen = maps.confirmed[n, now, r], maps.rejected[n, r], maps.unseen[n, r]
        if window > 1:
            for i in range(state.shape[0]):
                state[i] = maps.state[n, old, r, i]
                for j in range(state.shape[0]):
                    covariance[i, j] = maps.covariance[n, old, r, i, j]
            for i in range(points):
                known[i], confirmed[i] = maps.known[n, old, r, i], maps.confirmed[n, old, r, i]
        v, lateral, w = float(odometry[r, 0]), float(odometry[r, 1]), float(odometry[r, 2])
        motion = maps.motion[n, now, r]
        motion[0], motion[1], motion[2], motion[3] = dt, v, lateral, w
        if dt > 0.0:
            var_v, var_l, var_w = velocity_variance(options, dt, v, lateral, w)
            map_predict(state, covariance, known, v, lateral, w, dt, var_v, var_l, var_w, work)
        for i in range(points):
            if known[i]:
                unseen[i] += dt
                if unseen[i] > options.forget_after:
                    map_forget(state, covariance, known, i)
                    confirmed[i] = False
            if not seen[r, i]:
                continue
            x, y = float(image[r, i, 0]), float(image[r, i, 1])
            if known[i]:
                accepted, _ = map_correct(
                    state,
                    covariance,
                    points,
                    i,
                    x,
                    y,
                    w,
                    options.image_variance,
                    options.gate,
                    options.bearing_gate,
                    work,
                )
                if accepted:
                    rejected[i], unseen[i], confirmed[i] = 0, 0.0, True
                    continue
                rejected[i] += 1
                if confirmed[i] and rejected[i] < options.most_rejections:
                    continue
            else:
                rejected[i] = 0
            # A first sight that the next one contradicts was no sight: the point enters anew, as for the first time.
            if rejected[i] >= options.most_rejections:
                rho, rho_variance = state[3 * i + 2], covariance[3 * i + 2, 3 * i + 2]
            elif options.rho_variance > 0.0:
                rho, rho_variance = options.rho, options.rho_variance
            else:
                rho, rho_variance = depth_prior(x, maps.depth[n, r, i], maps.depth_sd[n])
            map_enter(state, covariance, known, i, x, y, w, options.image_variance, rho, rho_variance)
            unseen[i], confirmed[i] = 0.0, False


@kernel
def motion_of(maps, n, slot, r):
    """(v, l, w) of a robot in one sample of the ring, by its own estimate of its calibration."""
    motion = maps.motion[n, slot, r]
    return calibrated_velocity(maps.state[n, slot, r], maps.known.shape[3], motion[1], motion[2], motion[3])


@kernel
def show_maps(rows, maps, points, covariance, known):
    """Write the newest maps of the environments `rows` as `samples.Estimate` has them: (N, R, M, …) arrays."""
    robots, count = known.shape[1], known.shape[2]
    for index in range(rows.shape[0]):
        n = rows[index]
        now = maps.cursor[n]
        for r in range(robots):
            for i in range(count):
                known[n, r, i] = maps.known[n, now, r, i]
                for j in range(3):
                    points[n, r, i, j] = maps.state[n, now, r, 3 * i + j]
                    for k in range(3):
                        covariance[n, r, i, j, k] = maps.covariance[n, now, r, 3 * i + j, 3 * i + k]
