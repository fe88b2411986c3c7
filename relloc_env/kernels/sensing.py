"""What a robot measures in one sample: image points, odometry; and which messages reach it."""

import math

import numpy as np

from relloc_env.kernels._compile import kernel
from relloc_env.kernels.camera import crosses_box, crosses_disc
from relloc_env.kernels.streams import IMAGE, NETWORK, ODOMETRY, normal, uniform
from relloc_env.kernels.world import DISC


@kernel
def in_image(world, n, r, i, robots):
    """Project target i into robot r's image.

    Returns:
        (ahead, x, y): whether it is within the borders and the depth limits of the image; normalised coordinates.
    """
    robot = robots[r]
    cos, sin = math.cos(world.pose[n, r, 2]), math.sin(world.pose[n, r, 2])
    d_x = world.points[n, i, 0] - world.pose[n, r, 0]
    d_y = world.points[n, i, 1] - world.pose[n, r, 1]
    z = cos * d_x + sin * d_y
    if z < robot.near or z > robot.far or z <= 0.0:
        return False, 0.0, 0.0
    x = (sin * d_x - cos * d_y) / z
    y = (robot.mount_height - world.points[n, i, 2]) / z
    inside = robot.x_min <= x <= robot.x_max and robot.y_min <= y <= robot.y_max
    return inside, x, y


@kernel
def hidden(world, n, r, i, robots):
    """Whether an obstacle or another robot stands in the line of sight from robot r's camera to target i.

    The line is followed from its lower end a: where it first crosses a body is where it is lowest above it.
    """
    a_x, a_y, a_z = world.pose[n, r, 0], world.pose[n, r, 1], robots[r].mount_height
    b_x, b_y, b_z = world.points[n, i, 0], world.points[n, i, 1], world.points[n, i, 2]
    if b_z < a_z:
        a_x, a_y, a_z, b_x, b_y, b_z = b_x, b_y, b_z, a_x, a_y, a_z
    for other in range(robots.shape[0]):
        if other != r:
            c_x, c_y = world.pose[n, other, 0], world.pose[n, other, 1]
            at = crosses_disc(a_x, a_y, b_x, b_y, c_x, c_y, robots[other].radius)
            if at >= 0.0 and a_z + at * (b_z - a_z) < robots[other].height:
                return True
    obstacles = world.obstacles[n]
    for o in range(obstacles.shape[0]):
        if obstacles[o, 0] == DISC:
            at = crosses_disc(a_x, a_y, b_x, b_y, obstacles[o, 1], obstacles[o, 2], obstacles[o, 3])
        else:
            at = crosses_box(
                a_x, a_y, b_x, b_y, obstacles[o, 1], obstacles[o, 2], obstacles[o, 3], obstacles[o, 4], obstacles[o, 5]
            )
        if at >= 0.0 and a_z + at * (b_z - a_z) < obstacles[o, 6]:
            return True
    return False


@kernel
def _detect(x, focal, centre, noise, step, stream):
    """One coordinate of a detection: pixel noise, then rounding to `step` pixels; back to normalised coordinates."""
    pixel = focal * x + centre
    if noise > 0.0:
        pixel += noise * normal(stream)
    if step > 0.0:
        pixel = step * math.floor(pixel / step + 0.5)
    return (pixel - centre) / focal


@kernel
def _frame_due(tick, rate):
    """Whether a camera with `rate` <= 1 frames per sample takes one at this tick: the first, and each that is due."""
    return tick == 0 or math.floor(tick * rate + 1e-9) > math.floor((tick - 1) * rate + 1e-9)


@kernel
def look(world, samples, n, k, robots):
    """Fill image points and visibility of sample k."""
    stream = world.streams[n, IMAGE]
    for r in range(robots.shape[0]):
        robot = robots[r]
        frame = _frame_due(world.tick[n], robot.frames_per_sample)
        for i in range(world.points.shape[1]):
            inside, x, y = in_image(world, n, r, i, robots)
            inside = inside and not hidden(world, n, r, i, robots)
            world.visible[n, r, i] = inside
            seen = inside and frame
            if seen and robot.miss_probability > 0.0:
                seen = uniform(stream) >= robot.miss_probability
            samples.seen[n, k, r, i] = seen
            if seen:
                samples.image[n, k, r, i, 0] = _detect(
                    x, robot.focal_length, robot.centre_x, robot.pixel_noise, robot.quantisation, stream
                )
                samples.image[n, k, r, i, 1] = _detect(
                    y, robot.focal_length, robot.centre_y, robot.pixel_noise, robot.quantisation, stream
                )
            else:
                samples.image[n, k, r, i, 0] = 0.0
                samples.image[n, k, r, i, 1] = 0.0


@kernel
def measure_motion(world, samples, n, k, robots):
    """Fill the odometry of sample k: the true mean velocity with noise.

    The wheels measure speed along the heading and yaw rate; a slide to the side goes unnoticed.
    """
    stream = world.streams[n, ODOMETRY]
    for r in range(robots.shape[0]):
        v, w = world.velocity[n, r, 0], world.velocity[n, r, 2]
        if robots[r].odometry_v > 0.0:
            v += robots[r].odometry_v * normal(stream)
        if robots[r].odometry_w > 0.0:
            w += robots[r].odometry_w * normal(stream)
        samples.odometry[n, k, r, 0] = v
        samples.odometry[n, k, r, 1] = 0.0
        samples.odometry[n, k, r, 2] = w


@kernel
def exchange(world, samples, n, k, params, pairs):
    """Send this sample's messages, and mark those that arrive now.

    A message made at a tick arrives after latency + jitter, at the first sample that is not before; or never.
    """
    tick = world.tick[n]
    window = world.deliver.shape[2]
    stream = world.streams[n, NETWORK]
    for p in range(pairs.shape[0]):
        due = tick
        if params.message_every > 1 and tick % params.message_every != 0:
            due = -1
        else:
            if params.loss > 0.0 and uniform(stream) < params.loss:
                due = -1
            if params.jitter > 0.0:
                delay = params.latency + params.jitter * uniform(stream)
            else:
                delay = params.latency
            if due >= 0:
                due = tick + np.int64(math.ceil(delay / params.dt - 1e-9))
        world.deliver[n, p, tick % window] = due
        arrived = np.uint64(0)
        for age in range(min(window, tick + 1)):
            if world.deliver[n, p, (tick - age) % window] == tick:
                arrived |= np.uint64(1) << np.uint64(age)
        samples.arrived[n, k, p] = arrived
