"""What `info` holds: the terms of the reward and the truth, of one environment or of a whole batch."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import ConfigError, hint
from relloc_env.ends import mean_terms
from relloc_env.kernels.world import World
from relloc_env.rewards import TERMS, Score
from relloc_env.samples import Bool, Rows, Sharing

if TYPE_CHECKING:
    from relloc_env.envs.core import Core

ENTRIES = ("reward", "truth", "origin", "errors", "information", "bound_sd", "prior")
"""What an `info` may hold; `reward` stands for all of `reward/<name>`, `prior` comes with a reset alone."""
_TERMS = tuple(f"reward/{name}" for name in TERMS)

Take = Callable[[NDArray[Any]], Any]
"""Copies of a live array, N first, what is wanted."""


class Information(Sharing):
    """Reads `info` from the live arrays of a core. What it gives is copied: later steps leave it as it is.

    Args:
        core: whose environments are told about.
        entries: which of `ENTRIES` are wanted.
    """

    def __init__(self, core: "Core", entries: Sequence[str] = ENTRIES) -> None:
        n = core.num_envs
        self._world, self._score, self._prior = core.simulation.world, core.score, core.simulation.prior
        self._prior_sd = (
            np.broadcast_to(np.float64(self._prior.depth_sd), n),
            np.broadcast_to(self._prior.pose_sd, (n, 3)),
        )
        self._num_envs, self._robots = n, core.config.robots
        wanted = {name: name in entries for name in ENTRIES}
        self._with_reward, self._with_truth, self._with_prior = wanted["reward"], wanted["truth"], wanted["prior"]
        self._with_origin = wanted["origin"]
        self._with_errors = wanted["errors"] and not core.bare
        bound = core.config.tracks_bound
        self._with_information, self._with_bound = wanted["information"] and bound, wanted["bound_sd"] and bound

        self._share()

    def _share(self) -> None:
        """What each environment has of the arrays, as it is asked for."""
        self._lines: dict[int, tuple[Any, Any]] = {}

    def _common(self, world: Any, score: Any, take: Take, number: Take) -> dict[str, Any]:
        """All but rewards and priors. `take` copies from fields (N, ...) of `World` and `Score`, `number` from (N,)."""
        info: dict[str, Any] = {}
        if self._with_truth:
            info["truth"] = {"poses": take(world.pose), "points": take(world.points)}
        if self._with_origin:
            info["origin"] = take(world.origin)
        if self._with_errors:
            info["errors"] = {"range": take(score.depth_error), "pose": take(score.pose_error)}
        if self._with_information:
            info["information"] = {"depth": take(score.depth_information), "pose": number(score.pose_information)}
        if self._with_bound:
            info["bound_sd"] = take(score.worst_sd)
        return info

    def _told(self, take: Take, number: Take) -> dict[str, Any]:
        """What the robots were told at the start, with its standard deviations."""
        prior, (depth_sd, pose_sd) = self._prior, self._prior_sd
        return {
            "depth": take(prior.depth),
            "pose": take(prior.pose),
            "depth_sd": number(depth_sd),
            "pose_sd": take(pose_sd),
        }

    def _at(self, n: int, new: bool) -> dict[str, Any]:
        """All but rewards, of environment n."""
        if n not in self._lines:
            world, score = self._world, self._score
            self._lines[n] = (
                World(*(_line(array, n) for array in world)),
                Score(*(_line(array, n) for array in score)),
            )
        info = self._common(*self._lines[n], np.ndarray.copy, np.ndarray.item)
        if new and self._with_prior:
            info["prior"] = self._told(lambda array: array[n].copy(), lambda array: array.item(n))
        return info

    def one(self, n: int, *, new: bool = False) -> dict[str, Any]:
        """`info` of environment n, with the mean over the robots of the reward's terms.

        Args:
            n: index of the environment.
            new: whether an episode starts; then with what the robots were told (`prior`).
        """
        if not self._with_reward:
            return self._at(n, new)
        lines = self._score.terms[n].tolist()
        mean = [total / len(lines) for total in map(sum, zip(*lines, strict=True))]
        return dict(zip(_TERMS, mean, strict=True)) | self._at(n, new)

    def each(self, n: int, *, new: bool = False) -> list[dict[str, Any]]:
        """`info` of every robot of environment n: the terms of its own reward, and all else as one object for all."""
        common = self._at(n, new)
        if not self._with_reward:
            return [common.copy() for _ in range(self._robots)]
        infos = []
        for line in self._score.terms[n].tolist():
            info = dict(zip(_TERMS, line, strict=True))
            info.update(common)
            infos.append(info)
        return infos

    def batch(self, rows: Rows | None = None, new: Rows | None = None) -> dict[str, Any]:
        """`info` of many environments, as Gymnasium's vector environments give it: arrays, N first, and masks.

        Args:
            rows: environments that are told about, None for all; the others' entries are zeros, and False in the mask.
            new: environments in which an episode starts, with `prior`.
        """
        info: dict[str, Any] = {}
        take = _taker(rows)
        if self._with_reward:
            mean = np.empty((self._num_envs, len(_TERMS)))
            mean_terms(self._score.terms, mean)
            mean = mean if rows is None else take(mean)
            info = {name: mean[:, i] for i, name in enumerate(_TERMS)}
        info = _masked(info | self._common(self._world, self._score, take, take), _mask(self._num_envs, rows))
        if new is not None and self._with_prior:
            take = _taker(new)
            info |= _masked({"prior": self._told(take, take)}, _mask(self._num_envs, new))
        return info


def check_entries(entries: object) -> tuple[str, ...]:
    """Return which entries of `info` are wanted, or raise where there is none of such a name."""
    if isinstance(entries, str) or not isinstance(entries, Sequence):
        raise ConfigError(f"Argument `info` must be a sequence of names among {', '.join(ENTRIES)}, but is {entries!r}")
    for name in entries:
        if name not in ENTRIES:
            close = hint(name, ENTRIES) if isinstance(name, str) else ""
            raise ConfigError(f"Argument `info` must have names among {', '.join(ENTRIES)}, but has {name!r}{close}")
    return tuple(entries)


def _line(array: NDArray[Any], n: int) -> NDArray[Any]:
    """What an array (N, ...) has of environment n, live."""
    return array[n] if array.ndim > 1 else array[n : n + 1]


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


def _masked(info: Mapping[str, Any], mask: Bool) -> dict[str, Any]:
    """The same entries, all the way down, each with the mask beside it."""
    result: dict[str, Any] = {}
    for name, part in info.items():
        result[name] = _masked(part, mask) if isinstance(part, dict) else part
        result[f"_{name}"] = mask
    return result
