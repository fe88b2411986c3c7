"""Gains of the depth observers, as an action sets them."""

import math

from relloc_env.kernels._compile import kernel


@kernel
def tune(gains, shares, actions, log_bounds, first, rows):
    """Set gains on a log scale: gain = least (greatest/least)^((a + 1)/2) for an entry a of the action in [-1, 1].

    Args:
        gains: [1/s, 1/m²] (N, R, M, 2) H and alpha Lambda, written from `first` on.
        shares: [-] (N, R, G) written: the entries, clipped.
        actions: [-] (N, R, 2 + G) speed, yaw rate, then the gains of each point.
        log_bounds: (2, 2) logarithms of the least and the greatest H, then of alpha Lambda.
        first: 0 where an action sets both, 1 where alpha Lambda alone.
        rows: environments to work on.
    """
    for n in rows:
        for r in range(gains.shape[1]):
            k = 0
            for m in range(gains.shape[2]):
                for j in range(first, 2):
                    share = min(max(actions[n, r, 2 + k], -1.0), 1.0)
                    low, high = log_bounds[j, 0], log_bounds[j, 1]
                    gains[n, r, m, j] = math.exp(low + 0.5 * (share + 1.0) * (high - low))
                    shares[n, r, k] = share
                    k += 1
