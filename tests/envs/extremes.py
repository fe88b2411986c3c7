"""All numeric options of all configurations, read off their models, and values at and beyond their limits."""

import math
import types
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel

from relloc_env.config import BoxConfig, CameraConfig, DiscConfig, EnvConfig, RobotConfig
from relloc_env.config.models import REWARD_TERMS
from relloc_env.estimators.config import CascadeConfig, InverseDepthConfig, MapAlignmentConfig
from relloc_env.quantities import Weight

BEYOND: tuple[Any, ...] = (
    0, -1, 1e-300, -1e-300, 1e150, -1e150, 1e300, float("inf"), float("-inf"), float("nan"), 2**64, -(2**64), 10**400,
    10**5000, "much", "", b"1", None, [], {}, (1.0,) * 7, True, 1j, object(),
)  # fmt: skip
"""What nobody means: out of any range, or of another type."""
LISTS = {"poses": ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0)), "points": ((3.0, 0.0, 0.5), (3.0, 1.0, 0.5))}
"""Options that are lists of any length, and what stands in them but for the number that is tried."""


class Option(NamedTuple):
    """A number in a configuration."""

    path: str
    """Of the option, `robot.lag`; for an obstacle or estimator with its tag, `estimator:cascade.h`."""
    within: tuple[int, ...]
    """Where the number stands in it, if the option is a tuple."""
    default: Any
    limits: tuple[float, ...]
    """Least and greatest value, as far as they are stated."""

    @property
    def name(self) -> str:
        """The option's own name."""
        return self.path.rpartition(".")[2]


def options() -> list[Option]:
    """All of them, in order."""
    found = [*_of(EnvConfig), *_of(RobotConfig, "robot."), *_of(CameraConfig, "camera.")]
    for shape in (DiscConfig, BoxConfig):
        found += _of(shape, f"obstacles:{shape.model_fields['shape'].default}.")
    for estimator in (CascadeConfig, InverseDepthConfig, MapAlignmentConfig):
        found += _of(estimator, f"estimator:{estimator.model_fields['kind'].default}.")
    found += [Option("camera.field_of_view", (), 62.2, (0.1, 178.0))]
    found += [Option(f"reward.{term}", (), 1.0, _limits([Weight])) for term in REWARD_TERMS]
    return sorted({(each.path, each.within): each for each in found}.values(), key=lambda each: each[:2])


def _of(model: type[BaseModel], path: str = "") -> Iterator[Option]:
    for name, field in model.model_fields.items():
        default = LISTS.get(name) if field.default is None or field.is_required() else field.default
        yield from _numbers(field.annotation, field.metadata, f"{path}{name}", (), default)


def _numbers(kind: Any, metadata: Any, path: str, index: tuple[int, ...], default: Any) -> Iterator[Option]:
    origin, inside = get_origin(kind), get_args(kind)
    if origin is Annotated:
        yield from _numbers(inside[0], inside[1:], path, index, default)
    elif origin in (Union, types.UnionType):
        for each in inside:
            yield from _numbers(each, (), path, index, default)
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        if ":" not in path and path not in ("estimator", "obstacles", "robot", "camera"):
            yield from _of(kind, f"{path}.")
    elif origin is tuple:
        count = (len(default) if isinstance(default, tuple) else 2) if inside[-1] is Ellipsis else len(inside)
        for k in range(count):
            part = default[k] if isinstance(default, tuple) and len(default) == count else None
            yield from _numbers(
                inside[min(k, len(inside) - 1) if inside[-1] is not Ellipsis else 0], (), path, (*index, k), part
            )
    elif kind in (float, int):
        yield Option(path, index, default, _limits(metadata))


def _limits(metadata: Any) -> tuple[float, ...]:
    found: list[float] = []
    for each in metadata:
        parts = (*get_args(each), *getattr(each, "metadata", ()), each)
        found += [getattr(part, name) for part in parts for name in ("ge", "gt", "le", "lt") if hasattr(part, name)]
    return tuple(found)


def given(option: Option, value: Any) -> dict[str, Any]:
    """Keywords of an environment with this number in its place, all else as it is by default."""
    group, _, last = option.path.rpartition(".")
    value = _placed(option, value)
    kind, _, tag = group.partition(":")
    if kind == "obstacles":
        shape: dict[str, Any] = {"radius": 0.2} if tag == "disc" else {"size": (0.2, 0.3)}
        return {"obstacles": [{"shape": tag, "position": (3.0, 3.0), **shape, last: value}]}
    if kind == "estimator":
        return {"estimator": {"kind": tag, last: value}}
    for part in reversed(option.path.split(".")):
        value = {part: value}
    result: dict[str, Any] = value
    return result


def _placed(option: Option, value: Any) -> Any:
    """A value in its tuple; the others there are the defaults, or the same where there are none."""
    rows: dict[int, list[Any]] = {}
    for each in (each for each in OPTIONS if each.path == option.path and each.within):
        own = each.within == option.within or each.default is None
        rows.setdefault(each.within[0], []).append(value if own else each.default)
    if not option.within:
        return value
    return list(rows.values()) if len(option.within) > 1 else [row[0] for row in rows.values()]


def drawn(option: Option, rng: np.random.Generator) -> float | int:
    """A value within the limits: one of them, or one between them of any order of magnitude."""
    least, most = option.limits
    if rng.random() < 0.4:
        return rng.choice([least, most]).item()
    size = math.exp(rng.uniform(math.log(least if least > 0.0 else 1e-9 * most), math.log(most)))
    value = -size if least < 0.0 and rng.random() < 0.5 else size
    return math.ceil(value) if isinstance(least, int) and isinstance(most, int) else value


OPTIONS = options()
