"""Estimators of the user's own: a look at what was made before anything runs on it."""

import numpy as np

from relloc_env.estimators.checks import check_array
from relloc_env.estimators.config import OwnConfig
from relloc_env.estimators.protocol import Estimator
from relloc_env.places import load
from relloc_env.samples import Estimate, Rows

METHODS = ("reset", "update", "get_state", "set_state")


def is_estimator(thing: object) -> bool:
    """Whether `thing` is an estimator already made, rather than a class or function that makes one."""
    return not isinstance(thing, type) and all(hasattr(thing, name) for name in ("reset", "update", "estimate"))


def make_own(config: OwnConfig, num_envs: int, robots: int, points: int, message_window: int) -> Estimator:
    """Call the factory behind a configuration, and check what it returns."""
    factory = load(config.factory) if isinstance(config.factory, str) else config.factory
    estimator: Estimator = factory(num_envs, robots, points, message_window=message_window)
    check_estimator(estimator, num_envs, robots, points)
    return estimator


def check_estimator(estimator: Estimator, num_envs: int, robots: int, points: int) -> None:
    """Raise where an estimator has not the form of the protocol, or its estimate not the shapes for these numbers.

    Raises:
        TypeError: methods that are missing, or an `estimate` that is none.
        ValueError: arrays of another shape or type, or made anew at each look.
    """
    missing = [name for name in METHODS if not callable(getattr(estimator, name, None))]
    if missing:
        raise TypeError(
            "Argument `estimator` must follow `relloc_env.estimators.Estimator`, "
            f"but {type(estimator).__name__} has no {', '.join(missing)}"
        )
    estimate = getattr(estimator, "estimate", None)
    if not isinstance(estimate, Estimate):
        raise TypeError(
            "Argument `estimator` must have an `estimate` of type `relloc_env.samples.Estimate`, "
            f"but it is {type(estimate).__name__}"
        )
    n, r, m, p = num_envs, robots, points, robots * (robots - 1)
    shapes = {
        "points": (n, r, m, 3),
        "points_covariance": (n, r, m, 3, 3),
        "known": (n, r, m),
        "pose": (n, p, 3),
        "pose_covariance": (n, p, 3, 3),
    }
    for name, shape in shapes.items():
        array = getattr(estimate, name)
        if not isinstance(array, np.ndarray):
            raise TypeError(f"Argument `estimator.estimate.{name}` must be an array, but is {type(array).__name__}")
        check_array(f"estimator.estimate.{name}", array, np.bool_ if name == "known" else np.float64, shape)
    if any(one is not other for one, other in zip(estimate, estimator.estimate, strict=True)):
        raise ValueError(
            "Argument `estimator.estimate` must be live arrays, refreshed in place, but each look gives other ones"
        )


def check_refreshed(estimator: Estimator, estimate: Estimate, rows: Rows) -> None:
    """Raise where an estimator has put other arrays in the place of those it had, or believes what is no number.

    Args:
        estimator: after a reset or an update.
        estimate: what it had when it was made.
        rows: environments that it worked on.

    Raises:
        ValueError: arrays that are not refreshed in place, or numbers that are not finite; points that are not known
            may be anything.
    """
    who, now = type(estimator).__name__, estimator.estimate
    if now is not estimate:
        for name, one, other in zip(Estimate._fields, estimate, now, strict=True):
            if one is not other:
                raise ValueError(
                    f"Estimator `{who}` must refresh the arrays of its `estimate` in place "
                    f"(`self.estimate.{name}[rows] = ...`), but has put another one in the place of `{name}`"
                )
    known = estimate.known[rows]
    for name, array in estimate._asdict().items():
        good = np.isfinite(array[rows])
        if name.startswith("points"):
            good |= ~known.reshape(known.shape + (1,) * (good.ndim - known.ndim))
        if not good.all():
            row = rows[np.argwhere(~good)[0, 0]]
            raise ValueError(
                f"Estimator `{who}` must give finite numbers, but its `estimate.{name}` of environment {row} is "
                f"{getattr(estimate, name)[row].tolist()}"
            )
