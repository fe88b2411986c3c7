"""What three ways to drive can make known of the other robot's pose, in one scene: the information bound."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import relloc_env
from agents import Task, make
from docs.figures.style import MUTED, POINT, ROBOT, page, plan, robot, uncertainty
from relloc_env.samples import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEED = 4
WAYS = (("stationary", "stand still"), ("straight", "straight ahead"), ("edge-two", "feedback: edge-two"))
COLOURS = (MUTED, "#1b9e77", "#7570b3")
TIMES = {0.0: ":", 2.0: "--", 30.0: "-"}
"""[s] of the ellipses, and their lines."""


class Course(NamedTuple):
    """An episode of T actions; T + 1 instants."""

    time: Float
    """[s]"""
    poses: Float
    """[m, m, rad] (T + 1, 2, 3), {W}."""
    covariance: Float
    """[m] (T + 1, 2, 2) bound of B's position as A sees it, turned into {W}."""
    information: Float
    """[nats] J of the pose."""
    points: Float
    """[m] (M, 3), {W}."""


def play(name: str) -> Course:
    """Play an agent in the scene of the figure."""
    env = relloc_env.parallel_env(estimator="cascade", arena=(12.0, 12.0))
    task = Task.of(env)
    policy = make(name, task)
    policy.reset(1, SEED)
    observations, infos = env.reset(seed=SEED)
    kept = []
    while True:
        truth = infos["robot_a"]
        poses, heading = truth["truth/poses"], truth["truth/poses"][0, 2]
        turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
        covariance = turn @ env.core.score.pose_covariance[0, :2, :2] @ turn.T
        kept.append((poses, covariance, truth["information/pose"]))
        if not env.agents:
            break
        chosen = policy.act(task.rows(observations))[0].astype(np.float32)
        observations, _, _, _, infos = env.step(dict(zip(env.agents, chosen, strict=True)))
    places, covariances, information = (np.array(values) for values in zip(*kept, strict=True))
    time = task.action_period * np.arange(len(kept))
    return Course(np.asarray(time, np.float64), places, covariances, information, truth["truth/points"])


def draw(path: Path) -> None:
    """Maps with the 2 sigma ellipses of B above, the information over time below."""
    courses = [play(name) for name, _ in WAYS]
    every = np.concatenate([np.concatenate([c.poses[..., :2].reshape(-1, 2), c.points[:, :2]]) for c in courses])
    low, high = every.min(axis=0) - 1.2, every.max(axis=0) + 1.2
    with page(path, 5.4) as figure:
        above, below = figure.subfigures(2, 1, height_ratios=(1.0, 1.15), squeeze=False)[:, 0]
        maps, (nats, metres) = above.subplots(1, len(WAYS)), below.subplots(1, 2)
        for axes, colour, course, (_, words) in zip(maps, COLOURS, courses, WAYS, strict=True):
            plan(axes)
            axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), title=words)
            _map(axes, course)
            nats.plot(course.time, course.information, label=words, color=colour)
            metres.plot(course.time, np.sqrt(np.trace(course.covariance, axis1=1, axis2=2)), color=colour)
        for time, style in TIMES.items():
            nats.plot([], [], color=ROBOT[1], ls=style, lw=1.4, label=f"B within 2σ at {time:g} s")
        nats.set(xlabel="time [s]", title="information on the pose [nats]", xlim=(0.0, 30.0))
        metres.set(xlabel="time [s]", title="sd of B's place [m]", xlim=(0.0, 30.0), yscale="log")
        below.legend(*nats.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def _map(axes: "Axes", course: Course) -> None:
    for i, point in enumerate(course.points):
        axes.plot(*point[:2], "o", color=POINT[i], ms=7)
    for r in range(2):
        axes.plot(*course.poses[:, r, :2].T, color=ROBOT[r], lw=1.0)
        robot(axes, course.poses[-1, r], r, size=0.25)
    for time, style in TIMES.items():
        now = int(np.argmin(np.abs(course.time - time)))
        uncertainty(axes, course.poses[now, 1], course.covariance[now], ROBOT[1], ls=style, lw=1.4)
