"""Around the physics of an action: what was done, how long the episode is, its end, means over the robots."""

import math

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.kernels._compile import kernel
from relloc_env.samples import Float


def pack_ends(config: EnvConfig) -> Float:
    """(5,) horizon [actions], whether a collision ends an episode, whether success does, its length and angle."""
    length, angle = config.success
    ends = (config.max_cycles, config.terminate_on_collision, config.terminate_on_success, length, math.radians(angle))
    return np.array(ends, np.float64)


@kernel
def begin_action(actions, last_action, elapsed, rows):
    """Note the actions [-] (N, R, 2), clipped to [-1, 1], and count them."""
    for n in rows:
        elapsed[n] += 1
        for r in range(actions.shape[1]):
            for j in range(2):
                last_action[n, r, j] = min(max(actions[n, r, j], -1.0), 1.0)


@kernel
def end_action(reward, joint_reward, collided, worst_sd, elapsed, ends, terminated, truncated, rows):
    """Mean of the robots' rewards, and which episodes are over.

    Args:
        reward: (N, R) of each robot.
        joint_reward: (N,) written.
        collided: (N, R) whether something was touched during the action.
        worst_sd: [m, rad] (N, 2) of the bound.
        elapsed: (N,) actions since the start.
        ends: as `pack_ends` gives them.
        terminated, truncated: (N,) written.
        rows: environments that moved.
    """
    robots = reward.shape[1]
    for n in rows:
        total, touched = 0.0, False
        for r in range(robots):
            total += reward[n, r]
            touched = touched or collided[n, r]
        joint_reward[n] = total / robots
        over = ends[1] > 0.0 and touched
        if ends[2] > 0.0 and worst_sd[n, 0] <= ends[3] and worst_sd[n, 1] <= ends[4]:
            over = True
        terminated[n] = over
        truncated[n] = elapsed[n] >= ends[0]


@kernel
def mean_terms(terms, out):
    """Mean over the robots of the terms (N, R, T) of the reward, into `out` (N, T)."""
    robots = terms.shape[1]
    for n in range(terms.shape[0]):
        for j in range(terms.shape[2]):
            total = 0.0
            for r in range(robots):
                total += terms[n, r, j]
            out[n, j] = total / robots
