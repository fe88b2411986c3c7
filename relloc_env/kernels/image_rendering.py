"""What a robot's camera takes as a picture: floor, walls, obstacles, other robots and the targets, in RGB.

Each pixel blends the upright parts of its column (`kernels.image_columns`) that it shows, the floor or the sky behind
them, and then the targets (`kernels.image_targets`), farthest first, where no part is nearer. Edges are blended by the
share of the pixel that they cover. The floor hides nothing, as for the analytic camera: a target that touches it is
drawn whole.

A ray is a pixel's normalised image coordinates (x, y), of the ideal camera: distortion of the lens is in their table.
Lengths in [m], colours in levels from 0 to 255.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, kernel
from relloc_env.kernels.image_columns import columns_of
from relloc_env.kernels.image_targets import place, sphere, tag
from relloc_env.kernels.lanes import natural
from relloc_env.kernels.motion import advance
from relloc_env.kernels.streams import mix

FLOOR, SKY = (176.0, 172.0, 164.0), (212.0, 216.0, 220.0)
HORIZON = np.float32(1e-4)
"""Image coordinate below which the floor is."""
CHECKER, JOINT, NEAR_JOINT = np.float32(0.02), np.float32(0.08), np.float32(0.48)
"""How much the tiles of the floor differ from its mean brightness, and their joints; where these begin, in tiles from
the middle of one."""
NOTHING, HALF, MOST = np.float32(0.0), np.float32(0.5), np.float32(255.0)
STRIDE = 32
"""Rows of a picture are worked on in so many pixels at once: the arrays are as wide as that many times a whole number,
and what is beyond the picture is not shown."""
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@kernel
def render(
    out, places, steps, rays, column_of, columns, intrinsics, lens, poses, velocities, robot, shutter, mounts,
    half_x, half_y,
    sizes, paints_of_robots, obstacles, paints, points, target_size, colours, cells, gains, noise, seeds,
    layers, spans, ends, targets, order, line, total, shine, levels,
):  # fmt: skip
    """Take P pictures.

    Args:
        out: uint8, flat, written.
        places: int64 (P,) where in `out` the pictures begin.
        steps: int64 (3,) from one row, column, channel of a picture to the next: 3 V, 3, 1, or V, 1, H V, where V is
            its width; W is that of the arrays, see `STRIDE`.
        rays: float32 (H, 5, W) of the pixels' centres: x, y, and of the floor there its depth, its brightness and the
            contrast of its tiles; the brightness of the sky above the horizon.
        column_of: int32 (H, W) which of C columns they are in.
        columns: (3,) ray of the first column, the step to the next, and how many there are; beyond them, all parts of
            `layers` lack.
        intrinsics: [px] (4,) f_x, f_y, c_x, c_y.
        lens: (5,) see `image_targets.distort`.
        poses, velocities: [m, m, rad] and [m/s, m/s, rad/s] (P, R, 3) of all robots in the middle of the exposure.
        robot: whose camera.
        shutter: [s] how long it is open; a picture is the mean of B moments.
        mounts: (R,) heights of the cameras.
        half_x, half_y: half the size of the arena; infinite for an open floor.
        sizes: (R, 2) radii and heights of the robots; `paints_of_robots` (R, 3) their colours.
        obstacles: (O, 7), see `kernels.world`; `paints` (O, 3) their colours.
        points: (P, M, 3) targets.
        target_size: radius of the spheres, or half the edge of the tags with their white border.
        colours: (M, 3) of spheres.
        cells: float32 (M, T, T) from 0 for black to 1 for white, of tags; T = 0 for spheres.
        gains: (3,) of the channels.
        noise: [levels] float32, random numbers around 1/2, since levels are then cut off; more than 3 V + STRIDE. Each
            row of a picture takes a stretch.
        seeds: uint64 (P,) of the noise.
        layers, spans, ends, targets, order, line, total, shine, levels: float32 (B, L, LAYER, C) with L of at least
            R + O, int64 (B, L, 2), float32 (B, L, 4), (B, M, 8), int64 (B, M), float32 (3, W) twice, float32 (W,),
            uint8 (3 W,): room to work in.
    """
    moments, height, width = layers.shape[0], rays.shape[0], rays.shape[2]  # of the arrays
    shown = steps[0] // steps[1]
    bodies, body_paints = np.zeros((poses.shape[1] - 1, 4)), np.zeros((poses.shape[1] - 1, 3))
    for k in range(body_paints.shape[0]):
        body_paints[k] = paints_of_robots[k if k < robot else k + 1]
    views, mount, half = np.zeros((moments, 5)), mounts[robot], 0.5 / intrinsics[1]
    straight, weight = not lens.any(), np.float32(1.0 / moments)
    for p in range(poses.shape[0]):
        for b in range(moments):
            _move(views[b], bodies, poses[p], velocities[p], shutter * ((b + 0.5) / moments - 0.5), robot, sizes)
            columns_of(
                layers[b], spans[b], ends[b], columns, views[b], mount, half_x, half_y, bodies, body_paints, obstacles,
                paints,
            )  # fmt: skip
            place(targets[b], order[b], points[p], target_size, views[b], mount, intrinsics, lens)
        for i in range(height):
            if moments > 1:
                total[:] = 0.0
            for b in range(moments):
                here = total if moments == 1 else line
                if straight:  # pixels are their columns, and a row has one height
                    behind = _behind(spans[b], ends[b], rays[i, 1, 0], half, shown)
                    if behind == spans.shape[1]:
                        _ground_level(here, shine, rays[i], views[b])
                    _stack(here, shine, rays[i, 1, 0], layers[b], spans[b], ends[b], half, behind)
                else:
                    _ground(here, shine, rays[i], views[b])
                    _upright(here, shine, rays[i], column_of[i], layers[b], spans[b], half)
                for k in range(points.shape[1]):
                    m = order[b, k]
                    target = targets[b, m]
                    if target[4] <= i <= target[5]:
                        if cells.shape[1] > 0:
                            tag(here, rays[i], column_of[i], layers[b], target, cells[m], half)
                        else:
                            sphere(here, rays[i], column_of[i], layers[b], target, colours[m], half, views[b])
                if moments > 1:
                    for channel in range(3):
                        for j in range(width):
                            total[channel, j] += line[channel, j] * weight
            start, seed = places[p] + i * steps[0], seeds[p] + np.uint64(i) * _GOLDEN
            # What is beyond the end of a row, the next one is written over.
            count = width if i + 1 < height else shown
            if steps[1] == 1:
                _expose(out[start:], steps[2], total, count, shown, gains, noise, seed)
            else:
                _expose(levels, width, total, count, shown, gains, noise, seed)
                _interleave(out[start:], levels, width, count)


@kernel
def _move(view, bodies, poses, velocities, t, robot, sizes):
    """Put down where the camera is after t seconds, x, y, theta, cos, sin, and the other robots, see `columns_of`."""
    for r in range(poses.shape[0]):
        u, v = poses[r], velocities[r]
        x, y, theta = advance(u[0], u[1], u[2], v[0], v[1], v[2], t)
        if r == robot:
            view[0], view[1], view[2], view[3], view[4] = x, y, theta, math.cos(theta), math.sin(theta)
        else:
            b = bodies[r if r < robot else r - 1]
            b[0], b[1], b[2], b[3] = x, y, sizes[r, 0], sizes[r, 1]


@inlined
def _tile(x, y):
    """How much the floor at (x, y) is brighter than its mean: tiles of two shades with joints every metre."""
    a, b = np.floor(x), np.floor(y)
    odd = HALF * (a + b)
    checker = CHECKER if odd == np.floor(odd) else -CHECKER
    return checker - (JOINT if max(abs(x - a - HALF), abs(y - b - HALF)) > NEAR_JOINT else NOTHING)


@inlined
def _on_floor(x):
    """A coordinate [m] of the floor in float32, less whole kilometres: the tiles repeat, and it keeps its digits."""
    return np.float32(x - 1000.0 * np.floor(x / 1000.0 + 0.5))


@kernel
def _ground(line, shine, rays, view):
    """Put the floor and the sky of a row into `line` (3, W)."""
    p_x, p_y, cos, sin = _on_floor(view[0]), _on_floor(view[1]), np.float32(view[3]), np.float32(view[4])
    for j in range(shine.shape[0]):
        x, z = rays[0, j], rays[2, j]
        shine[j] = rays[3, j] + rays[4, j] * _tile(p_x + z * (cos + sin * x), p_y + z * (sin - cos * x))
    for channel in range(3):
        floor, sky, light = np.float32(FLOOR[channel]), np.float32(SKY[channel]), line[channel]
        for j in range(light.shape[0]):
            light[j] = shine[j] * (floor if rays[1, j] > HORIZON else sky)


@kernel
def _ground_level(line, shine, rays, view):
    """The same without distortion: a row has one height, and its floor one depth."""
    z, bright, contrast, floor = rays[2, 0], rays[3, 0], rays[4, 0], rays[1, 0] > HORIZON
    cos, sin = z * np.float32(view[3]), z * np.float32(view[4])
    x, y = _on_floor(view[0]) + cos, _on_floor(view[1]) + sin
    if floor:
        for j in range(shine.shape[0]):
            shine[j] = bright + contrast * _tile(x + sin * rays[0, j], y - cos * rays[0, j])
    for channel in range(3):
        light, flat = line[channel], bright * np.float32(SKY[channel])
        if floor:
            paint = np.float32(FLOOR[channel])
            for j in range(light.shape[0]):
                light[j] = paint * shine[j]
        else:
            for j in range(light.shape[0]):
                light[j] = flat


@inlined
def _behind(spans, ends, y, half, shown):
    """The nearest of what is upright that fills a whole row of a camera without distortion; L if none does."""
    for k in range(spans.shape[0]):
        if spans[k, 0] == 0 and spans[k, 1] == shown and ends[k, 1] <= y - half and ends[k, 2] >= y + half:
            return k
    return spans.shape[0]


@kernel
def _stack(line, part, y, layers, spans, ends, half, behind):
    """Blend a row of what is upright into `line` (3, W), farthest first, from what fills it all: see `_behind`.

    One loop finds the parts of the pixels that are covered, `part` (W,); three blend the colours.
    """
    low, high = np.float32(y - half), np.float32(y + half)
    per = np.float32(HALF / half)
    if behind < layers.shape[0]:
        for channel in range(3):
            light, paint = line[channel], layers[behind, 3 + channel]
            for j in range(light.shape[0]):
                light[j] = paint[j]
    for k in range(behind - 1, -1, -1):
        if ends[k, 0] < high and ends[k, 3] > low:
            first, last = STRIDE * (spans[k, 0] // STRIDE), STRIDE * -(-spans[k, 1] // STRIDE)
            top, bottom, cover = layers[k, 1, first:last], layers[k, 2, first:last], part[first:last]
            for j in range(cover.shape[0]):
                cover[j] = max(min(high, bottom[j]) - max(low, top[j]), NOTHING) * per
            for channel in range(3):
                light, paint = line[channel, first:last], layers[k, 3 + channel, first:last]
                for j in range(cover.shape[0]):
                    light[j] += cover[j] * (paint[j] - light[j])


@kernel
def _upright(line, part, rays, column_of, layers, spans, half):
    """The same where a lens distorts, and neighbouring pixels may be in one column or at another height."""
    half = np.float32(half)
    per = HALF / half
    for k in range(layers.shape[0] - 1, -1, -1):
        if spans[k, 0] >= spans[k, 1]:
            continue
        for j in range(part.shape[0]):
            c, y = natural(column_of[j]), rays[1, j]
            part[j] = max(min(y + half, layers[k, 2, c]) - max(y - half, layers[k, 1, c]), NOTHING) * per
        for channel in range(3):
            for j in range(part.shape[0]):
                line[channel, j] += part[j] * (layers[k, 3 + channel, natural(column_of[j])] - line[channel, j])


@kernel
def _expose(levels, step, line, count, shown, gains, noise, seed):
    """Turn a row of light (3, W) into levels: gain of each channel, noise, clipping.

    Args:
        levels: uint8, written: `count` levels of each channel; `step` from one channel to the next.
        shown: the width of the picture; the noise of the next channel begins after so many numbers.
    """
    at = np.int64(mix(seed) % np.uint64(noise.shape[0] - STRIDE - 3 * shown))
    for channel in range(3):
        gain, light, more = np.float32(gains[channel]), line[channel], noise[at + channel * shown :]
        level = levels[channel * step : channel * step + count]
        for j in range(level.shape[0]):
            level[j] = np.uint8(np.int32(min(max(gain * light[j] + more[j], NOTHING), MOST)))


@kernel
def _interleave(out, levels, step, count):
    """Put a row of levels, channel by channel with `step` between them, into a picture whose channels are last."""
    to, red, green, blue = out[: 3 * count], levels[:step], levels[step : 2 * step], levels[2 * step :]
    for j in range(count):
        to[3 * j], to[3 * j + 1], to[3 * j + 2] = red[j], green[j], blue[j]
