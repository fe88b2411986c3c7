"""What `info` holds: the terms of the reward and the truth, of one environment or of a whole batch."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.config import ConfigError, hint
from relloc_env.rewards import TERMS
from relloc_env.samples import Bool, Rows

if TYPE_CHECKING:
    from relloc_env.envs.core import Core

ENTRIES = ("reward", "truth", "errors", "information", "bound_sd", "prior")
"""What an `info` may hold; `reward` stands for all of `reward/<name>`, `prior` comes with a reset alone."""
_TERMS = tuple(f"reward/{name}" for name in TERMS)


class Information:
    """Reads `info` from the live arrays of a core. What it gives is copied: later steps leave it as it is.

    Args:
        core: whose environments are told about.
        entries: which of `ENTRIES` are wanted.
    """

    def __init__(self, core: "Core", entries: Sequence[str] = ENTRIES) -> None:
        world, score, prior = core.simulation.world, core.score, core.simulation.prior
        n, every = core.num_envs, np.broadcast_to
        known: dict[str, NDArray[Any] | dict[str, NDArray[Any]]] = {
            "truth": {"poses": world.pose, "points": world.points},
            "errors": {"range": score.depth_error, "pose": score.pose_error},
            "information": {"depth": score.depth_information, "pose": score.pose_information},
            "bound_sd": score.worst_sd,
        }
        if core.bare:
            del known["errors"]
        self._num_envs, self._robots = n, core.config.robots
        self._terms: NDArray[np.float64] | None = score.terms if "reward" in entries else None
        self._live = {name: part for name, part in known.items() if name in entries}
        self._prior: dict[str, NDArray[Any]] | None = None
        if "prior" in entries:
            sd = {"depth_sd": every(np.float64(prior.depth_sd), n), "pose_sd": every(prior.pose_sd, (n, 3))}
            self._prior = {"depth": prior.depth, "pose": prior.pose, **sd}

    def one(self, n: int, *, new: bool = False) -> dict[str, Any]:
        """`info` of environment n, with the mean over the robots of the reward's terms.

        Args:
            n: index of the environment.
            new: whether an episode starts; then with what the robots were told (`prior`).
        """
        if self._terms is None:
            return self._common(n, new)
        lines = self._terms[n].tolist()
        line = lines[0] if len(lines) == 1 else [sum(term) / len(lines) for term in zip(*lines, strict=True)]
        return dict(zip(_TERMS, line, strict=True)) | self._common(n, new)

    def each(self, n: int, *, new: bool = False) -> list[dict[str, Any]]:
        """`info` of every robot of environment n: the terms of its own reward, and all else as one object for all."""
        common = self._common(n, new)
        if self._terms is None:
            return [common.copy() for _ in range(self._robots)]
        return [dict(zip(_TERMS, line, strict=True)) | common for line in self._terms[n].tolist()]

    def _common(self, n: int, new: bool) -> dict[str, Any]:
        """All but the terms of the reward."""
        info: dict[str, Any] = {}
        for name, part in self._live.items():
            if isinstance(part, dict):
                info[name] = {key: array[n].copy() for key, array in part.items()}
            else:
                info[name] = part[n].copy()
        if new and self._prior is not None:
            info["prior"] = {key: array[n].copy() for key, array in self._prior.items()}
        return info

    def batch(self, rows: Rows | None = None, new: Rows | None = None) -> dict[str, Any]:
        """`info` of many environments, as Gymnasium's vector environments give it: arrays, N first, and masks.

        Args:
            rows: environments that are told about, None for all; the others' entries are zeros, and False in the mask.
            new: environments in which an episode starts, with `prior`.
        """
        info: dict[str, Any] = {}
        mask = _mask(self._num_envs, rows)
        if self._terms is not None:
            terms = _fill(_mean(self._terms), rows) if rows is not None else _mean(self._terms)
            for i, name in enumerate(_TERMS):
                info[name], info[f"_{name}"] = terms[:, i], mask
        _add(info, self._live, rows, mask)
        if new is not None and self._prior is not None:
            _add(info, {"prior": self._prior}, new, _mask(self._num_envs, new))
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


def _mean(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """A fresh mean over the robots of terms (..., R, T)."""
    if terms.shape[-2] == 1:
        return terms[..., 0, :].copy()
    mean: NDArray[np.float64] = np.add.reduce(terms, axis=-2) / terms.shape[-2]
    return mean


def _mask(count: int, rows: Rows | None) -> Bool:
    """A fresh (N,) mask of the environments `rows`."""
    if rows is None:
        return np.ones(count, np.bool_)
    mask = np.zeros(count, np.bool_)
    mask[rows] = True
    return mask


def _fill(array: NDArray[Any], rows: Rows) -> NDArray[Any]:
    """A fresh array that holds the environments `rows`, and zeros elsewhere."""
    part = np.zeros(array.shape, array.dtype)
    part[rows] = array[rows]
    return part


def _add(info: dict[str, Any], parts: Mapping[str, Any], rows: Rows | None, mask: Bool) -> None:
    """Put copies of live arrays, and their masks, into `info`."""
    for name, part in parts.items():
        if isinstance(part, dict):
            inner: dict[str, Any] = {}
            _add(inner, part, rows, mask)
            info[name] = inner
        else:
            info[name] = part.copy() if rows is None else _fill(part, rows)
        info[f"_{name}"] = mask
