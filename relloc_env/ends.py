"""After the physics of an action: how long the episode is, its end, means over the robots."""

import math

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.lanes import natural
from relloc_env.samples import Float


def pack_ends(config: EnvConfig) -> Float:
    """(5,) horizon [actions], whether a collision ends an episode, whether success does, its length and angle."""
    length, angle = config.success
    ends = (config.max_cycles, config.terminate_on_collision, config.terminate_on_success, length, math.radians(angle))
    return np.array(ends, np.float64)


@inlined
def end_action(reward, joint_reward, collided, worst_sd, elapsed, ends, terminated, truncated, robots, n):
    """Count the actions; the mean of the robots' rewards; and which episodes are over. Arrays are flat.

    Args:
        reward: (N R) of each robot.
        joint_reward: (N,) written.
        collided: (N R) whether something was touched during the action.
        worst_sd: [m, rad] (N 2) of the bound.
        elapsed: (N,) actions since the start, counted on.
        ends: as `pack_ends` gives them.
        terminated, truncated: (N,) written.
        robots: R.
        n: environment that moved.
    """
    n = natural(n)
    elapsed[n] += 1
    total, touched, first = 0.0, False, natural(n * robots)
    for r in range(robots):
        total += reward[first + r]
        touched |= collided[first + r]
    joint_reward[n] = total / robots
    over = ends[1] > 0.0 and touched
    if ends[2] > 0.0 and worst_sd[2 * n] <= ends[3] and worst_sd[2 * n + 1] <= ends[4]:
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
