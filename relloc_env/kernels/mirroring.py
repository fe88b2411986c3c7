"""The pose of A in B's frame from that of B in A's, where both rest on the same two maps and differ in their priors."""

import math

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.linalg import invert
from relloc_env.kernels.motion import wrap_angle
from relloc_env.kernels.pair_tracking import invert_pose

MIRROR_SD = 0.07
"""[rad] standard deviation of the heading up to which one direction's pose comes from the other's."""
MIRROR_SHIFT = 1.0
"""[-] squared length, in standard deviations, up to which the exchange of the priors may shift it."""


@kernel
def find_back(pairs, n, p, a, b, robots, tick):
    """The pair (b, a), if it was aligned just now from the same two maps as (a, b) is to be; else -1.

    Pairs are in the order of `samples.ordered_pairs`.
    """
    q = b * (robots - 1) + (a if a < b else a - 1)
    return q if pairs.when[n, q] == tick and pairs.age[n, q] == pairs.age[n, p] and pairs.aligned[n, q] else -1


@kernel
def _prior_terms(pose, prior, covariance, factor, info, gradient):
    """Write a prior's information and half the gradient of |pose - prior|² weighed with it; whether there is one."""
    for i in range(3):
        for j in range(3):
            factor[i, j] = covariance[i, j]
    if not invert(factor, info, 3):
        return False
    d_x, d_y, d_t = pose[0] - prior[0], pose[1] - prior[1], wrap_angle(pose[2] - prior[2])
    for i in range(3):
        gradient[i] = info[i, 0] * d_x + info[i, 1] * d_y + info[i, 2] * d_t
    return True


@kernel
def mirror_pair(pairs, n, p, q, work):
    """Take the pose of a pair from that of the other direction, with its own prior in place of the other's.

    Where the heading is well known, inverting a Gaussian leaves a Gaussian. Its information less that of the prior
    in it is that of the maps, Lambda; with the other prior the least squares have their minimum one Newton step away.
    Between two grids of headings the other direction's pose is the last one, carried here by odometry; so is its prior.

    Args:
        pairs: see there.
        n, p, q: environment, the pair, the other direction, as of `find_back`.
        work: (≥ 18, ≥ 3) scratch.

    Returns:
        Whether it was; if not, nothing is changed.
    """
    spread = pairs.anchored_covariance[n, q]
    if spread[2, 2] > MIRROR_SD * MIRROR_SD or pairs.has_second[n, q]:
        return False
    info, prior_info, factor, covariance = work[0:3, 0:3], work[3:6, 0:3], work[6:9, 0:3], work[9:12, 0:3]
    pose, pull, push, shift = work[12, 0:3], work[13, 0:3], work[14, 0:3], work[15, 0:3]
    back = pairs.anchored[n, q]
    invert_pose(back, spread, pose, covariance)
    if not _prior_terms(back, pairs.prior[n, q], pairs.prior_covariance[n, q], factor, prior_info, pull):
        return False
    # In this direction's frame: F = d(back)/d(pose), columns x, y, theta.
    for i in range(3):
        for j in range(3):
            factor[i, j] = covariance[i, j]
    if not invert(factor, info, 3):
        return False
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    f_xt, f_yt = back[1], -back[0]
    f = factor
    f[0, 0], f[0, 1], f[0, 2] = -cos, -sin, f_xt
    f[1, 0], f[1, 1], f[1, 2] = sin, -cos, f_yt
    f[2, 0], f[2, 1], f[2, 2] = 0.0, 0.0, -1.0
    for i in range(3):
        shift[i] = -(f[0, i] * pull[0] + f[1, i] * pull[1] + f[2, i] * pull[2])
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += f[k, i] * (
                    prior_info[k, 0] * f[0, j] + prior_info[k, 1] * f[1, j] + prior_info[k, 2] * f[2, j]
                )
            info[i, j] -= total
    if not _prior_terms(pose, pairs.prior[n, p], pairs.prior_covariance[n, p], factor, prior_info, push):
        return False
    for i in range(3):
        push[i] += shift[i]
        for j in range(3):
            info[i, j] += prior_info[i, j]
    if not invert(info, covariance, 3):
        return False
    length = 0.0
    for i in range(3):
        shift[i] = -(covariance[i, 0] * push[0] + covariance[i, 1] * push[1] + covariance[i, 2] * push[2])
        length -= shift[i] * push[i]
    if not length < MIRROR_SHIFT:
        return False
    target, mode = pairs.anchored_covariance[n, p], pairs.mode[n, p]
    invert_pose(pairs.mode[n, q], spread, mode, target)
    for i in range(3):
        pairs.anchored[n, p, i] = pose[i] + shift[i]
        mode[i] += shift[i]
        for j in range(3):
            target[i, j] = covariance[i, j]
    mode[2], pairs.anchored[n, p, 2] = wrap_angle(mode[2]), wrap_angle(pairs.anchored[n, p, 2])
    pairs.has_second[n, p] = False
    pairs.aligned[n, p] = True
    return True
