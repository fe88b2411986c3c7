import numpy as np
import pytest
from scipy.integrate import solve_ivp

from relloc_env.kernels.dead_reckoning import arc_velocity, dead_reckon, mean_velocity
from relloc_env.kernels.motion import advance, arc


def test_arc_velocity_is_the_inverse_of_the_arc() -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        v, lateral = rng.uniform(-1.0, 1.0, 2)
        dt = rng.uniform(0.01, 2.0)
        w = rng.uniform(-1.0, 1.0) * 1.9 * np.pi / dt
        found = arc_velocity(*arc(v, lateral, w, dt), dt)
        assert found == pytest.approx((v, lateral, w), abs=1e-9)


def test_arc_velocity_of_a_straight_step() -> None:
    assert arc_velocity(0.3, -0.1, 0.0, 0.5) == pytest.approx((0.6, -0.2, 0.0))


def test_held_velocities_give_the_path_of_the_differential_equation() -> None:
    rng = np.random.default_rng(2)
    time = np.sort(rng.uniform(0.0, 10.0, 40))
    velocity = rng.uniform(-0.5, 0.5, (40, 3))
    at = np.sort(rng.uniform(-1.0, 12.0, 60))
    poses = np.zeros((60, 3))
    dead_reckon(time, velocity, at, poses)

    def flow(_: float, pose: np.ndarray, u: np.ndarray) -> list[float]:
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        return [cos * u[0] - sin * u[1], sin * u[0] + cos * u[1], u[2]]

    pose, now = np.zeros(3), at[0]
    for k in range(1, 60):
        while now < at[k]:
            i = int(np.searchsorted(time, now, side="right")) - 1
            end = min(at[k], time[i + 1]) if i + 1 < 40 else at[k]
            u = velocity[i] if i >= 0 else np.zeros(3)
            pose = solve_ivp(flow, (now, end), pose, args=(u,), rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]
            now = end
        assert poses[k] == pytest.approx(pose, abs=1e-8)


def test_mean_velocities_lead_from_pose_to_pose() -> None:
    rng = np.random.default_rng(3)
    poses = np.cumsum(rng.uniform(-0.4, 0.4, (200, 3)), axis=0)
    period = rng.uniform(0.01, 0.5, 200)
    period[[0, 17]] = 0.0
    poses[17] = poses[16]
    velocity = np.zeros((200, 3))
    mean_velocity(poses, period, velocity)
    assert not velocity[17].any()
    pose = tuple(poses[0])
    for k in range(1, 200):
        pose = advance(*pose, *velocity[k], period[k])
        assert pose == pytest.approx(tuple(poses[k]), abs=1e-10)
