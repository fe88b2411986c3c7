"""Every term of the reward from the truth alone, and information against the bound of the whole trajectory."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import relloc_env
from relloc_env.config import REWARD_TERMS, EnvConfig
from relloc_env.envs.parallel import RellocParallelEnv
from relloc_env.metrics import TrajectoryBound, trajectory_bound
from relloc_env.rewards import TERMS

CAMERAS = [{"preset": "pi", "pixel_noise": 2.0, "mount_height": 0.3}, {"preset": "kinect", "mount_height": 0.5}]
ROBOTS = [{"odometry_noise": (0.01, 0.02)}, {"odometry_noise": (0.03, 0.01)}]
WEIGHTS = {name: 0.5 - 0.37 * k for k, name in enumerate(REWARD_TERMS)}


def make(robots: int, **options: Any) -> RellocParallelEnv:
    given = {
        "robots": robots, "camera": CAMERAS[:robots], "robot": ROBOTS[:robots], "targets": 3, "max_cycles": 60,
        "samples_per_action": 4, "reward": WEIGHTS, "shield": {"target": 2.5, "robot": 1.5, "wall": 0.5},
    }  # fmt: skip
    return relloc_env.parallel_env(given | options)


def wandering(rng: np.random.Generator, agents: list[str]) -> dict[str, NDArray[np.float32]]:
    return {agent: rng.uniform(-1.2, 1.2, 2).astype(np.float32) for agent in agents}


class History:
    """The truth of an episode, sample by sample."""

    def __init__(self, env: RellocParallelEnv) -> None:
        self.env, simulation = env, env.core.simulation
        first = simulation.first_truth
        self.parts = [[part[0, :1].copy()] for part in first]
        self.period = [0.0]

    def add(self) -> None:
        simulation = self.env.core.simulation
        for part, block in zip(self.parts, simulation.truth, strict=True):
            part.append(block[0].copy())
        self.period += simulation.samples.period[0].tolist()

    def bound(self) -> TrajectoryBound:
        config: EnvConfig = self.env.config
        poses, velocity, visible = (np.concatenate(part) for part in self.parts)
        robots = [config.robot_of(r) for r in range(config.robots)]
        cameras = [config.camera_of(r) for r in range(config.robots)]
        guess = config.guess
        return trajectory_bound(
            np.array(self.period), poses, self.env.core.simulation.world.points[0], velocity, visible,
            np.array([camera.mount_height for camera in cameras]),
            image_sd=[camera.image_noise for camera in cameras],
            speed_sd=[robot.odometry_noise[0] for robot in robots],
            turn_sd=[robot.odometry_noise[1] for robot in robots],
            depth_sd=guess.depth_sd, pose_sd=(guess.position_sd, guess.position_sd, math.radians(guess.heading_sd)),
        )  # fmt: skip


def depth_information(bound: TrajectoryBound, at: int, pose: NDArray[np.float64], points: NDArray[np.float64]) -> float:
    """Mean over the targets of -log(range sd / 0.1 m), the range by its gradient in the body frame."""
    total = 0.0
    for i, point in enumerate(points):
        z = complex(point[0] - pose[0], point[1] - pose[1]) * complex(math.cos(pose[2]), -math.sin(pose[2]))
        gradient = np.array([z.real, z.imag, 0.0]) / abs(z)
        total -= 0.5 * math.log(gradient @ bound.points[at, 0, i] @ gradient)
    return total / len(points) + math.log(0.1)


def errors(env: RellocParallelEnv, r: int, info: dict[str, Any]) -> tuple[float, float]:
    """`depth_error` and `pose_error` of a robot, from what `info` says of it now."""
    world = env.core.simulation.world
    ranges = np.hypot(*(world.points[0, :, :2] - world.pose[0, r, :2]).T)
    shares = np.minimum(np.abs(info["errors/range"][r]) / ranges, 1.0)
    return float(shares.mean()), float(info["errors/pose"][r].sum()) if env.config.robots == 2 else 0.0


@pytest.mark.parametrize("robots", [1, 2])
@pytest.mark.parametrize("network", [{}, {"latency": 0.1, "loss": 0.3}], ids=["perfect", "lossy"])
def test_every_term_and_their_sum(robots: int, network: dict[str, Any]) -> None:
    """Four episodes of 40 actions: each term by its definition from the truth, the reward as the weighted sum."""
    env, rng = make(robots, network=network), np.random.default_rng(1)
    dt = env.config.sample_period
    touched = held = 0.0
    for seed in range(4):
        _, infos = env.reset(seed=seed)
        before = infos["robot_a"]
        last = {agent: np.zeros(2) for agent in env.agents}
        wrong = {agent: errors(env, r, infos[agent]) for r, agent in enumerate(env.agents)}
        for _ in range(40):
            actions = wandering(rng, env.agents)
            _, rewards, _, _, infos = env.step(actions)
            truth, points = env.core.simulation.truth, env.core.simulation.world.points[0]
            for r, agent in enumerate(env.agents):
                info = infos[agent]
                terms = {name: info[f"reward/{name}"] for name in TERMS}
                excitations = np.zeros(len(points))
                for pose, velocity, visible in zip(
                    truth.pose[0, :, r], truth.velocity[0, :, r], truth.visible[0, :, r], strict=True
                ):
                    z = (points[:, 0] - pose[0] + 1j * (points[:, 1] - pose[1])) * np.exp(-1j * pose[2])
                    x, y = -z.imag / z.real, (CAMERAS[r]["mount_height"] - points[:, 2]) / z.real
                    sigma2 = (velocity[0] * x + velocity[1]) ** 2 + (velocity[0] * y) ** 2
                    excitations += np.where(visible, sigma2, 0.0) * dt
                depth_error, pose_error = errors(env, r, info)
                action = np.clip(actions[agent].astype(np.float64), -1, 1)
                expected = {
                    "excitation": excitations.min(),
                    "information_depth": info["information/depth"][r] - before["information/depth"][r],
                    "information_pose": info["information/pose"] - before["information/pose"],
                    "depth_error": depth_error,
                    "pose_error": pose_error,
                    "visibility": truth.visible[0, :, r].mean(),
                    "collision": float(env.core.simulation.world.collided[0, r]),
                    "blocked": env.core.simulation.world.blocked[0, r] / 4,
                    "effort": (action**2).mean(),
                    "change": np.abs(action - last[agent]).mean(),
                    "depth_error_decrease": wrong[agent][0] - depth_error,
                    "pose_error_decrease": wrong[agent][1] - pose_error,
                }
                last[agent], wrong[agent] = action, (depth_error, pose_error)
                assert terms.keys() == expected.keys()
                for name, value in expected.items():
                    assert math.isclose(terms[name], value, rel_tol=1e-9, abs_tol=1e-12), name
                total = sum(WEIGHTS[name] * value for name, value in terms.items())
                assert math.isclose(rewards[agent], total, rel_tol=1e-9, abs_tol=1e-12)
                held += terms["blocked"]
                touched += terms["collision"]
            before = infos["robot_a"]
    assert held > 0.0
    assert touched == 0.0


def test_collision_is_one_where_something_is_touched() -> None:
    """Robot A drives into a wall; B stands in the open."""
    env = make(2, shield=None, poses=[(4.71, 0.0, 0.0), (-2.0, 0.0, 0.0)], points=[(3.0, y, 0.5) for y in (0, 1, 2)])
    env.reset(seed=1)
    for step in range(8):
        _, _, _, _, infos = env.step({"robot_a": np.array([1.0, 0.0]), "robot_b": np.zeros(2)})
        free = 4.71 + 0.06 * (step + 1) < 4.82
        assert infos["robot_a"]["reward/collision"] == (0.0 if free else 1.0)
        assert infos["robot_b"]["reward/collision"] == 0.0


@pytest.mark.parametrize("robots", [1, 2])
def test_information_is_that_of_the_bound(robots: int) -> None:
    """J of 200 samples against the bound of the whole trajectory: at the start, on the way and at the end."""
    env, rng = make(robots), np.random.default_rng(2)
    for seed in range(3):
        _, infos = env.reset(seed=seed)
        history, shown = History(env), [infos["robot_a"]]
        for _ in range(50):
            *_, infos = env.step(wandering(rng, env.agents))
            history.add()
            shown.append(infos["robot_a"])
        bound = history.bound()
        points = env.core.simulation.world.points[0]
        for action in (0, 1, 25, 50):
            at, found = 4 * action, shown[action]
            pose = found["truth/poses"][0]
            expected = depth_information(bound, at, pose, points)
            assert math.isclose(found["information/depth"][0], expected, rel_tol=1e-9, abs_tol=1e-9)
            if robots == 2:
                covariance = bound.pose[at, 0]
                assert math.isclose(
                    found["information/pose"], -np.linalg.slogdet(covariance)[1] / 6.0, rel_tol=1e-9, abs_tol=1e-9
                )
                sd = np.sqrt(np.diag(covariance))
                np.testing.assert_allclose(found["bound_sd"], (sd[:2].max(), sd[2]), rtol=1e-9)


@pytest.mark.parametrize("robots", [1, 2])
def test_information_terms_sum_to_what_was_gained(robots: int) -> None:
    """J at the end less J at the start, over five episodes of 60 actions, for each robot."""
    env, rng = make(robots), np.random.default_rng(3)
    for seed in range(5):
        _, infos = env.reset(seed=seed)
        start, depth, pose = infos["robot_a"], np.zeros(robots), np.zeros(robots)
        agents = list(env.agents)
        while env.agents:
            *_, infos = env.step(wandering(rng, agents))
            depth += [infos[agent]["reward/information_depth"] for agent in agents]
            pose += [infos[agent]["reward/information_pose"] for agent in agents]
        end = infos["robot_a"]
        np.testing.assert_allclose(depth, end["information/depth"] - start["information/depth"], atol=1e-10)
        np.testing.assert_allclose(pose, end["information/pose"] - start["information/pose"], atol=1e-10)
        assert (depth > 0.5).all()


@pytest.mark.parametrize(("robots", "name"), [(1, "information_depth"), (2, "information_pose")])
def test_default_reward_is_information_gained(robots: int, name: str) -> None:
    """Three times the increment, less 0.02 for the share of blocked samples."""
    env, rng = make(robots, reward=None), np.random.default_rng(4)
    env.reset(seed=1)
    for _ in range(20):
        _, rewards, _, _, infos = env.step(wandering(rng, env.agents))
        for agent, reward in rewards.items():
            expected = 3.0 * infos[agent][f"reward/{name}"] - 0.02 * infos[agent]["reward/blocked"]
            assert math.isclose(reward, expected, rel_tol=1e-12, abs_tol=1e-12)


def test_bound_needs_no_estimator() -> None:
    """The same motion with any estimator or none gives the same information and the same default reward."""
    rng, runs = np.random.default_rng(5), []
    choices = [rng.uniform(-1, 1, (2, 2)) for _ in range(20)]
    for estimator in (None, "cascade", "map-alignment"):
        env = make(2, estimator=estimator, reward=None)
        env.reset(seed=6)
        rewards = [env.step(dict(zip(env.agents, choice, strict=True)))[1] for choice in choices]
        runs.append(np.array([list(reward.values()) for reward in rewards]))
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0], runs[2])


@pytest.mark.parametrize(("start", "first"), [(0.0, 0), (0.4, 2), (0.41, 3), (10.0, 60)])
def test_information_counts_from_the_start_that_was_asked_for(start: float, first: int) -> None:
    """Actions of 0.2 s: those that begin before it gain nothing, all else is as without it."""
    env, plain = make(2, reward_start=start), make(2)
    env.reset(seed=1)
    plain.reset(seed=1)
    rng = np.random.default_rng(3)
    for k in range(5):
        actions = wandering(rng, env.agents)
        found, expected = env.step(actions), plain.step(actions)
        for agent in env.agents:
            info, usual = found[-1][agent], expected[-1][agent]
            assert info["information/pose"] == usual["information/pose"]
            gained = {name: usual[f"reward/{name}"] for name in TERMS}
            if k < first:
                gained |= {"information_depth": 0.0, "information_pose": 0.0}
            assert {name: info[f"reward/{name}"] for name in TERMS} == gained
            total = sum(WEIGHTS[name] * value for name, value in gained.items())
            assert math.isclose(found[1][agent], total, rel_tol=1e-9, abs_tol=1e-12)
