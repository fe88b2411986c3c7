"""The project's own log format (docs/log-format.md): a folder of CSV tables with a JSON header, exact to the bit.

Any simulated episode can be written to it, and any other log.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from relloc_env.files import whole, write_json
from relloc_env.logs.errors import LogError
from relloc_env.logs.source import Log, Truth
from relloc_env.samples import Float, Prior, Samples, ordered_pairs

FORMAT, VERSION = "relloc-log", 1
HEADER, SAMPLES, MESSAGES, TRUTH = "log.json", "samples.csv", "messages.csv", "truth.csv"
MESSAGE_COLUMNS = ("sample", "observer", "observed", "age")


def sample_columns(robots: Sequence[str], points: Sequence[str]) -> Iterator[str]:
    """Yield the names of the columns of `SAMPLES`."""
    yield "period"
    yield from (f"{r}.{part}" for r in robots for part in ("v", "lateral", "w"))
    yield from (f"{r}.{p}.{part}" for r in robots for p in points for part in ("seen", "x", "y"))


def truth_columns(robots: Sequence[str], points: Sequence[str], sensed: bool) -> tuple[str, ...]:
    """Return the names of the columns of `TRUTH`."""
    names = [f"{r}.{part}" for r in robots for part in ("x", "y", "theta")]
    if sensed:
        names += [f"{r}.{p}.sensed_depth" for r in robots for p in points]
    return tuple(names)


def _plain(array: NDArray[Any]) -> Any:
    """Nested lists with None for NaN, which JSON lacks."""
    if array.ndim:
        return [_plain(part) for part in array]
    value = float(array)
    return None if math.isnan(value) else value


def _write_csv(path: Path, names: Iterable[str], table: Float, formats: Sequence[str]) -> None:
    with whole(path) as partial, partial.open("w", encoding="utf-8", newline="\n") as file:
        np.savetxt(file, table, fmt=list(formats), delimiter=",", header=",".join(names), comments="")


def write_log(path: str | Path, log: Log) -> Path:
    """Write a log as a folder of the project's own format; return the folder.

    Raises:
        ValueError: where names cannot be told apart in the tables, or the folder holds a log already.
    """
    folder = Path(path)
    for label, names in (("robots", log.robots), ("points", log.points)):
        if len(set(names)) != len(names) or any(not name or set(name) & set(',"\n\r#') for name in names):
            raise ValueError(f"Argument `{label}` must be distinct names without commas, quotes and #, but is {names}")
    if (folder / HEADER).exists():
        raise ValueError(f"Argument `path` must be a new folder, but {folder} holds a log already")
    folder.mkdir(parents=True, exist_ok=True)
    s, count = log.samples, len(log)
    robots, points = len(log.robots), len(log.points)
    sights = np.concatenate([s.seen[0, ..., None].astype(np.float64), s.image[0]], axis=-1)
    table = np.concatenate(
        [s.period[0, :, None], s.odometry[0].reshape(count, -1), sights.reshape(count, -1)], axis=1, dtype=np.float64
    )
    # Nine significant digits hold a float32, seventeen a float64.
    formats = ["%.17g"] + ["%.9g"] * (3 * robots) + ["%d", "%.9g", "%.9g"] * (robots * points)
    _write_csv(folder / SAMPLES, sample_columns(log.robots, log.points), table, formats)
    pairs = ordered_pairs(robots)
    ages = np.arange(64, dtype=np.uint64)
    delivered = np.argwhere((s.arrived[0, :, :, None] >> ages) & np.uint64(1))
    rows = np.column_stack([delivered[:, 0], pairs[delivered[:, 1]].reshape(-1, 2), delivered[:, 2]])
    _write_csv(folder / MESSAGES, MESSAGE_COLUMNS, rows.astype(np.float64), ["%d"] * 4)
    truth = log.truth
    if truth is not None:
        parts = [truth.poses.reshape(count, -1)]
        if truth.sensed_depth is not None:
            parts.append(truth.sensed_depth.reshape(count, -1))
        columns = truth_columns(log.robots, log.points, truth.sensed_depth is not None)
        _write_csv(folder / TRUTH, columns, np.concatenate(parts, axis=1), ["%.17g"] * len(columns))
    header = {
        "format": FORMAT,
        "version": VERSION,
        "name": log.name,
        "robots": list(log.robots),
        "points": list(log.points),
        "samples": count,
        "messages": len(rows),
        "start": log.start,
        "velocity": log.velocity,
        "prior": {
            "depth": _plain(log.prior.depth[0]),
            "depth_sd": float(log.prior.depth_sd),
            "pose": _plain(log.prior.pose[0]),
            "pose_sd": _plain(log.prior.pose_sd),
        },
        "truth": None
        if truth is None
        else {"points": _plain(truth.points), "sensed_depth": truth.sensed_depth is not None},
        "configuration": dict(log.configuration),
        "warnings": list(log.warnings),
    }
    # The header comes last: without it, a folder holds no log.
    write_json(folder / HEADER, header, allow_nan=False)
    return folder


class LogWriter:
    """Collects one environment of a running simulation, block by block, and writes it as a log at the end.

    Args:
        path: the new folder.
        prior: what the estimators were told at the start.
        points: [m] (M, 3) true points in the world, or None where the truth is not to be written.
        robots, names: of the robots and of the points; default robot_a, …, point_1, ….
        configuration: how the episode was made, as plain data.
        row: which of the N environments.
    """

    def __init__(
        self,
        path: str | Path,
        prior: Prior,
        points: Float | None = None,
        *,
        robots: Sequence[str] | None = None,
        names: Sequence[str] | None = None,
        configuration: Mapping[str, Any] | None = None,
        row: int = 0,
    ) -> None:
        self._path, self._row = Path(path), row
        if self._path.exists():
            raise LogError(self._path, "exists already; a log is written to a new folder")
        count, marks = prior.depth.shape[1:]
        self._robots = tuple(robots) if robots is not None else tuple(f"robot_{chr(97 + r)}" for r in range(count))
        self._names = tuple(names) if names is not None else tuple(f"point_{m + 1}" for m in range(marks))
        self._prior = prior._replace(depth=prior.depth[row : row + 1].copy(), pose=prior.pose[row : row + 1].copy())
        self._points = None if points is None else np.array(points, dtype=np.float64)
        self._configuration = dict(configuration or {})
        self._blocks: list[tuple[NDArray[Any], ...]] = []
        self._poses: list[Float] = []

    def add(self, samples: Samples, poses: Float | None = None) -> None:
        """Take in a block of K samples, and the true poses (K, R, 3) at them, if the truth is to be written."""
        if (poses is None) != (self._points is None):
            raise ValueError("Argument `poses` must be given where the true points were, and only there")
        row = slice(self._row, self._row + 1)
        self._blocks.append(tuple(value[row].copy() for value in samples))
        if poses is not None:
            self._poses.append(np.array(poses, dtype=np.float64))

    def close(self) -> Path:
        """Write the folder and return it."""
        if not self._blocks:
            raise ValueError("A log must hold at least one sample, but none was added")
        samples = Samples(*(np.concatenate(field, axis=1) for field in zip(*self._blocks, strict=True)))
        truth = None if self._points is None else Truth(np.concatenate(self._poses), self._points)
        log = Log(
            name=self._path.name,
            kind="relloc",
            robots=self._robots,
            points=self._names,
            samples=samples,
            prior=self._prior,
            truth=truth,
            velocity="odometry",
            configuration=self._configuration,
        )
        return write_log(self._path, log)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
