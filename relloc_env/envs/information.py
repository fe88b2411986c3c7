"""What `info` holds: the terms of the reward and the truth, of one environment or of a whole batch.

Names are flat (`truth/poses`), the same ones after a reset and after a step, and every value is a numpy array: what
collectors of other libraries stack. A number is an array of no dimension.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import ConfigError, hint
from relloc_env.ends import mean_terms
from relloc_env.quoting import quote
from relloc_env.rewards import TERMS
from relloc_env.samples import Bool, Rows, Sharing

if TYPE_CHECKING:
    from relloc_env.envs.core import Core

Source = Callable[[Any], NDArray[Any] | None]
"""Takes a `Core`: the live array (N, ...) of an entry, or None where the configuration has no such thing."""

SOURCES: dict[str, Source] = {
    "truth/poses": lambda core: core.simulation.world.pose,
    "truth/points": lambda core: core.simulation.world.points,
    "origin": lambda core: core.simulation.world.origin,
    "errors/range": lambda core: None if core.bare else core.score.depth_error,
    "errors/pose": lambda core: None if core.bare else core.score.pose_error,
    "information/depth": lambda core: core.score.depth_information if core.config.tracks_bound else None,
    "information/pose": lambda core: core.score.pose_information if core.config.tracks_bound else None,
    "bound_sd": lambda core: core.score.worst_sd if core.config.tracks_bound else None,
    "prior/depth": lambda core: core.simulation.prior.depth,
    "prior/pose": lambda core: core.simulation.prior.pose,
    "prior/depth_sd": lambda core: np.broadcast_to(np.float64(core.simulation.prior.depth_sd), core.num_envs),
    "prior/pose_sd": lambda core: np.broadcast_to(core.simulation.prior.pose_sd, (core.num_envs, 3)),
}
"""Every entry but the rewards', and where it is read. An entry is added here alone."""

ENTRIES = ("reward", *dict.fromkeys(name.partition("/")[0] for name in SOURCES))
"""What `info=` may ask for: each stands for all entries whose names begin so; whole names are taken as well."""

_NAMES = (*(f"reward/{name}" for name in TERMS), *SOURCES)

Take = Callable[[NDArray[Any]], Any]
"""Copies of a live array, N first, what is wanted."""


class Information(Sharing):
    """Reads `info` from the live arrays of a core. What it gives is copied: later steps leave it as it is.

    Args:
        core: whose environments are told about.
        entries: which entries are wanted, of `ENTRIES` or by their whole names.

    Raises:
        ConfigError: what is no entry.
    """

    def __init__(self, core: "Core", entries: Sequence[str] = ENTRIES) -> None:
        self.entries = check_entries(entries)
        self._core, self._robots = core, core.config.robots
        self._names = [name for name in _NAMES if name in self.entries or name.partition("/")[0] in self.entries]
        self._share()

    def _share(self) -> None:
        """The arrays that are read, and those of each environment as it is asked for."""
        core = self._core
        found = {name: SOURCES[name](core) for name in self._names if name in SOURCES}
        self._arrays = {name: array for name, array in found.items() if array is not None}
        # An index with an ellipsis gives an array of no dimension, where a plain one gives a number.
        self._terms = [(name, (i, ...)) for i, name in enumerate(_NAMES[: len(TERMS)]) if name in self._names]
        self._empty: dict[str, Any] = dict.fromkeys([*(name for name, _ in self._terms), *self._arrays])
        self._lines: dict[int, tuple[list[NDArray[Any]], list[tuple[str, NDArray[Any]]]]] = {}

    def _at(self, n: int) -> tuple[list[NDArray[Any]], dict[str, Any]]:
        """Of environment n: the live terms of each robot's reward, and `info` with all but these."""
        if n not in self._lines:
            rest = [(name, array[n, ...]) for name, array in self._arrays.items()]
            self._lines[n] = list(self._core.score.terms[n]), rest
        terms, rest = self._lines[n]
        info = self._empty.copy()  # much faster than a dictionary that grows
        for name, line in rest:
            info[name] = line.copy()
        return terms, info

    def one(self, n: int) -> dict[str, Any]:
        """`info` of environment n, with the mean over the robots of the reward's terms."""
        terms, info = self._at(n)
        mean = terms[0].copy()
        for other in terms[1:]:
            mean += other
        mean /= self._robots
        for name, place in self._terms:
            info[name] = mean[place]
        return info

    def each(self, n: int) -> list[dict[str, Any]]:
        """`info` of every robot of environment n: the terms of its own reward, and all else as one object for all."""
        terms, common = self._at(n)
        infos = []
        for line in terms:
            own, info = line.copy(), common.copy()
            for name, place in self._terms:
                info[name] = own[place]
            infos.append(info)
        return infos

    def batch(self, rows: Rows | None = None) -> dict[str, Any]:
        """`info` of many environments, as Gymnasium's vector environments give it: arrays, N first, and masks.

        Args:
            rows: environments that are told about, None for all; the others' entries are zeros, and False in the mask.
        """
        core = self._core
        take = _taker(rows)
        info: dict[str, Any] = {}
        if self._terms:
            mean = np.empty((core.num_envs, len(TERMS)))
            mean_terms(core.score.terms, mean)
            mean = mean if rows is None else take(mean)
            info = {name: mean[:, i] for name, (i, _) in self._terms}
        info.update((name, take(array)) for name, array in self._arrays.items())
        mask = _mask(core.num_envs, rows)
        return {key: value for name, array in info.items() for key, value in ((name, array), (f"_{name}", mask))}


def check_entries(entries: object) -> tuple[str, ...]:
    """Return which entries of `info` are wanted, or raise where there is none of such a name."""
    if isinstance(entries, str) or not isinstance(entries, Sequence):
        raise ConfigError(
            f"Argument `info` must be a sequence of names among {', '.join(ENTRIES)}, but is {quote(entries)}"
        )
    known = ENTRIES + _NAMES
    for name in entries:
        if name not in known:
            close = hint(name, known) if isinstance(name, str) else ""
            raise ConfigError(
                f"Argument `info` must have names among {', '.join(ENTRIES)}, but has {quote(name)}{close}"
            )
    return tuple(entries)


def _taker(rows: Rows | None) -> Take:
    """How arrays (N, ...) are copied: whole, or the environments `rows` with zeros elsewhere."""
    if rows is None:
        return np.ndarray.copy

    def take(array: NDArray[Any]) -> NDArray[Any]:
        part = np.zeros(array.shape, array.dtype)
        part[rows] = array[rows]
        return part

    return take


def _mask(count: int, rows: Rows | None) -> Bool:
    """A fresh (N,) mask of the environments `rows`."""
    if rows is None:
        return np.ones(count, np.bool_)
    mask = np.zeros(count, np.bool_)
    mask[rows] = True
    return mask
