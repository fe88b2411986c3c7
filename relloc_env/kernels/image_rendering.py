"""What a robot's camera takes as a picture: floor, walls, obstacles, other robots and the targets, in RGB.

The camera looks along the heading, level: whatever stands upright fills a part of each column of the image, from the
depth of where the column's plane meets it. These parts are found once for each column, nearest first; each pixel
blends those that it shows, the floor or the sky behind them, and then the targets, farthest first, where no part is
nearer. Edges are blended by the share of the pixel that they cover.

A ray is a pixel's normalised image coordinates (x, y), of the ideal camera: distortion of the lens is in their table.
Lengths in [m], colours in levels from 0 to 255.
"""

import math

import numpy as np

from relloc_env.kernels._compile import inlined, inner, kernel
from relloc_env.kernels.streams import mix
from relloc_env.kernels.world import DISC

LAYER = 6
"""Numbers of an upright part of a column: depth, upper and lower end as image coordinates, colour."""
WALL_HEIGHT = 2.5
FLOOR, SKY, WALL = (176.0, 172.0, 164.0), (212.0, 216.0, 220.0), (196.0, 194.0, 186.0)
_LIGHT = (0.36, -0.48, 0.8)
"""Direction to the light in the world."""
_TABLE = np.int64(0xFFFF)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@inlined
def shade(n_x, n_y, n_z):
    """Brightness of a surface with this unit normal: ambient light and one soft lamp."""
    return 0.62 + 0.38 * max(0.0, n_x * _LIGHT[0] + n_y * _LIGHT[1] + n_z * _LIGHT[2])


@inlined
def _share(low, high, top, bottom):
    """Share of the interval from low to high that lies between top and bottom."""
    return min(max((min(high, bottom) - max(low, top)) / (high - low), 0.0), 1.0)


@inner
def _insert(layers, count, z, top, bottom, red, green, blue):
    """Put an upright part where its depth belongs; `layers` (L, LAYER). Returns the new count."""
    at = count
    while at > 0 and layers[at - 1, 0] > z:
        for k in range(LAYER):
            layers[at, k] = layers[at - 1, k]
        at -= 1
    layers[at, 0], layers[at, 1], layers[at, 2] = z, top, bottom
    layers[at, 3], layers[at, 4], layers[at, 5] = red, green, blue
    return count + 1


@inner
def _stand(layers, count, enter, leave, mount, height, bright, paint):
    """Add what stands on the floor from one depth to another; its top shows where it is below the camera."""
    top = (mount - height) / (leave if height < mount else enter)
    return _insert(layers, count, enter, top, mount / enter, bright * paint[0], bright * paint[1], bright * paint[2])


@inner
def _add_wall(layers, count, x, y, d_x, d_y, mount, half_x, half_y):
    """Add the wall of the arena that the column's plane meets."""
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
    top, bottom = (mount - WALL_HEIGHT) / z, mount / z
    return _insert(layers, count, z, top, bottom, bright * WALL[0], bright * WALL[1], bright * WALL[2])


@inner
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


@inner
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


@inner
def _columns(layers, counts, columns, pose, mount, half_x, half_y, bodies, body_paints, obstacles, paints):
    """Upright parts of every column: `layers` (C, L, LAYER) and `counts` (C,); `columns` (2,) first ray and step."""
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    for c in range(counts.shape[0]):
        ray = columns[0] + c * columns[1]
        d_x, d_y, here = cos + sin * ray, sin - cos * ray, layers[c]
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
        counts[c] = count


@inlined
def _floor(x, y, reach):
    """Brightness of the floor: tiles and joints every metre, fading where a pixel covers much of one."""
    u, w = x - math.floor(x), y - math.floor(y)
    joint = 1.0 if max(abs(u - 0.5), abs(w - 0.5)) > 0.48 else 0.0
    odd = (np.int64(math.floor(x)) + np.int64(math.floor(y))) & np.int64(1)
    return 1.0 + (0.04 * odd - 0.02 - 0.08 * joint) / (1.0 + 16.0 * reach * reach)


@inner
def _background(line, rays, columns, layers, counts, pose, mount, half):
    """Add a row of the image but for the targets to `line` (W, 3); `half` is half the height of a pixel as a ray."""
    p_x, p_y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    inverse, last = 1.0 / columns[1], counts.shape[0] - 1
    for j in range(line.shape[0]):
        x, y = rays[j, 0], rays[j, 1]
        c = min(max(np.int64((x - columns[0]) * inverse + 0.5), 0), last)
        red, green, blue, left = 0.0, 0.0, 0.0, 1.0
        for k in range(counts[c]):
            layer = layers[c, k]
            if y + half > layer[1] and y - half < layer[2]:
                part = left * _share(y - half, y + half, layer[1], layer[2])
                red, green, blue = red + part * layer[3], green + part * layer[4], blue + part * layer[5]
                left -= part
                if left < 1e-3:
                    break
        if left >= 1e-3:
            if y > 1e-4:
                z = mount / y
                bright = _floor(p_x + z * (cos + sin * x), p_y + z * (sin - cos * x), 2.0 * half * z / y)
                fade = left * bright * (0.86 + 0.14 / (1.0 + 0.04 * z))
                red, green, blue = red + fade * FLOOR[0], green + fade * FLOOR[1], blue + fade * FLOOR[2]
            else:
                fade = left * (1.0 + 0.1 * max(y, -1.0))
                red, green, blue = red + fade * SKY[0], green + fade * SKY[1], blue + fade * SKY[2]
        line[j, 0] += red
        line[j, 1] += green
        line[j, 2] += blue


@inlined
def _free(layers, count, z, low, high):
    """Share of an interval of a column that nothing upright before the depth z hides."""
    left = 1.0
    for k in range(count):
        if layers[k, 0] >= z:
            break
        left -= left * _share(low, high, layers[k, 1], layers[k, 2])
    return left


@inner
def _sphere(line, row, rays, columns, layers, counts, target, paint, half, sin, cos):
    """Blend a row of a sphere into `line`: `target` is X, Y, Z of its centre in the camera's frame, radius, borders."""
    X, Y, Z, radius = target[0], target[1], target[2], target[3]
    k = X * X + Y * Y + Z * Z - radius * radius
    inverse, last = 1.0 / columns[1], counts.shape[0] - 1
    if row < target[4] or row > target[5]:
        return
    for j in range(max(np.int64(target[6]), 0), min(np.int64(target[7]) + 1, line.shape[0])):
        x, y = rays[j, 0], rays[j, 1]
        dot, square = x * X + y * Y + Z, x * x + y * y + 1.0
        inside = dot * dot - square * k
        g_x, g_y = 2.0 * (dot * X - x * k), 2.0 * (dot * Y - y * k)
        cover = min(max(0.5 + 0.5 * inside / (half * math.sqrt(g_x * g_x + g_y * g_y + 1e-30)), 0.0), 1.0)
        if cover > 0.0:
            c = min(max(np.int64((x - columns[0]) * inverse + 0.5), 0), last)
            cover *= _free(layers[c], counts[c], Z, y - half, y + half)
            at = (dot - math.sqrt(max(inside, 0.0))) / square
            right, down, ahead = (at * x - X) / radius, (at * y - Y) / radius, (at - Z) / radius
            size = 1.0 / math.sqrt(right * right + down * down + ahead * ahead)
            n_x, n_y = (ahead * cos + right * sin) * size, (ahead * sin - right * cos) * size
            bright = shade(n_x, n_y, -down * size)
            for channel in range(3):
                line[j, channel] += cover * (bright * paint[channel] - line[j, channel])


@inner
def _tag(line, row, rays, columns, layers, counts, target, cells, half):
    """Blend a row of an upright square tag that faces the camera; `target` as of `_sphere`, half its edge as radius."""
    X, Y, Z, reach = target[0], target[1], target[2], target[3]
    distance = math.sqrt(X * X + Z * Z)
    right_x, right_z = Z / distance, -X / distance
    inverse, last, count = 1.0 / columns[1], counts.shape[0] - 1, cells.shape[0]
    if row < target[4] or row > target[5]:
        return
    for j in range(max(np.int64(target[6]), 0), min(np.int64(target[7]) + 1, line.shape[0])):
        x, y = rays[j, 0], rays[j, 1]
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
            c = min(max(np.int64((x - columns[0]) * inverse + 0.5), 0), last)
            cover = hits / 16.0 * _free(layers[c], counts[c], Z, y - half, y + half)
            for channel in range(3):
                line[j, channel] += cover * (235.0 * total / hits - line[j, channel])


@inlined
def distort(x, y, lens):
    """Where a lens puts an ideal image point (Brown and Conrady): `lens` is k1, k2, p1, p2, k3, in OpenCV's order."""
    square = x * x + y * y
    radial = 1.0 + square * (lens[0] + square * (lens[1] + square * lens[4]))
    return (
        x * radial + 2.0 * lens[2] * x * y + lens[3] * (square + 2.0 * x * x),
        y * radial + lens[2] * (square + 2.0 * y * y) + 2.0 * lens[3] * x * y,
    )


@inner
def _place(targets, order, points, sizes, pose, mount, intrinsics, lens):
    """Targets in the camera's frame, (M, 8): X, Y, Z, radius, first and last row and column; farthest first in `order`.

    What is not before the camera has no rows.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for m in range(points.shape[0]):
        d_x, d_y = points[m, 0] - pose[0], points[m, 1] - pose[1]
        X, Y, Z, radius = sin * d_x - cos * d_y, mount - points[m, 2], cos * d_x + sin * d_y, sizes[m]
        t = targets[m]
        t[0], t[1], t[2], t[3], t[4], t[5], t[6], t[7] = X, Y, Z, radius, 1.0, 0.0, 1.0, 0.0
        if 1.5 * radius + 0.01 < Z:
            reach, square = 1.5 * radius, Z * Z - 2.25 * radius * radius  # of a sphere that a square fits in
            root_x, root_y = math.sqrt(X * X + square), math.sqrt(Y * Y + square)
            low_x, high_x = (X * Z - reach * root_x) / square, (X * Z + reach * root_x) / square
            low_y, high_y = (Y * Z - reach * root_y) / square, (Y * Z + reach * root_y) / square
            t[4], t[5], t[6], t[7] = np.inf, -np.inf, np.inf, -np.inf
            for a in range(3):
                for b in range(3):
                    u, v = distort(low_x + 0.5 * a * (high_x - low_x), low_y + 0.5 * b * (high_y - low_y), lens)
                    column, row = intrinsics[0] * u + intrinsics[2], intrinsics[1] * v + intrinsics[3]
                    t[4], t[5] = min(t[4], math.floor(row) - 1.0), max(t[5], math.floor(row) + 1.0)
                    t[6], t[7] = min(t[6], math.floor(column) - 1.0), max(t[7], math.floor(column) + 1.0)
            t[4], t[5] = max(t[4], -1e6), min(t[5], 1e6)
            t[6], t[7] = max(t[6], -1e6), min(t[7], 1e6)
        at = m
        while at > 0 and targets[order[at - 1], 2] < Z:
            order[at] = order[at - 1]
            at -= 1
        order[at] = m


@inner
def _expose(out, start, steps, line, gains, sd, normals, seed):
    """Turn a row of light into levels: gain of each channel, noise, clipping."""
    at = np.int64(mix(seed) & np.uint64(0xFFFF))
    for j in range(line.shape[0]):
        place = start + j * steps[1]
        for channel in range(3):
            value = line[j, channel] * gains[channel] + sd * normals[(at + 3 * j + channel) & _TABLE] + 0.5
            out[place + channel * steps[2]] = np.uint8(min(max(value, 0.0), 255.0))


@kernel
def render(
    out, steps, rays, columns, intrinsics, lens, poses, mount, half_x, half_y, bodies, body_paints, obstacles, paints,
    points, sizes, colours, cells, gains, sd, normals, seed, layers, counts, targets, order, line,
):  # fmt: skip
    """Take one picture.

    Args:
        out: uint8 (H W 3) flat, written.
        steps: (3,) of `out` from one row, column, channel to the next.
        rays: float32 (H, W, 2) of the pixels' centres.
        columns: (2,) ray of the first of C columns in which upright things are found, and the step between them.
        intrinsics: [px] (4,) f_x, f_y, c_x, c_y.
        lens: (5,) see `distort`.
        poses: [m, m, rad] (B, 3) of the camera while the shutter is open; the picture is their mean.
        mount: height of the camera.
        half_x, half_y: half the size of the arena; infinite for an open floor.
        bodies: (B, K, 4) x, y, radius, height of the other robots; `body_paints` (K, 3) their colours.
        obstacles: (O, 7), see `kernels.world`; `paints` (O, 3) their colours.
        points: (M, 3) targets; `sizes` (M,) radii of spheres, or half the edges of tags with their white border.
        colours: (M, 3) of spheres.
        cells: float32 (M, T, T) from 0 for black to 1 for white, of tags; T = 0 for spheres.
        gains: (3,) of the channels.
        sd: [levels] standard deviation of the noise.
        normals: float32 (65536,) standard normal numbers, of which each row takes a stretch.
        seed: uint64 of the noise.
        layers, counts, targets, order, line: float32 (B, C, L, LAYER) with L above K + O, int64 (B, C), (B, M, 8),
            int64 (B, M), float32 (W, 3): room to work in.
    """
    moments, height, width = poses.shape[0], rays.shape[0], rays.shape[1]
    half = 0.5 / intrinsics[1]
    for b in range(moments):
        _columns(
            layers[b], counts[b], columns, poses[b], mount, half_x, half_y, bodies[b], body_paints, obstacles, paints
        )
        _place(targets[b], order[b], points, sizes, poses[b], mount, intrinsics, lens)
    total = np.empty((width, 3), np.float32) if moments > 1 else line
    for i in range(height):
        for b in range(moments):
            line[:] = 0.0
            _background(line, rays[i], columns, layers[b], counts[b], poses[b], mount, half)
            for k in range(points.shape[0]):
                m = order[b, k]
                if cells.shape[1] > 0:
                    _tag(line, i, rays[i], columns, layers[b], counts[b], targets[b, m], cells[m], half)
                else:
                    _sphere(
                        line, i, rays[i], columns, layers[b], counts[b], targets[b, m], colours[m], half,
                        math.sin(poses[b, 2]), math.cos(poses[b, 2]),
                    )  # fmt: skip
            if moments > 1:
                for j in range(width):
                    for channel in range(3):
                        before = 0.0 if b == 0 else total[j, channel]
                        total[j, channel] = before + line[j, channel] / moments
        _expose(out, i * steps[0], steps, total, gains, sd, normals, seed + np.uint64(i) * _GOLDEN)
