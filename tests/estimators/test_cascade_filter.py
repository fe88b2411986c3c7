"""The cascade against a plain numpy filter."""

import math
from typing import Any

import numpy as np
import pytest

from relloc_env.estimators import CascadeConfig, make
from relloc_env.estimators.cascade import Cascade
from relloc_env.kernels import motion, relative_pose
from relloc_env.samples import Float, Samples
from tests.estimators.driving import POINTS, prior, run, simulate
from tests.kernels.observers import COVARIANCE, POINT, Observers, Settings

arc: Any = motion.arc
rp: Any = relative_pose


def rotation(theta: float) -> Float:
    return np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])


def reference(samples: Samples, config: CascadeConfig) -> tuple[Float, Float]:
    """Poses (K, 2, 3) and covariances of environment 0 by a plain Kalman filter on the depth observers' points."""
    estimator = make(config, 1, 2, len(POINTS))
    assert isinstance(estimator, Cascade)
    estimator.reset(prior(1), np.array([0]))
    settings, gains, first = estimator._settings, estimator.gains[0], prior(1)
    observers = [
        Observers(
            len(POINTS), Settings(*settings[list(Settings._fields)][i].item()), h=gains[i, :, 0],
            alpha_lambda=gains[i, :, 1], depth=first.depth[0, i], depth_sd=first.depth_sd,
        )
        for i in range(2)
    ]  # fmt: skip
    poses, covariances = np.zeros((samples.period.shape[1], 2, 3)), np.zeros((samples.period.shape[1], 2, 3, 3))
    x = [prior(1).pose[0, p].copy() for p in range(2)]
    P = [np.diag(prior(1).pose_sd ** 2) for _ in range(2)]
    for k in range(len(poses)):
        dt, u, image, seen = (field[0, k] for field in samples[:4])
        u = u.astype(np.float64)
        for i in range(2):
            observers[i].sample(u[i], dt, image[i], seen[i])
        state = [observer.numbers for observer in observers]
        for p, (a, b) in enumerate(((0, 1), (1, 0))):
            x[p], P[p] = dense_prediction(x[p], P[p], u[a], u[b], dt, config)
            for m in range(len(POINTS)):
                if seen[a, m] and seen[b, m]:
                    x[p], P[p] = dense_update(x[p], P[p], state[a][m], state[b][m], u[a], u[b], config)
            poses[k, p], covariances[k, p] = x[p], P[p]
    return poses, covariances


def dense_prediction(
    x: Float, P: Float, u_a: Float, u_b: Float, dt: float, config: CascadeConfig
) -> tuple[Float, Float]:
    def f(x: Float, u_a: Float, u_b: Float) -> Float:
        result: Float = np.array(rp.predict(*x, *arc(*u_a, dt), *arc(*u_b, dt))[:3])
        return result

    def difference(g: Any) -> Float:
        columns = []
        for e in np.eye(3):
            change = g(1e-5 * e) - g(-1e-5 * e)
            change[2] = math.remainder(change[2], math.tau)
            columns.append(change / 2e-5)
        return np.stack(columns, axis=1)

    F = difference(lambda d: f(x + d, u_a, u_b))
    if config.process == "fixed":
        Q = config.process_sd**2 * np.eye(3) * (dt > 0)
    else:
        G_a, G_b = difference(lambda d: f(x, u_a + d, u_b)), difference(lambda d: f(x, u_a, u_b + d))
        M = np.diag([config.odometry_noise[0] ** 2, 0.0, config.odometry_noise[1] ** 2])
        Q = G_a @ M @ G_a.T + G_b @ M @ G_b.T
    return f(x, u_a, u_b), F @ P @ F.T + Q


def dense_update(
    x: Float, P: Float, a: Float, b: Float, u_a: Float, u_b: Float, config: CascadeConfig
) -> tuple[Float, Float]:
    def spread(row: Float) -> tuple[Float, Float]:
        c = row[COVARIANCE]
        return row[POINT[:2]], np.array([[c[0], c[1]], [c[1], c[3]]])

    (q_a, C_a), (q_b, C_b) = spread(a), spread(b)
    J, R = np.array([[0.0, -1.0], [1.0, 0.0]]), rotation(x[2])
    q = R.T @ (q_a - x[:2])
    H, y = np.column_stack([-R.T, -J @ q]), q_b - q
    noise = R.T @ C_a @ R + C_b if config.measurement == "depth" else np.zeros((2, 2))
    if config.pose_model != "position":
        T = -u_a[2] * J
        H, y, noise = T @ H, T @ y, T @ noise @ T.T
    if config.pose_model == "printed":
        h = R.T @ (-u_a[2] * J @ q_a - u_a[:2])
        H, y = np.column_stack([np.zeros((2, 2)), -J @ h]), -u_a[2] * J @ q_b - u_b[:2] - h
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise + config.measurement_sd**2 * np.eye(2))
    x, A = x + K @ y, np.eye(3) - K @ H
    x[2] = math.remainder(x[2], math.tau)
    return x, A @ P  # with the optimal gain the short form is the Joseph form


@pytest.mark.parametrize("pose_model", ["position", "velocity", "printed"])
@pytest.mark.parametrize(("measurement", "process"), [("fixed", "fixed"), ("depth", "odometry")])
def test_agrees_with_a_plain_kalman_filter(pose_model, measurement, process):
    samples, _ = simulate(60)
    config = CascadeConfig(pose_model=pose_model, measurement=measurement, process=process)
    poses, covariances = reference(samples, config)
    estimator = run(samples, config)
    np.testing.assert_allclose(estimator.estimate.pose[0], poses[-1], atol=1e-6)
    np.testing.assert_allclose(estimator.estimate.pose_covariance[0], covariances[-1], rtol=1e-4, atol=1e-9)
