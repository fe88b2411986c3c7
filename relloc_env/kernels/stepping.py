"""The physical side, sample by sample, over a batch in lanes: starts, motion until a contact, cameras, messages.

Arrays are flat (`kernels.lanes.flat`) but where a start is drawn.
"""

import numpy as np

from relloc_env.kernels import driving as dr
from relloc_env.kernels import sensing as se
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.lanes import W, natural, workspace
from relloc_env.kernels.placement import place
from relloc_env.kernels.streams import ACTUATOR, SCENARIO, fill_pairs, make_normal
from relloc_env.kernels.world import settle_contact


@kernel
def begin(
    params_, robots, obstacles, pairs, rows,
    pose, velocity, wheels, pending, command, points, visible, contact, collided, blocked, tick, position, deliver,
    streams, fixed_poses, fixed_points, guess_depth, guess_pose,
    s_period, s_odometry, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Start new episodes and take their first sample; returns how many could not be placed. Arrays are N first."""
    params, count = params_[0], 0
    sights = (robots.shape[0] * dr.ROBOT + 3 * params.targets) * W
    t = workspace(sights // W + robots.shape[0] * params.targets * se.SIGHT, params.width)
    live = np.ones(W, np.bool_)
    for j in range(rows.shape[0]):
        n = np.uint64(rows[j])  # an index without a sign needs no test whether it counts from the end
        if not place(
            pose[n], points[n], fixed_poses[n], fixed_points[n], guess_depth[n], guess_pose[n], streams[n, SCENARIO],
            params, robots, obstacles, pairs,
        ):  # fmt: skip
            count += 1
            continue
        tick[n] = -1
        position[n] = 0
        deliver[n] = -1
        velocity[n] = 0.0
        wheels[n] = 0.0
        pending[n] = 0.0
        command[n] = 0.0
        contact[n] = False
        collided[n] = False
        blocked[n] = 0
        s_odometry[n, 0] = 0.0
        _load(
            t, rows, j, 1, robots, params.targets, pose.ravel(), velocity.ravel(), wheels.ravel(), command.ravel(),
            points.ravel(), blocked.ravel(),
        )  # fmt: skip
        se.draw(t, live, streams.ravel(), rows, j, 1, sights, params.targets, params, robots.shape[0])
        _look(t, sights, params.targets, robots, obstacles, params.width)
        _store(
            t, live, rows, j, 1, 1, 0.0 * params.dt, sights, params, robots, pairs, visible.ravel(), tick, position,
            deliver.ravel(), streams.ravel(), s_period.ravel(), s_image.ravel(), s_seen.ravel(), s_arrived.ravel(),
            t_pose.ravel(), t_velocity.ravel(), t_visible.ravel(),
        )  # fmt: skip
        position[n] = params.samples_per_action
    return count


@kernel
def _look(t, sights, targets, robots, obstacles, width):
    """What all cameras see, in all lanes."""
    se.look(t, robots.shape[0] * dr.ROBOT * W, sights, targets, robots, obstacles, width)
    for r in range(robots.shape[0]):
        se.detect(t, sights + r * targets * se.SIGHT * W, robots[r], targets, width)


@kernel
def _store(
    t, live, rows, begin, lanes, block, dt, sights, params, robots, pairs, visible, tick, position, deliver, streams,
    s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Go on to the next of the `block` samples: what was measured, and the truth beside it; send messages."""
    count, targets = robots.shape[0], params.targets
    for lane in range(lanes):
        if not live[lane]:
            continue
        n = rows[begin + lane]
        now, k = tick[n] + 1, position[n]
        tick[n], position[n] = now, k + 1
        sample = natural(n * block + k)
        s_period[sample] = dt
        for r in range(count):
            i, at = natural(r * dr.ROBOT * W + lane), natural(3 * (sample * count + r))
            if block > 1:  # else the truth is what `World` has
                for j in range(3):
                    t_pose[at + j] = t[i + dr.POSE + j * W]
                    t_velocity[at + j] = t[i + dr.VELOCITY + j * W]
            frame = se.frame_due(now, robots[r].frames_per_sample)
            at, here = natural((sample * count + r) * targets), natural((n * count + r) * targets)
            for m in range(targets):
                s = natural(sights + (r * targets + m) * se.SIGHT * W + lane)
                visible[here + m] = t[s + se.VISIBLE] != 0.0
                seen = frame & (t[s + se.MEASURED] != 0.0)
                s_seen[at + m] = seen
                if block > 1:
                    t_visible[at + m] = seen
                s_image[2 * (at + m)] = t[s + se.X] if seen else 0.0
                s_image[2 * (at + m) + 1] = t[s + se.Y] if seen else 0.0
        at = natural(sample * pairs.shape[0])
        if params.perfect_network:
            for p in range(pairs.shape[0]):
                s_arrived[at + p] = np.uint64(1)
        else:
            se.exchange(deliver, streams, s_arrived, now, n, at, params, pairs)


@kernel
def advance(
    actions, params_, robots, obstacles, pairs, rows, waiting, resumed,
    pose, velocity, wheels, pending, command, points, visible, contact, collided, blocked, tick, position, deliver,
    streams, s_period, s_odometry, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Go on with the action, sample by sample, until it is done or a contact has to be solved.

    Args:
        actions: [-] (N R 2) shares of the limits, taken up unless `resumed`.
        params_, robots, obstacles, pairs: records and constants.
        rows: environments to work on.
        waiting: written: environments that wait for the contact solver.
        resumed: whether the contact solver has just moved the robots of `rows`.
        pose, ..., t_visible: fields of `World`, of `Samples` and of `Truth`, flat.

    Returns:
        How many environments wait.
    """
    params, robot_count, waits = params_[0], robots.shape[0], 0
    targets, block = params.targets, params.samples_per_action
    sights = (robot_count * dr.ROBOT + 3 * targets) * W
    t = workspace(sights // W + robot_count * targets * se.SIGHT, params.width)
    live = np.zeros(W, np.bool_)
    for begin in range(0, rows.shape[0], W):
        lanes = min(W, rows.shape[0] - begin)
        for lane in range(lanes):
            live[lane] = True
        if not resumed:
            _take_up(actions, rows, begin, lanes, robots, command, collided, blocked, position)
        _load(t, rows, begin, lanes, robots, targets, pose, velocity, wheels, command, points, blocked)
        running, moved = lanes, resumed
        while running > 0:
            if not moved:
                if params.actuator_noise:
                    for lane in range(lanes):
                        if live[lane]:
                            n = rows[begin + lane]
                            fill_pairs(streams, n, ACTUATOR, t, dr.NOISE + lane, dr.ROBOT * W, robot_count)
                    make_normal(t, dr.NOISE, dr.ROBOT * W, robot_count, params.width)
                dr.drive(t, robot_count * dr.ROBOT * W, targets, params, robots, obstacles, params.width)
                for lane in range(lanes):
                    if live[lane] and _touches(t, lane, robot_count):
                        _leave(t, rows[begin + lane], lane, robot_count, wheels, blocked, pending)
                        waiting[waits] = rows[begin + lane]
                        waits += 1
                        live[lane] = False
                        running -= 1
                dr.settle(t, robot_count, params.width)
                _settle(t, live, rows, begin, lanes, robot_count, pose, velocity, contact)
            moved = False
            se.draw(t, live, streams, rows, begin, lanes, sights, targets, params, robot_count)
            _look(t, sights, targets, robots, obstacles, params.width)
            _measure_motion(t, live, rows, begin, lanes, block, robots, position, s_odometry)
            _store(
                t, live, rows, begin, lanes, block, params.dt, sights, params, robots, pairs, visible, tick, position,
                deliver, streams, s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
            )  # fmt: skip
            for lane in range(lanes):
                n = rows[begin + lane]
                if live[lane] and position[natural(n)] == block:
                    _finish(t, n, lane, robot_count, wheels, blocked)
                    live[lane] = False
                    running -= 1
    return waits


@kernel
def _take_up(actions, rows, begin, lanes, robots, command, collided, blocked, position):
    """Take up new actions."""
    count = robots.shape[0]
    for lane in range(lanes):
        n = rows[begin + lane]
        position[natural(n)] = 0
        at = natural(n * count)
        for r in range(count):
            i = 2 * (at + r)
            command[i] = dr.speed_of(actions[i], robots[r].min_speed, robots[r].max_speed)
            command[i + 1] = dr.yaw_rate_of(actions[i + 1], robots[r].max_yaw_rate)
            collided[at + r] = False
            blocked[at + r] = 0


@kernel
def _load(t, rows, begin, lanes, robots, targets, pose, velocity, wheels, command, points, blocked):
    """Put the worlds of some environments into lanes."""
    count = robots.shape[0]
    for lane in range(lanes):
        n = rows[begin + lane]
        for r in range(count):
            i, at = natural(lane + r * dr.ROBOT * W), natural(n * count + r)
            for j in range(3):
                t[i + dr.POSE + j * W] = pose[3 * at + j]
                t[i + dr.VELOCITY + j * W] = velocity[3 * at + j]
            for j in range(2):
                t[i + dr.WHEELS + j * W] = wheels[2 * at + j]
                t[i + dr.COMMAND + j * W] = command[2 * at + j]
            t[i + dr.BLOCKED] = blocked[at]
            t[i + dr.NOISE], t[i + dr.NOISE + W] = 0.0, 0.0  # what a lane left behind may be no number
        i, at = natural(lane + count * dr.ROBOT * W), natural(3 * n * targets)
        for j in range(3 * targets):
            t[i + j * W] = points[at + j]


@kernel
def _touches(t, lane, count):
    """Whether any robot touches something."""
    touched = 0.0
    for r in range(count):
        touched += t[natural(lane + r * dr.ROBOT * W) + dr.TOUCHES]
    return touched > 0.0


@kernel
def _finish(t, n, lane, count, wheels, blocked):
    """Keep what the next action starts from."""
    for r in range(count):
        i, at = natural(lane + r * dr.ROBOT * W), natural(n * count + r)
        wheels[2 * at], wheels[2 * at + 1] = t[i + dr.WHEELS], t[i + dr.WHEELS + W]
        blocked[at] = np.int64(t[i + dr.BLOCKED])


@kernel
def _leave(t, n, lane, count, wheels, blocked, pending):
    """Hand a lane over to the contact solver."""
    _finish(t, n, lane, count, wheels, blocked)
    for r in range(count):
        i, at = natural(lane + r * dr.ROBOT * W), natural(3 * (n * count + r))
        for j in range(3):
            pending[at + j] = t[i + dr.END + j * W]


@kernel
def _settle(t, live, rows, begin, lanes, count, pose, velocity, contact):
    """The motion of lanes that touched nothing is the truth now."""
    for lane in range(lanes):
        if live[lane]:
            for r in range(count):
                i, at = natural(lane + r * dr.ROBOT * W), natural(rows[begin + lane] * count + r)
                for j in range(3):
                    pose[3 * at + j] = t[i + dr.POSE + j * W]
                    velocity[3 * at + j] = t[i + dr.VELOCITY + j * W]
                contact[at] = False


@kernel
def _measure_motion(t, live, rows, begin, lanes, block, robots, position, odometry):
    """Odometry: the true mean velocity with noise. Wheels measure speed and yaw rate; a slide goes unnoticed."""
    count = robots.shape[0]
    for lane in range(lanes):
        if live[lane]:
            n = rows[begin + lane]
            sample = n * block + position[natural(n)]
            for r in range(count):
                i, at = natural(lane + r * dr.ROBOT * W), natural(3 * (sample * count + r))
                odometry[at] = t[i + dr.VELOCITY] + robots[r].odometry_v * t[i + dr.NOISE]
                odometry[at + 1] = 0.0
                odometry[at + 2] = t[i + dr.VELOCITY + 2 * W] + robots[r].odometry_w * t[i + dr.NOISE + W]


@kernel
def after_contact(pose, pending, velocity, contact, collided, params_, robots, obstacles, rows):
    """Take over what the contact solver found."""
    for n in rows:
        settle_contact(pose, pending, velocity, contact, collided, n, params_[0], robots, obstacles)
