"""What stands upright in a picture, column by column: walls, obstacles, other robots.

The camera looks along the heading, level: whatever stands upright fills a part of each column of the image, from the
depth of where the column's plane meets it. The parts of a column are kept nearest first. Lengths in [m], colours in
levels from 0 to 255.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.world import DISC

LAYER = 6
"""Numbers of an upright part of a column: depth, upper and lower end as image coordinates, colour. What a column lacks
ends above where it begins, and so covers nothing."""
WALL_HEIGHT = 2.5
WALL = (196.0, 194.0, 186.0)
LIGHT = (0.36, -0.48, 0.8)
"""Direction to the lamp in the world."""


@inlined
def shade(n_x, n_y, n_z):
    """Brightness of a surface with this unit normal: light from everywhere, and a lamp far away."""
    return 0.62 + 0.38 * max(0.0, n_x * LIGHT[0] + n_y * LIGHT[1] + n_z * LIGHT[2])


@inlined
def share(low, high, top, bottom):
    """Share of the interval from low to high that lies between top and bottom."""
    return max((min(high, bottom) - max(low, top)) / (high - low), 0.0)


@inlined
def free(layers, c, z, low, high):
    """Share of an interval of column c that nothing upright before the depth z hides."""
    left = 1.0
    for k in range(layers.shape[0]):
        if layers[k, 0, c] >= z:
            break
        left -= left * share(low, high, layers[k, 1, c], layers[k, 2, c])
    return left


@kernel
def columns_of(layers, spans, ends, columns, pose, mount, half_x, half_y, bodies, body_paints, obstacles, paints):
    """Find the upright parts of every column.

    Args:
        layers: (L, LAYER, C), written: in each column the nearest part first.
        spans: int64 (L, 2), written: the columns that have so many parts are from the first to before the second.
        ends: float32 (L, 4), written: least and greatest upper end of these parts, least and greatest lower end.
        columns: (3,) ray of the first column, the step to the next, and how many there are.
        pose: [m, m, rad] (3,) of the camera, and its height `mount`.
        half_x, half_y: half the size of the arena; infinite for an open floor.
        bodies: (K, 4) x, y, radius, height of the other robots; `body_paints` (K, 3) their colours.
        obstacles: (O, 7), see `kernels.world`; `paints` (O, 3) their colours.
    """
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    spans[:, 0], spans[:, 1] = layers.shape[2], 0
    ends[:, 0], ends[:, 1], ends[:, 2], ends[:, 3] = np.inf, -np.inf, np.inf, -np.inf
    for c in range(np.int64(columns[2])):
        ray = columns[0] + c * columns[1]
        d_x, d_y, here = cos + sin * ray, sin - cos * ray, layers[:, :, c]
        count = _add_wall(here, 0, x, y, d_x, d_y, mount, half_x, half_y)
        for k in range(bodies.shape[0]):
            b = bodies[k]
            count = _add_disc(here, count, x, y, d_x, d_y, mount, b[0], b[1], b[2], b[3], body_paints[k])
        for o in range(obstacles.shape[0]):
            b = obstacles[o]
            if b[0] == DISC:
                count = _add_disc(here, count, x, y, d_x, d_y, mount, b[1], b[2], b[3], b[6], paints[o])
            else:
                count = _add_box(here, count, x, y, d_x, d_y, mount, b, paints[o])
        for k in range(layers.shape[0]):
            if k < count:
                spans[k, 0], spans[k, 1] = min(spans[k, 0], c), c + 1
                ends[k, 0], ends[k, 1] = min(ends[k, 0], here[k, 1]), max(ends[k, 1], here[k, 1])
                ends[k, 2], ends[k, 3] = min(ends[k, 2], here[k, 2]), max(ends[k, 3], here[k, 2])
            else:
                here[k, 0], here[k, 1], here[k, 2] = np.inf, np.inf, -np.inf


@kernel
def _insert(layers, count, z, top, bottom, bright, paint):
    """Put an upright part where its depth belongs. Returns the new count."""
    at = count
    while at > 0 and layers[at - 1, 0] > z:
        for k in range(LAYER):
            layers[at, k] = layers[at - 1, k]
        at -= 1
    layers[at, 0], layers[at, 1], layers[at, 2] = z, top, bottom
    layers[at, 3], layers[at, 4], layers[at, 5] = bright * paint[0], bright * paint[1], bright * paint[2]
    return count + 1


@kernel
def _stand(layers, count, enter, leave, mount, height, bright, paint):
    """Add what stands on the floor from one depth to another; its top shows where it is below the camera."""
    top = (mount - height) / (leave if height < mount else enter)
    return _insert(layers, count, enter, top, mount / enter, bright, paint)


@kernel
def _add_wall(layers, count, x, y, d_x, d_y, mount, half_x, half_y):
    """Add the wall of the arena that the column's plane meets, with a joint every metre."""
    if not math.isfinite(half_x):
        return count
    to_x = ((half_x if d_x > 0.0 else -half_x) - x) / d_x if d_x != 0.0 else np.inf
    to_y = ((half_y if d_y > 0.0 else -half_y) - y) / d_y if d_y != 0.0 else np.inf
    z = min(to_x, to_y)
    if z <= 0.0:
        return count
    along = y + z * d_y if to_x < to_y else x + z * d_x
    bright = shade(-math.copysign(1.0, d_x), 0.0, 0.0) if to_x < to_y else shade(0.0, -math.copysign(1.0, d_y), 0.0)
    if abs(along - math.floor(along) - 0.5) > 0.48:
        bright *= 0.93
    return _insert(layers, count, z, (mount - WALL_HEIGHT) / z, mount / z, bright, WALL)


@kernel
def _add_disc(layers, count, x, y, d_x, d_y, mount, c_x, c_y, radius, height, paint):
    """Add an upright cylinder."""
    f_x, f_y = x - c_x, y - c_y
    dd, df = d_x * d_x + d_y * d_y, d_x * f_x + d_y * f_y
    square = df * df - dd * (f_x * f_x + f_y * f_y - radius * radius)
    if square <= 0.0:
        return count
    root = math.sqrt(square)
    enter, leave = (-df - root) / dd, (-df + root) / dd
    if enter <= 0.0:
        return count
    bright = shade((f_x + enter * d_x) / radius, (f_y + enter * d_y) / radius, 0.0)
    return _stand(layers, count, enter, leave, mount, height, bright, paint)


@kernel
def _add_box(layers, count, x, y, d_x, d_y, mount, box, paint):
    """Add an upright box; `box` (7,) is a row of obstacles."""
    cos, sin = math.cos(box[5]), math.sin(box[5])
    p_0, p_1 = cos * (x - box[1]) + sin * (y - box[2]), cos * (y - box[2]) - sin * (x - box[1])
    d_0, d_1 = cos * d_x + sin * d_y, cos * d_y - sin * d_x
    enter, leave, first = -np.inf, np.inf, 0
    for axis in range(2):
        p, d, half = (p_0, d_0, box[3]) if axis == 0 else (p_1, d_1, box[4])
        if d == 0.0:
            if abs(p) > half:
                return count
        else:
            a, b = (-half - p) / d, (half - p) / d
            if min(a, b) > enter:
                enter, first = min(a, b), axis
            leave = min(leave, max(a, b))
    if enter >= leave or enter <= 0.0:
        return count
    side = -math.copysign(1.0, d_0 if first == 0 else d_1)
    n_x, n_y = (side * cos, side * sin) if first == 0 else (-side * sin, side * cos)
    return _stand(layers, count, enter, leave, mount, box[6], shade(n_x, n_y, 0.0), paint)
