"""Targets in a picture: spheres, or upright square tags. Lengths in [m], colours in levels from 0 to 255."""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.image_columns import free, shade
from relloc_env.kernels.lanes import natural

WHITE = 235.0
"""Of tags."""
REACH = 1.5
"""Of a sphere that a square tag fits in, in half edges of the tag with its border."""


@inlined
def distort(x, y, lens):
    """Where a lens puts an ideal image point (Brown and Conrady): `lens` is k1, k2, p1, p2, k3, in OpenCV's order."""
    square = x * x + y * y
    radial = 1.0 + square * (lens[0] + square * (lens[1] + square * lens[4]))
    return (
        x * radial + 2.0 * lens[2] * x * y + lens[3] * (square + 2.0 * x * x),
        y * radial + lens[2] * (square + 2.0 * y * y) + 2.0 * lens[3] * x * y,
    )


@kernel
def place(targets, order, points, size, view, mount, intrinsics, lens):
    """Targets in the camera's frame, (M, 8): X, Y, Z, size, first and last row and column; farthest first in `order`.

    What is not before the camera has no rows.
    """
    reach = REACH * size
    for m in range(points.shape[0]):
        d_x, d_y = points[m, 0] - view[0], points[m, 1] - view[1]
        X, Y, Z = view[4] * d_x - view[3] * d_y, mount - points[m, 2], view[3] * d_x + view[4] * d_y
        t = targets[m]
        t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7] = X, Y, Z, size, 1.0, 0.0, 1.0, 0.0
        if reach + 0.01 < Z:
            square = Z * Z - reach * reach
            root_x, root_y = math.sqrt(X * X + square), math.sqrt(Y * Y + square)
            low_x, high_x = (X * Z - reach * root_x) / square, (X * Z + reach * root_x) / square
            low_y, high_y = (Y * Z - reach * root_y) / square, (Y * Z + reach * root_y) / square
            t[4], t[5], t[6], t[7] = 1e6, -1e6, 1e6, -1e6
            for a in range(3):
                for b in range(3):
                    u, v = distort(low_x + 0.5 * a * (high_x - low_x), low_y + 0.5 * b * (high_y - low_y), lens)
                    column, row = intrinsics[0] * u + intrinsics[2], intrinsics[1] * v + intrinsics[3]
                    t[4], t[5] = max(min(t[4], row - 2.0), -1e6), min(max(t[5], row + 1.0), 1e6)
                    t[6], t[7] = max(min(t[6], column - 2.0), -1e6), min(max(t[7], column + 1.0), 1e6)
        at = m
        while at > 0 and targets[order[at - 1], 2] < Z:
            order[at] = order[at - 1]
            at -= 1
        order[at] = m


@kernel
def sphere(line, rays, column_of, layers, target, paint, half, view):
    """Blend a row of a sphere into `line`; `target` as of `place`."""
    X, Y, Z, radius, cos, sin = target[0], target[1], target[2], target[3], view[3], view[4]
    k = X * X + Y * Y + Z * Z - radius * radius
    for j in range(np.int64(max(target[6], 0.0)), np.int64(min(target[7] + 1.0, column_of.shape[0]))):
        x, y = float(rays[0, j]), float(rays[1, j])
        dot, square = x * X + y * Y + Z, x * x + y * y + 1.0
        inside = dot * dot - square * k  # 0 on the outline; the gradient makes it a distance
        g_x, g_y = 2.0 * (dot * X - x * k), 2.0 * (dot * Y - y * k)
        cover = min(0.5 + 0.5 * inside / (half * math.sqrt(g_x * g_x + g_y * g_y + 1e-30)), 1.0)
        if cover > 0.0:
            cover *= free(layers, natural(column_of[j]), Z, y - half, y + half)
            at = (dot - math.sqrt(max(inside, 0.0))) / square
            right, down, ahead = at * x - X, at * y - Y, at - Z
            size = 1.0 / math.sqrt(right * right + down * down + ahead * ahead)
            bright = shade((ahead * cos + right * sin) * size, (ahead * sin - right * cos) * size, -down * size)
            for channel in range(3):
                line[channel, j] += cover * (bright * paint[channel] - line[channel, j])


@kernel
def tag(line, rays, column_of, layers, target, cells, half):
    """Blend a row of an upright square tag that faces the camera; `target` as of `place`."""
    X, Y, Z, reach = target[0], target[1], target[2], target[3]
    distance, count = math.sqrt(X * X + Z * Z), cells.shape[0]
    right_x, right_z = Z / distance, -X / distance
    for j in range(np.int64(max(target[6], 0.0)), np.int64(min(target[7] + 1.0, column_of.shape[0]))):
        x, y = float(rays[0, j]), float(rays[1, j])
        total, hits = 0.0, 0
        for a in range(4):
            for b in range(4):
                s_x, s_y = x + half * (0.5 * a - 0.75), y + half * (0.5 * b - 0.75)
                at = distance * distance / (s_x * X + Z)  # where the ray meets the tag's plane
                u = ((at * s_x - X) * right_x + (at - Z) * right_z) / reach
                v = (at * s_y - Y) / reach
                if at > 0.0 and abs(u) < 1.0 and abs(v) < 1.0:
                    total += cells[np.int64(0.5 * (v + 1.0) * count), np.int64(0.5 * (u + 1.0) * count)]
                    hits += 1
        if hits > 0:
            cover = hits / 16.0 * free(layers, natural(column_of[j]), Z, y - half, y + half)
            for channel in range(3):
                line[channel, j] += cover * (WHITE * total / hits - line[channel, j])
