"""What a trained policy takes: fields of an observation, in order, and how those of a task are put there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from agents.policy import INVERSE_RANGE, Task
from relloc_env.envs.observation import LAYOUT
from relloc_env.envs.onboard import POINT
from relloc_env.samples import Float32

Fit = Callable[[Float32], Float32]
"""From rows (..., D) of a task to rows (..., `Layout.row`)."""
SEEN, PER_POINT = ("points", "message_points"), ("points", "message_points", "gains")
"""Fields that hold what is known of every point, and all that hold something of each."""


@dataclass(frozen=True)
class Layout:
    """The observation that a policy was trained on."""

    joint: bool
    """Whether one row holds all robots' observations, and one action moves all; else a row is a robot's."""
    robots: int
    targets: int
    """Points that there is room for; where there are fewer, the others read as not seen."""
    fewest: int
    """Points that it was trained on at least."""
    nearest_first: bool
    """Whether points are in the order in which the robot believes them to be near, not in that of the environment."""
    fields: dict[str, int]
    """Size of each field that is used, in order."""
    version: int = LAYOUT

    @classmethod
    def of(
        cls,
        task: Task,
        *,
        joint: bool,
        fewest: int | None = None,
        nearest_first: bool = False,
        without: Sequence[str] = (),
    ) -> "Layout":
        """The layout of a task, `without` some of its fields.

        Raises:
            ValueError: a field that there is not.
        """
        sizes = {name: part.stop - part.start for name, part in task.slices.items()}
        for name in without:
            if name not in sizes:
                raise ValueError(f"Argument `without` must be of the fields {', '.join(sizes)}, but has {name!r}")
            del sizes[name]
        fewest = task.targets if fewest is None else fewest
        return cls(joint, task.robots, task.targets, fewest, nearest_first, sizes)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Layout":
        """Read what `to_dict` gave."""
        return cls(**{name: data[name] for name in cls.__dataclass_fields__})

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    @property
    def row(self) -> int:
        """Size of a robot's row."""
        return sum(self.fields.values())

    @property
    def size(self) -> int:
        """Size of what the policy takes."""
        return self.row * (self.robots if self.joint else 1)

    def fit(self, task: Task, what: str = "The policy") -> Fit:
        """How rows of a task become rows of this layout.

        Raises:
            ValueError: a task that the policy was not made for, with what differs; `what` names the policy.
        """
        if self.version != LAYOUT:
            raise ValueError(f"{what} takes observations of version {self.version}, but this is version {LAYOUT}")
        if self.robots != task.robots:
            raise ValueError(f"{what} is made for a task of {self.robots} robot(s), but the task has {task.robots}")
        if not self.fewest <= task.targets <= self.targets:
            span = f"{self.targets}" if self.fewest == self.targets else f"{self.fewest} to {self.targets}"
            raise ValueError(f"{what} is made for {span} points, but the task has {task.targets}")
        sources, places, start = [], [], 0
        for name, size in self.fields.items():
            if name not in task.slices:
                raise ValueError(f"{what} needs the field `{name}`, but the task has {', '.join(task.slices)}")
            part = task.slices[name]
            given = part.stop - part.start
            expected = size * task.targets // self.targets if name in PER_POINT else size
            if given != expected:
                raise ValueError(f"{what} takes {expected} numbers in the field `{name}`, but the task has {given}")
            sources.append(np.arange(part.start, part.stop))
            places.append(start + np.arange(given))
            start += size
        source, place = np.concatenate(sources), np.concatenate(places)
        if self.nearest_first:
            return lambda rows: self._put(_nearest_first(rows, task)[..., source], place)
        if len(source) == self.row == task.size:
            return lambda rows: rows
        return lambda rows: self._put(rows[..., source], place)

    def _put(self, rows: Float32, place: Any) -> Float32:
        """Numbers in their places of a row; points that are not there read as zeros."""
        if len(place) == self.row:
            return rows
        out: Float32 = np.zeros((*rows.shape[:-1], self.row), np.float32)
        out[..., place] = rows
        return out


def _nearest_first(rows: Float32, task: Task) -> Float32:
    """Rows with their points, own and told, in descending order of their own inverse range; unknown ones last."""
    out = rows.copy()
    own = rows[..., task.slices["points"]].reshape(*rows.shape[:-1], task.targets, POINT)
    order = np.argsort(-own[..., INVERSE_RANGE], axis=-1, kind="stable")[..., None]
    for name in SEEN:
        if name in task.slices:
            part = rows[..., task.slices[name]].reshape(own.shape)
            out[..., task.slices[name]] = np.take_along_axis(part, order, axis=-2).reshape(*rows.shape[:-1], -1)
    return out
