"""What a robot measures in one sample: image points, odometry; and which messages reach it. In lanes (`kernels.lanes`).

`in_view` is the same for one robot and target, for the drawing of starts.
"""

import math

import numpy as np

from relloc_env.kernels import driving as dr
from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.camera import crosses_box, crosses_disc, view
from relloc_env.kernels.elementary import sin_cos
from relloc_env.kernels.lanes import W, natural
from relloc_env.kernels.streams import (
    IMAGE,
    NETWORK,
    ODOMETRY,
    fill_pairs,
    fill_uniforms,
    make_normal,
    stream_of,
    uniform,
)
from relloc_env.kernels.world import DISC

VISIBLE, MEASURED, X, Y = 0 * W, 1 * W, 2 * W, 3 * W
"""Of a robot and a target: 1 where it is in view, 1 where it is measured, and where [-]."""
NOISE, CHANCE = 4 * W, 6 * W
"""Two standard normals and a uniform number."""
SIGHT = 7
"""Numbers of a robot and a target in the workspace."""


@inlined
def _inside(z, x, y, near, far, x_min, x_max, y_min, y_max):
    """Whether an image point is within the limits of depth and the borders of the image."""
    return (z >= near) & (z <= far) & (z > 0.0) & (x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)


@inlined
def _low_end(x, y, z, p_x, p_y, p_z):
    """The line of sight from its lower end a to b: where it first crosses a body is where it is lowest above it."""
    down = p_z < z
    return (
        p_x if down else x, p_y if down else y, p_z if down else z,
        x if down else p_x, y if down else p_y, z if down else p_z,
    )  # fmt: skip


@inlined
def _hides_disc(x, y, z, p_x, p_y, p_z, c_x, c_y, radius, height):
    """Whether an upright cylinder stands in the line of sight from (x, y, z) to p."""
    a_x, a_y, a_z, b_x, b_y, b_z = _low_end(x, y, z, p_x, p_y, p_z)
    at = crosses_disc(a_x, a_y, b_x, b_y, c_x, c_y, radius)
    return (at >= 0.0) & (a_z + at * (b_z - a_z) < height)


@inlined
def _hides_box(x, y, z, p_x, p_y, p_z, c_x, c_y, half_x, half_y, cos, sin, height):
    """Whether a box stands in the line of sight from (x, y, z) to p."""
    a_x, a_y, a_z, b_x, b_y, b_z = _low_end(x, y, z, p_x, p_y, p_z)
    at = crosses_box(a_x, a_y, b_x, b_y, c_x, c_y, half_x, half_y, cos, sin)
    return (at >= 0.0) & (a_z + at * (b_z - a_z) < height)


@kernel
def in_view(pose, points, r, i, robots, others, obstacles):
    """Whether robot r sees target i past the robots before `others` and obstacles; shapes (R, 3), (M, 3), (O, 7)."""
    x, y, height = pose[r, 0], pose[r, 1], robots[r].mount_height
    p_x, p_y, p_z = points[i, 0], points[i, 1], points[i, 2]
    sin, cos = sin_cos(pose[r, 2])
    z, image_x, image_y = view(x, y, cos, sin, height, p_x, p_y, p_z)
    c = robots[r]
    if not _inside(z, image_x, image_y, c.near, c.far, c.x_min, c.x_max, c.y_min, c.y_max):
        return False
    for k in range(others):
        c_x, c_y = pose[k, 0], pose[k, 1]
        if k != r and _hides_disc(x, y, height, p_x, p_y, p_z, c_x, c_y, robots[k].radius, robots[k].height):
            return False
    for o in range(obstacles.shape[0]):
        c_x, c_y, a, b = obstacles[o, 1], obstacles[o, 2], obstacles[o, 3], obstacles[o, 4]
        top = obstacles[o, 6]
        if obstacles[o, 0] == DISC:
            if _hides_disc(x, y, height, p_x, p_y, p_z, c_x, c_y, a, top):
                return False
        else:
            cos, sin = math.cos(obstacles[o, 5]), math.sin(obstacles[o, 5])
            if _hides_box(x, y, height, p_x, p_y, p_z, c_x, c_y, a, b, cos, sin, top):
                return False
    return True


@kernel
def look(t, points, sights, targets, robots, obstacles, width):
    """Image points of all targets for all robots, and which are in view.

    Args:
        t: workspace, robots first (`kernels.driving`).
        points: place of the first target, (x, y, z) each.
        sights: place of the first of the R M sights, `SIGHT` numbers each.
        targets: count M of targets.
        robots: records.
        obstacles: (O, 7), see `kernels.world`.
        width: lanes of a block.
    """
    count = robots.shape[0]
    for r in range(count):
        _face(t, r * dr.ROBOT * W, width)
    for r in range(count):
        for i in range(targets):
            p, q, s = r * dr.ROBOT * W, points + 3 * i * W, sights + (r * targets + i) * SIGHT * W
            _project(t, p, q, s, robots[r], width)
            for other in range(count):
                if other != r:
                    _hide_robot(t, p, q, s, other * dr.ROBOT * W, robots[r], robots[other], width)
            for o in range(obstacles.shape[0]):
                _hide(t, p, q, s, obstacles, o, robots[r], width)


@kernel
def _face(t, p, width):
    """Cosine and sine of a robot's heading."""
    p = natural(p)
    for i in range(width):
        t[p + i + dr.SIN], t[p + i + dr.COS] = sin_cos(t[p + i + dr.POSE + 2 * W])


@kernel
def _project(t, p, q, s, robot, width):
    """One target in one robot's image."""
    p, q, s, height = natural(p), natural(q), natural(s), robot.mount_height
    near, far, x_min, x_max, y_min, y_max = robot.near, robot.far, robot.x_min, robot.x_max, robot.y_min, robot.y_max
    for i in range(width):
        cos, sin = t[p + i + dr.COS], t[p + i + dr.SIN]
        r_x, r_y = t[p + i + dr.POSE], t[p + i + dr.POSE + W]
        z, x, y = view(r_x, r_y, cos, sin, height, t[q + i], t[q + i + W], t[q + i + 2 * W])
        t[s + i + VISIBLE] = 1.0 if _inside(z, x, y, near, far, x_min, x_max, y_min, y_max) else 0.0
        t[s + i + X], t[s + i + Y] = x, y


@kernel
def _hide_robot(t, p, q, s, other, robot, body, width):
    """Hide a target where another robot stands in the line of sight."""
    height, radius, top = robot.mount_height, body.radius, body.height
    p, q, s, o = natural(p), natural(q), natural(s), natural(other)
    for i in range(width):
        x, y, c_x, c_y = t[p + i + dr.POSE], t[p + i + dr.POSE + W], t[o + i + dr.POSE], t[o + i + dr.POSE + W]
        hides = _hides_disc(x, y, height, t[q + i], t[q + i + W], t[q + i + 2 * W], c_x, c_y, radius, top)
        t[s + i + VISIBLE] = min(t[s + i + VISIBLE], 0.0 if hides else 1.0)


@kernel
def _hide(t, p, q, s, obstacles, o, robot, width):
    """Hide a target where an obstacle stands in the line of sight."""
    c_x, c_y, a, b = obstacles[o, 1], obstacles[o, 2], obstacles[o, 3], obstacles[o, 4]
    top, height = obstacles[o, 6], robot.mount_height
    p, q, s = natural(p), natural(q), natural(s)
    if obstacles[o, 0] == DISC:
        for i in range(width):
            x, y = t[p + i + dr.POSE], t[p + i + dr.POSE + W]
            hides = _hides_disc(x, y, height, t[q + i], t[q + i + W], t[q + i + 2 * W], c_x, c_y, a, top)
            t[s + i + VISIBLE] = min(t[s + i + VISIBLE], 0.0 if hides else 1.0)
    else:
        cos, sin = math.cos(obstacles[o, 5]), math.sin(obstacles[o, 5])
        for i in range(width):
            x, y = t[p + i + dr.POSE], t[p + i + dr.POSE + W]
            hides = _hides_box(x, y, height, t[q + i], t[q + i + W], t[q + i + 2 * W], c_x, c_y, a, b, cos, sin, top)
            t[s + i + VISIBLE] = min(t[s + i + VISIBLE], 0.0 if hides else 1.0)


@inlined
def _detect(x, focal, centre, noise, step):
    """One coordinate of a detection: pixel noise, then rounding to `step` pixels; back to normalised coordinates."""
    pixel = focal * x + centre + noise
    rounded = step * np.floor(pixel / step + 0.5)
    return ((rounded if step > 0.0 else pixel) - centre) / focal


@kernel
def detect(t, sights, robot, targets, width):
    """What one robot's camera makes of the targets in view: where, and whether one is missed.

    Args:
        t: workspace.
        sights: place of the first of the robot's M sights; their noise is drawn.
        robot: record.
        targets: count M of targets.
        width: lanes of a block.
    """
    focal, c_x, c_y = robot.focal_length, robot.centre_x, robot.centre_y
    noise, step, missed = robot.pixel_noise, robot.quantisation, robot.miss_probability
    for m in range(targets):
        s = natural(sights + m * SIGHT * W)
        for i in range(width):
            t[s + i + MEASURED] = t[s + i + VISIBLE] if t[s + i + CHANCE] >= missed else 0.0
            t[s + i + X] = _detect(t[s + i + X], focal, c_x, noise * t[s + i + NOISE], step)
            t[s + i + Y] = _detect(t[s + i + Y], focal, c_y, noise * t[s + i + NOISE + W], step)


@kernel
def draw(t, live, streams, rows, begin, lanes, sights, targets, params, count):
    """Draw what a sample of the lanes that are `live` needs; how much does not depend on what is seen.

    Args:
        t, live: workspace and its lanes.
        streams: uint64 (N S 2).
        rows, begin, lanes: environments of the batch, the first in this block, how many are.
        sights: place of the first of the R M sights.
        targets: count M of targets.
        params: record.
        count: robots.
    """
    for lane in range(lanes):
        if live[lane]:
            n = rows[begin + lane]
            if params.image_noise:
                fill_pairs(streams, n, IMAGE, t, sights + NOISE + lane, SIGHT * W, count * targets)
            if params.misses:
                fill_uniforms(streams, n, IMAGE, t, sights + CHANCE + lane, SIGHT * W, count * targets)
            if params.odometry_noise:
                fill_pairs(streams, n, ODOMETRY, t, dr.NOISE + lane, dr.ROBOT * W, count)
    if params.image_noise:
        make_normal(t, sights + NOISE, SIGHT * W, count * targets, params.width)
    if params.odometry_noise:
        make_normal(t, dr.NOISE, dr.ROBOT * W, count, params.width)


@inlined
def frame_due(tick, rate):
    """Whether a camera with `rate` <= 1 frames per sample takes one at this tick: the first, and each that is due."""
    return rate >= 1.0 or tick == 0 or math.floor(tick * rate + 1e-9) > math.floor((tick - 1) * rate + 1e-9)


@kernel
def exchange(deliver, streams, arrived, tick, n, place, params, pairs):
    """Send this sample's messages, and mark those that arrive now, from `place` of `arrived` on.

    A message made at a tick arrives after latency + jitter, at the first sample that is not before; or never.
    """
    window = params.window
    stream = stream_of(streams, n, NETWORK)
    for p in range(pairs.shape[0]):
        due = tick
        if params.message_every > 1 and tick % params.message_every != 0:
            due = -1
        else:
            if params.loss > 0.0 and uniform(stream) < params.loss:
                due = -1
            delay = params.latency
            if params.jitter > 0.0:
                delay += params.jitter * uniform(stream)
            if due >= 0:
                due = tick + np.int64(math.ceil(delay / params.dt - 1e-9))
        first = natural((n * pairs.shape[0] + p) * window)
        deliver[first + tick % window] = due
        came = np.uint64(0)
        for age in range(min(window, tick + 1)):
            if deliver[first + (tick - age) % window] == tick:
                came |= np.uint64(1) << np.uint64(age)
        arrived[place + p] = came
