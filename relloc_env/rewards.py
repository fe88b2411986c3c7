"""Rewards: a sum of named, weighted terms, computed from the truth; those of the bound come from `relloc_env.bound`.

`TERMS` says what each term is. A term is added in four places, in the same order: its name in `config.REWARD_TERMS`,
its meaning in `TERMS`, its index beside it, and its number in `score_action`.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import REWARD_TERMS, EnvConfig
from relloc_env.ends import end_action
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.camera import view
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.information import LEAST_RANGE, excitation
from relloc_env.kernels.lanes import W, natural, workspace
from relloc_env.kernels.motion import wrap_angle
from relloc_env.kernels.state_layout import size_of

TERMS: Mapping[str, str] = {
    "excitation": "least over the targets of the excitation gained, the integral of v²(x² + y²) over the action [m²/s]",
    "information_depth": "increment of the mean over the targets of -log(range sd / 0.1 m), from the bound [nats]",
    "information_pose": "increment of -log det(covariance of the relative pose)/6, from the bound [nats]",
    "depth_error": "mean over the targets of the relative error of the estimated range, at most 1 each",
    "pose_error": "distance of the estimated from the true position of the other robots [m], plus heading error [rad]",
    "visibility": "share of the targets seen, over the samples of the action",
    "collision": "1 where the robot touched something during the action",
    "blocked": "share of the action's samples in which the shield held the robot",
    "effort": "mean of the squares of the action's speed and yaw rate, as shares of the limits",
    "change": "mean of the sizes of their changes since the action before, which at the start is 0",
    "depth_error_decrease": "`depth_error` before the action, less after it",
    "pose_error_decrease": "`pose_error` before the action, less after it",
}
"""Meaning of each term. Terms are positive quantities: costs take a negative weight."""

assert tuple(TERMS) == REWARD_TERMS
EXCITATION, DEPTH_INFO, POSE_INFO, DEPTH_ERROR, POSE_ERROR, VISIBILITY, COLLISION, BLOCKED, EFFORT = range(9)
CHANGE, DEPTH_DECREASE, POSE_DECREASE = range(9, len(TERMS))


class Score(NamedTuple):
    """What the truth says about the last action and so far; C-contiguous arrays, N first."""

    bound_factor: Any
    """(N, D, D) L of the bound's covariance Lᵀ D L (`kernels.bound`); D = 0 where it is not tracked."""
    bound_variances: Any
    """(N, D) the diagonal of D."""
    sighted: Any
    """(N, R, M) whether a target was measured since the start."""
    depth_information: Any
    """[nats] (N, R) mean over the targets of -log(range sd / 0.1 m)."""
    pose_information: Any
    """[nats] (N,) -log det(P)/6 of the relative pose of the first pair."""
    pose_covariance: Any
    """[m, m, rad] (N, 3, 3) the bound of the pose of robot B in {A}."""
    worst_sd: Any
    """[m, rad] (N, 2) bound's worst standard deviation: of range or position, and of heading."""
    depth_error: Any
    """[m] (N, R, M) estimated minus true range; infinite for points not known yet."""
    pose_error: Any
    """[m, rad] (N, P, 2) distance and angle between estimated and true pose."""
    believed: Any
    """(N, R, 2) `depth_error` and `pose_error` as the reward has them, now."""
    terms: Any
    """(N, R, T) the terms of the reward."""


BOUND_FIELDS = Score._fields.index("depth_error")
"""Count of the first fields of `Score`, those of the bound."""


def make_score(config: EnvConfig, num_envs: int) -> Score:
    """Empty arrays."""
    n, r, m = num_envs, config.robots, config.targets
    d = size_of(r, m) if config.tracks_bound else 0
    return Score(
        bound_factor=np.zeros((n, d, d)),
        bound_variances=np.zeros((n, d)),
        sighted=np.zeros((n, r, m), np.bool_),
        depth_information=np.zeros((n, r)),
        pose_information=np.zeros(n),
        pose_covariance=np.zeros((n, 3, 3) if config.tracks_bound else (n, 0, 0)),
        worst_sd=np.zeros((n, 2)),
        depth_error=np.zeros((n, r, m)),
        pose_error=np.zeros((n, r * (r - 1), 2)),
        believed=np.zeros((n, r, 2)),
        terms=np.zeros((n, r, len(TERMS))),
    )


def weights(config: EnvConfig) -> NDArray[np.float64]:
    """(T,) weight of each term."""
    chosen = config.reward_weights
    return np.array([chosen.get(name, 0.0) for name in TERMS])


# Workspace of `score_action`, in lanes: of robots,
_X, _Y, _THETA, _COS, _SIN, _V, _LATERAL = (k * W for k in range(7))
_ROBOT = 7
# of points: x, y, z; of a robot and a point,
_SEEN, _EXCITATION, _RHO, _KNOWN, _ERROR, _SHARE, _SIGHTED = (k * W for k in range(7))
_SIGHT = 7
# and of a pair of robots.
_POSE, _DISTANCE, _TURN = 0 * W, 3 * W, 4 * W
_PAIR = 5


@kernel
def _face(t, p, width):
    """Cosine and sine of a robot's heading."""
    p = natural(p)
    for i in range(width):
        t[p + i + _SIN], t[p + i + _COS] = sin_cos(t[p + i + _THETA])


@kernel
def _excite(t, p, q, s, height, dt, width):
    """Add the excitation of one sample, where the point is seen."""
    p, q, s = natural(p), natural(q), natural(s)
    for i in range(width):
        r_x, r_y, cos, sin = t[p + i + _X], t[p + i + _Y], t[p + i + _COS], t[p + i + _SIN]
        _, x, y = view(r_x, r_y, cos, sin, height, t[q + i], t[q + i + W], t[q + i + 2 * W])
        gained = excitation(x, y, t[p + i + _V], t[p + i + _LATERAL]) * dt
        t[s + i + _EXCITATION] += gained if t[s + i + _SEEN] != 0.0 else 0.0


@kernel
def _range_error(t, p, q, s, width):
    """Estimated minus true range of a point, and its share of the range, at most 1."""
    p, q, s = natural(p), natural(q), natural(s)
    for i in range(width):
        d_x, d_y = t[q + i] - t[p + i + _X], t[q + i + W] - t[p + i + _Y]
        true = np.sqrt(d_x * d_x + d_y * d_y)
        error = 1.0 / max(t[s + i + _RHO], 1e-6) - true if t[s + i + _KNOWN] != 0.0 else np.inf
        t[s + i + _ERROR], t[s + i + _SHARE] = error, min(1.0, abs(error) / max(true, LEAST_RANGE))


@kernel
def _pose_error(t, a, b, s, width):
    """Distance and angle between the estimated and the true pose of b in {a}."""
    a, b, s = natural(a), natural(b), natural(s)
    for i in range(width):
        cos, sin = t[a + i + _COS], t[a + i + _SIN]
        r_x, r_y = t[b + i + _X] - t[a + i + _X], t[b + i + _Y] - t[a + i + _Y]
        d_x = t[s + i + _POSE] - (cos * r_x + sin * r_y)
        d_y = t[s + i + _POSE + W] - (cos * r_y - sin * r_x)
        turn = t[s + i + _POSE + 2 * W] - (t[b + i + _THETA] - t[a + i + _THETA])
        t[s + i + _DISTANCE], t[s + i + _TURN] = np.sqrt(d_x * d_x + d_y * d_y), abs(wrap_angle(turn))


@kernel
def score_action(
    terms, depth_error, pose_error, believed, reward, last_action, points, collided, blocked, seen, true_pose,
    true_velocity, heights, joint_reward, worst_sd, elapsed, terminated, truncated,
    e_points, e_known, e_pose, actions, weights_, ends, params_, pairs, block, rows, started,
):  # fmt: skip
    """Score one action by the truth: errors, every term but those of the bound, rewards, and which episodes are over.

    Arrays are flat (`kernels.lanes.flat`) but for those of the estimate.

    Args:
        terms, depth_error, pose_error, believed: of `Score`, written.
        reward: (N R) written.
        last_action: [-] (N R 2) of the action before; written: `actions`, clipped to [-1, 1].
        points, collided, blocked: of `World`.
        seen: of `Samples`.
        true_pose, true_velocity: of `Truth`, of the same samples.
        heights: [m] (R,) of the cameras.
        joint_reward, worst_sd, elapsed, terminated, truncated: as for `ends.end_action`.
        e_points, e_known, e_pose: of `Estimate`.
        actions: [-] (N R 2) what was done.
        weights_: (T,) weight of each term.
        ends: `ends.pack_ends`.
        params_: record.
        pairs: (P, 2) ordered pairs.
        block: samples of the action.
        rows: environments that moved.
        started: whether an episode has just started: errors alone are refreshed.
    """
    robots, count, width = heights.shape[0], params_[0].targets, params_[0].width
    e_points, e_known, e_pose = e_points.ravel(), e_known.ravel(), e_pose.ravel()
    at = robots * _ROBOT * W
    sights = at + count * 3 * W
    others = sights + robots * count * _SIGHT * W
    t = workspace(others // W + pairs.shape[0] * _PAIR, width)
    for begin in range(0, rows.shape[0], W):
        end = min(begin + W, rows.shape[0])
        _load(t, at, sights, others, robots, count, pairs, points, e_points, e_known, e_pose, rows, begin, end)
        for k in range(block):
            _load_sample(t, sights, robots, count, block, k, seen, true_pose, true_velocity, rows, begin, end)
            for r in range(robots):
                _face(t, r * _ROBOT * W, width)
                for m in range(count):
                    place = sights + (r * count + m) * _SIGHT * W
                    _excite(t, r * _ROBOT * W, at + 3 * m * W, place, heights[r], params_[0].dt, width)
        for r in range(robots):
            for m in range(count):
                _range_error(t, r * _ROBOT * W, at + 3 * m * W, sights + (r * count + m) * _SIGHT * W, width)
        for p in range(pairs.shape[0]):
            a, b = pairs[p, 0] * _ROBOT * W, pairs[p, 1] * _ROBOT * W
            _pose_error(t, a, b, others + p * _PAIR * W, width)
        _store_errors(t, sights, others, robots * count, pairs.shape[0], depth_error, pose_error, rows, begin, end)
        for j in range(begin, end):
            n, i = rows[j], j - begin
            _believe(t, sights, others, terms, believed, pairs, robots, count, weights_.shape[0], n, i)
            if started:
                place = natural(n * robots * weights_.shape[0])
                for d in range(robots * weights_.shape[0]):
                    terms[place + d] = 0.0
                continue
            counts = elapsed[natural(n)] >= params_[0].reward_start
            _terms(
                t, sights, terms, reward, last_action, actions, collided, blocked, weights_, counts,
                robots, count, block, n, i,
            )  # fmt: skip
            end_action(reward, joint_reward, collided, worst_sd, elapsed, ends, terminated, truncated, robots, n)


@kernel
def _load(t, at, sights, others, robots, count, pairs, points, e_points, e_known, e_pose, rows, begin, end):
    """Put points and estimates into lanes; nothing is seen yet."""
    for j in range(begin, end):
        n, i = rows[j], j - begin
        place, source = natural(at + i), natural(3 * n * count)
        for d in range(3 * count):
            t[place + d * W] = points[source + d]
        for s in range(robots * count):
            place, source = natural(sights + s * _SIGHT * W + i), natural(n * robots * count + s)
            t[place + _EXCITATION], t[place + _RHO], t[place + _SIGHTED] = 0.0, e_points[3 * source + 2], 0.0
            t[place + _KNOWN] = 1.0 if e_known[source] else 0.0
        for p in range(pairs.shape[0]):
            place, source = natural(others + p * _PAIR * W + i), natural(3 * (n * pairs.shape[0] + p))
            for d in range(3):
                t[place + _POSE + d * W] = e_pose[source + d]


@kernel
def _load_sample(t, sights, robots, count, block, k, seen, true_pose, true_velocity, rows, begin, end):
    """Put the truth of sample k into lanes."""
    for j in range(begin, end):
        sample, i = rows[j] * block + k, j - begin
        for r in range(robots):
            place, source = natural(r * _ROBOT * W + i), natural(3 * (sample * robots + r))
            for d in range(3):
                t[place + d * W] = true_pose[source + d]
            t[place + _V], t[place + _LATERAL] = true_velocity[source], true_velocity[source + 1]
        for s in range(robots * count):
            place = natural(sights + s * _SIGHT * W + i)
            t[place + _SEEN] = 1.0 if seen[natural(sample * robots * count + s)] else 0.0
            t[place + _SIGHTED] += t[place + _SEEN]


@kernel
def _store_errors(t, sights, others, count, pairs, depth_error, pose_error, rows, begin, end):
    """Write the errors of the estimates."""
    for j in range(begin, end):
        n, i = rows[j], j - begin
        for s in range(count):
            depth_error[natural(n * count + s)] = t[natural(sights + s * _SIGHT * W + i) + _ERROR]
        for p in range(pairs):
            place, to = natural(others + p * _PAIR * W + i), natural(2 * (n * pairs + p))
            pose_error[to], pose_error[to + 1] = t[place + _DISTANCE], t[place + _TURN]


@inlined
def _believe(t, sights, others, terms, believed, pairs, robots, count, size, n, i):
    """The terms that come from errors, of the robots of environment n, from lane i."""
    for r in range(robots):
        robot = natural(n * robots + r)
        share, error = 0.0, 0.0
        for m in range(count):
            share += t[natural(sights + (r * count + m) * _SIGHT * W + i) + _SHARE]
        for p in range(pairs.shape[0]):
            if pairs[p, 0] == r:
                place = natural(others + p * _PAIR * W + i)
                error += t[place + _DISTANCE] + t[place + _TURN]
        share /= count
        first = natural(robot * size)
        terms[first + DEPTH_ERROR], terms[first + POSE_ERROR] = share, error
        terms[first + DEPTH_DECREASE] = believed[2 * robot] - share
        terms[first + POSE_DECREASE] = believed[2 * robot + 1] - error
        believed[2 * robot], believed[2 * robot + 1] = share, error


@inlined
def _terms(
    t, sights, terms, reward, last_action, actions, collided, blocked, weights_, counts, robots, count, block, n, i,
):  # fmt: skip
    """The other terms and the rewards of the robots of environment n, from lane i."""
    for r in range(robots):
        robot = natural(n * robots + r)
        least, sighted = math.inf, 0.0
        for m in range(count):
            place = natural(sights + (r * count + m) * _SIGHT * W + i)
            least = min(least, t[place + _EXCITATION])
            sighted += t[place + _SIGHTED]
        v, w = min(max(actions[2 * robot], -1.0), 1.0), min(max(actions[2 * robot + 1], -1.0), 1.0)
        change_v, change_w = v - last_action[2 * robot], w - last_action[2 * robot + 1]
        last_action[2 * robot], last_action[2 * robot + 1] = v, w
        first = natural(robot * weights_.shape[0])
        if not counts:
            terms[first + DEPTH_INFO] = terms[first + POSE_INFO] = 0.0
        terms[first + EXCITATION], terms[first + VISIBILITY] = least, sighted / (block * count)
        terms[first + COLLISION] = 1.0 if collided[robot] else 0.0
        terms[first + BLOCKED] = blocked[robot] / block
        terms[first + EFFORT] = 0.5 * (v * v + w * w)
        terms[first + CHANGE] = 0.5 * (abs(change_v) + abs(change_w))
        total = 0.0
        for d in range(weights_.shape[0]):
            total += weights_[d] * terms[first + d]
        reward[robot] = total
