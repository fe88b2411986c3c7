"""The physical side, sample by sample, over a batch in lanes: starts, motion until a contact, cameras, messages."""

import numpy as np

from relloc_env.kernels import driving as dr
from relloc_env.kernels import sensing as se
from relloc_env.kernels._compile import inlined, inner, kernel
from relloc_env.kernels.lanes import W
from relloc_env.kernels.placement import place
from relloc_env.kernels.streams import ACTUATOR, SCENARIO, fill_normals
from relloc_env.kernels.world import settle_contact


@kernel
def begin(
    params_, robots, obstacles, pairs, rows,
    pose, velocity, wheels, pending, command, points, visible, contact, collided, blocked, tick, position, deliver,
    streams, fixed_poses, fixed_points, guess_depth, guess_pose,
    s_period, s_odometry, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Start new episodes and take their first sample; returns how many could not be placed."""
    params, targets, count, none = params_[0], points.shape[1], 0, np.int64(0)
    sights = (robots.shape[0] * dr.ROBOT + 3 * targets) * W
    t = np.zeros(sights + robots.shape[0] * targets * se.SIGHT * W)
    for row in rows:
        n = np.uint64(row)  # an index without a sign needs no test whether it counts from the end
        if not place(
            pose[n], points[n], fixed_poses[n], fixed_points[n], guess_depth[n], guess_pose[n], streams[n, SCENARIO],
            params, robots, obstacles, pairs,
        ):  # fmt: skip
            count += 1
            continue
        tick[n] = 0
        position[n] = params.samples_per_action
        deliver[n] = -1
        velocity[n] = 0.0
        wheels[n] = 0.0
        pending[n] = 0.0
        command[n] = 0.0
        contact[n] = False
        collided[n] = False
        blocked[n] = 0
        s_odometry[n, 0] = 0.0
        _load(t, none, n, pose, velocity, wheels, command, points, blocked)
        se.draw(t, none, streams, n, sights, targets, params, robots.shape[0])
        _look(t, sights, targets, robots, obstacles, params.width)
        _store(
            t, none, n, none, 0.0 * params.dt, sights, params, robots, pairs, pose, velocity, visible, tick, deliver,
            streams, s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
        )  # fmt: skip
    return count


@inner
def _look(t, sights, targets, robots, obstacles, width):
    """What all cameras see, in all lanes."""
    se.look(t, robots.shape[0] * dr.ROBOT * W, sights, targets, robots, obstacles, width)
    for r in range(robots.shape[0]):
        se.detect(t, sights + r * targets * se.SIGHT * W, robots[r], targets, width)


@inner
def _store(
    t, lane, n, k, dt, sights, params, robots, pairs, pose, velocity, visible, tick, deliver, streams,
    s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Write what was measured in sample k of environment n, and the truth beside it; send its messages."""
    targets = visible.shape[2]
    s_period[n, k] = dt
    for r in range(robots.shape[0]):
        for j in range(3):
            t_pose[n, k, r, j] = pose[n, r, j]
            t_velocity[n, k, r, j] = velocity[n, r, j]
        frame = se.frame_due(tick[n], robots[r].frames_per_sample)
        for i in range(targets):
            s = lane + sights + (r * targets + i) * se.SIGHT * W
            visible[n, r, i] = t[s + se.VISIBLE] != 0.0
            seen = frame and t[s + se.MEASURED] != 0.0
            s_seen[n, k, r, i] = seen
            t_visible[n, k, r, i] = seen
            s_image[n, k, r, i, 0] = t[s + se.X] if seen else 0.0
            s_image[n, k, r, i, 1] = t[s + se.Y] if seen else 0.0
    se.exchange(deliver, streams, s_arrived, tick[n], n, k, params, pairs)


@kernel
def advance(
    actions, params_, robots, obstacles, pairs, rows, waiting, resumed,
    pose, velocity, wheels, pending, command, points, visible, contact, collided, blocked, tick, position, deliver,
    streams, s_period, s_odometry, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
):  # fmt: skip
    """Go on with the action, sample by sample, until it is done or a contact has to be solved.

    Args:
        actions: [-] (N, R, 2) shares of the limits, taken up unless `resumed`.
        params_, robots, obstacles, pairs: records and constants.
        rows: environments to work on.
        waiting: written: environments that wait for the contact solver.
        resumed: whether the contact solver has just moved the robots of `rows`.
        pose, ..., t_visible: fields of `World`, of `Samples` and of `Truth`.

    Returns:
        How many environments wait.
    """
    params, targets, count = params_[0], points.shape[1], 0
    sights = (robots.shape[0] * dr.ROBOT + 3 * targets) * W
    t = np.zeros(sights + robots.shape[0] * targets * se.SIGHT * W)
    live = np.zeros(W, np.bool_)
    for begin in range(0, rows.shape[0], W):
        lanes = min(W, rows.shape[0] - begin)
        for lane in range(lanes):
            n = np.uint64(rows[begin + lane])
            live[lane] = True
            if not resumed:
                _take_up(actions, n, robots, command, collided, blocked, position)
            _load(t, lane, n, pose, velocity, wheels, command, points, blocked)
        running, moved = lanes, resumed
        while running > 0:
            if not moved:
                for lane in range(lanes):
                    if live[lane] and params.actuator_noise:
                        for r in range(robots.shape[0]):
                            fill_normals(
                                streams, rows[begin + lane], ACTUATOR, t, r * dr.ROBOT * W + dr.NOISE + lane, W, 2
                            )
                dr.drive(t, robots.shape[0] * dr.ROBOT * W, targets, params, robots, obstacles, params.width)
                for lane in range(lanes):
                    if live[lane] and _touches(t, lane, robots.shape[0]):
                        n = np.uint64(rows[begin + lane])
                        _leave(t, lane, n, wheels, blocked, pending)
                        waiting[count] = n
                        count += 1
                        live[lane] = False
                        running -= 1
                dr.settle(t, robots.shape[0], params.width)
            for lane in range(lanes):
                if live[lane]:
                    n = np.uint64(rows[begin + lane])
                    se.draw(t, lane, streams, n, sights, targets, params, robots.shape[0])
                    if not moved:
                        _settle(t, lane, n, pose, velocity, contact)
            moved = False
            _look(t, sights, targets, robots, obstacles, params.width)
            for lane in range(lanes):
                if live[lane]:
                    n = np.uint64(rows[begin + lane])
                    k = position[n]
                    tick[n] += 1
                    position[n] = k + 1
                    _store(
                        t, lane, n, k, params.dt, sights, params, robots, pairs, pose, velocity, visible, tick, deliver,
                        streams, s_period, s_image, s_seen, s_arrived, t_pose, t_velocity, t_visible,
                    )  # fmt: skip
                    _measure_motion(t, lane, n, k, robots, velocity, s_odometry)
                    if k + 1 == params.samples_per_action:
                        _finish(t, lane, n, wheels, blocked)
                        live[lane] = False
                        running -= 1
    return count


@inlined
def _take_up(actions, n, robots, command, collided, blocked, position):
    """Take up a new action."""
    position[n] = 0
    for r in range(robots.shape[0]):
        command[n, r, 0] = dr.speed_of(actions[n, r, 0], robots[r].min_speed, robots[r].max_speed)
        command[n, r, 1] = dr.yaw_rate_of(actions[n, r, 1], robots[r].max_yaw_rate)
        collided[n, r] = False
        blocked[n, r] = 0


@inlined
def _load(t, lane, n, pose, velocity, wheels, command, points, blocked):
    """Put the world of environment n into a lane."""
    count = pose.shape[1]
    for r in range(count):
        i = lane + r * dr.ROBOT * W
        for j in range(3):
            t[i + dr.POSE + j * W] = pose[n, r, j]
            t[i + dr.VELOCITY + j * W] = velocity[n, r, j]
        for j in range(2):
            t[i + dr.WHEELS + j * W] = wheels[n, r, j]
            t[i + dr.COMMAND + j * W] = command[n, r, j]
        t[i + dr.BLOCKED] = blocked[n, r]
    for m in range(points.shape[1]):
        for j in range(3):
            t[lane + (count * dr.ROBOT + 3 * m + j) * W] = points[n, m, j]


@inlined
def _touches(t, lane, count):
    """Whether any robot touches something."""
    touched = 0.0
    for r in range(count):
        touched += t[lane + r * dr.ROBOT * W + dr.TOUCHES]
    return touched > 0.0


@inlined
def _finish(t, lane, n, wheels, blocked):
    """Keep what the next action starts from."""
    for r in range(wheels.shape[1]):
        i = lane + r * dr.ROBOT * W
        wheels[n, r, 0], wheels[n, r, 1] = t[i + dr.WHEELS], t[i + dr.WHEELS + W]
        blocked[n, r] = np.int64(t[i + dr.BLOCKED])


@inlined
def _leave(t, lane, n, wheels, blocked, pending):
    """Hand a lane over to the contact solver."""
    _finish(t, lane, n, wheels, blocked)
    for r in range(wheels.shape[1]):
        i = lane + r * dr.ROBOT * W
        for j in range(3):
            pending[n, r, j] = t[i + dr.END + j * W]


@inlined
def _settle(t, lane, n, pose, velocity, contact):
    """The motion of a lane that touched nothing is the truth now."""
    for r in range(pose.shape[1]):
        i = lane + r * dr.ROBOT * W
        for j in range(3):
            pose[n, r, j] = t[i + dr.POSE + j * W]
            velocity[n, r, j] = t[i + dr.VELOCITY + j * W]
        contact[n, r] = False


@inlined
def _measure_motion(t, lane, n, k, robots, velocity, odometry):
    """Odometry: the true mean velocity with noise. Wheels measure speed and yaw rate; a slide goes unnoticed."""
    for r in range(robots.shape[0]):
        i = lane + r * dr.ROBOT * W + dr.NOISE
        odometry[n, k, r, 0] = velocity[n, r, 0] + robots[r].odometry_v * t[i]
        odometry[n, k, r, 1] = 0.0
        odometry[n, k, r, 2] = velocity[n, r, 2] + robots[r].odometry_w * t[i + W]


@kernel
def after_contact(pose, pending, velocity, contact, collided, params_, robots, obstacles, rows):
    """Take over what the contact solver found."""
    for n in rows:
        settle_contact(pose, pending, velocity, contact, collided, n, params_[0], robots, obstacles)
