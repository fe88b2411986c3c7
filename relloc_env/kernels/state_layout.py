"""Which number of the bound's state is what (`relloc_env.kernels.bound`): twists, points, heights, scales."""

from relloc_env.kernels._compile import inlined


def size_of(robots: int, count: int, *, heights: bool = False, scales: bool = False) -> int:
    """Return D, how many numbers the state has for so many robots and points."""
    return 3 * (robots - 1 + count) + (robots - 1 if heights else 0) + (2 * robots if scales else 0)


@inlined
def twist_of(robot):
    """First of the three numbers of the twist of a robot > 0; negative for robot A, which has none."""
    return 3 * (robot - 1)


@inlined
def point_of(robots, i):
    """First of the three numbers of a point."""
    return 3 * (robots - 1 + i)


@inlined
def height_of(size, robots, count, robot):
    """The height difference of the camera of a robot > 0; 0 for robot A, and where those are exact."""
    end = 3 * (robots - 1 + count)
    return end + robot - 1 if (size - end) % (2 * robots) > 0 and robot > 0 else 0


@inlined
def scales_of(size, robots, count, robot):
    """First of the two scales of a robot's odometry, in a state of `size` numbers; 0 where those are exact."""
    return size - 2 * (robots - robot) if size - 3 * (robots - 1 + count) >= 2 * robots else 0
