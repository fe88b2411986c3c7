"""The project's own log format (docs/log-format.md): a folder of CSV tables with a JSON header, exact to the bit.

Any simulated episode can be written to it, and any other log.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from relloc_env.files import whole, write_json
from relloc_env.logs.errors import LogError
from relloc_env.logs.source import Log, Truth
from relloc_env.logs.tables import line_of_row, read_table, read_text
from relloc_env.samples import Float, Prior, Samples, ordered_pairs

FORMAT, VERSION = "relloc-log", 1
HEADER, SAMPLES, MESSAGES, TRUTH = "log.json", "samples.csv", "messages.csv", "truth.csv"
MESSAGE_COLUMNS = ("sample", "observer", "observed", "age")


def _sample_columns(robots: Sequence[str], points: Sequence[str]) -> tuple[str, ...]:
    names = ["period"]
    names += [f"{r}.{part}" for r in robots for part in ("v", "lateral", "w")]
    names += [f"{r}.{p}.{part}" for r in robots for p in points for part in ("seen", "x", "y")]
    return tuple(names)


def _truth_columns(robots: Sequence[str], points: Sequence[str], sensed: bool) -> tuple[str, ...]:
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


def _write_csv(path: Path, names: Sequence[str], table: Float, formats: Sequence[str]) -> None:
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
    _write_csv(folder / SAMPLES, _sample_columns(log.robots, log.points), table, formats)
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
        columns = _truth_columns(log.robots, log.points, truth.sensed_depth is not None)
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
    }
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


def _field(path: Path, data: Mapping[str, Any], name: str, kinds: tuple[type, ...]) -> Any:
    value = data.get(name)
    if name not in data or not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        wanted = " or ".join("null" if k is type(None) else k.__name__ for k in kinds)
        raise LogError(path, f"`{name}` must be {wanted}, but is {value!r}")
    return value


def _array(path: Path, name: str, value: Any, shape: tuple[int, ...]) -> Float:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise LogError(path, f"`{name}` must be numbers of shape {shape}") from None
    if 0 in shape and array.size == 0:
        array = array.reshape(shape)
    if array.shape != shape:
        raise LogError(path, f"`{name}` must have shape {shape}, but has {array.shape}")
    return array


def _table(path: Path, names: tuple[str, ...], rows: int) -> tuple[Float, str]:
    """Read one CSV table whose header and number of rows are known."""
    text = read_text(path)
    first = tuple(text.splitlines()[0].split(","))
    if first != names:
        wrong = next(
            (i for i, (a, b) in enumerate(zip(first, names, strict=False)) if a != b), min(len(first), len(names))
        )
        has = first[wrong] if wrong < len(first) else "nothing"
        wanted = names[wrong] if wrong < len(names) else "nothing"
        raise LogError(path, f"column {wrong + 1} must be {wanted!r}, but is {has!r}", 1)
    if rows == 0:
        return np.zeros((0, len(names))), text
    table, text = read_table(path, names, delimiter=",", skip=1, finite=False)
    if len(table) != rows:
        raise LogError(path, f"must have {rows} rows as {HEADER} says, but has {len(table)}: truncated?")
    return table, text


def _require(path: Path, text: str, good: NDArray[np.bool_] | np.bool_, message: str) -> None:
    rows = np.atleast_1d(good)
    if not rows.all():
        raise LogError(path, message, line_of_row(text, int(np.argmin(rows)), 1))


def read_log(path: str | Path) -> Log:
    """Read a folder of the project's own format.

    Raises:
        LogError: naming file and line, for files that are missing, empty, malformed, truncated, or mixed up.
    """
    folder = Path(path)
    head = folder / HEADER
    try:
        data = json.loads(read_text(head))
    except json.JSONDecodeError as error:
        raise LogError(head, f"is not JSON ({error.msg})", error.lineno) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise LogError(head, f'`format` must be "{FORMAT}"')
    if data.get("version") != VERSION:
        raise LogError(head, f"`version` must be {VERSION}, but is {data.get('version')!r}")
    robots, points = (tuple(map(str, _field(head, data, name, (list,)))) for name in ("robots", "points"))
    count = _field(head, data, "samples", (int,))
    if count < 1 or not robots or not points:
        raise LogError(head, "`robots`, `points` and `samples` must not be empty")
    pairs = ordered_pairs(len(robots))
    r, m = len(robots), len(points)

    source = folder / SAMPLES
    table, text = _table(source, _sample_columns(robots, points), count)
    sights = table[:, 1 + 3 * r :].reshape(count, r, m, 3)
    period, odometry = table[:, 0], table[:, 1 : 1 + 3 * r]
    _require(source, text, np.isfinite(period) & (period >= 0.0), "`period` must be 0 or more")
    _require(source, text, np.isfinite(odometry).all(axis=1), "velocities must be finite")
    _require(source, text, np.isin(sights[..., 0], (0.0, 1.0)).all(axis=(1, 2)), "`seen` must be 0 or 1")
    _require(source, text, np.isfinite(sights[..., 1]).all(axis=(1, 2)), "`x` must be finite")

    arrived = np.zeros((1, count, len(pairs)), dtype=np.uint64)
    source = folder / MESSAGES
    rows, text = _table(source, MESSAGE_COLUMNS, _field(head, data, "messages", (int,)))
    whole = (rows == np.rint(rows)).all(axis=1) & (rows >= 0).all(axis=1)
    inside = (rows[:, 0] < count) & (rows[:, 1] < r) & (rows[:, 2] < r) & (rows[:, 1] != rows[:, 2]) & (rows[:, 3] < 64)
    _require(source, text, whole & inside, "must name a sample, two robots and an age below 64")
    for k, a, b, age in rows.astype(np.int64):
        pair = int(np.flatnonzero((pairs[:, 0] == a) & (pairs[:, 1] == b))[0])
        arrived[0, k, pair] |= np.uint64(1) << np.uint64(age)

    truth = None
    about = _field(head, data, "truth", (dict, type(None)))
    if about is not None:
        sensed = bool(_field(head, about, "sensed_depth", (bool,)))
        table, _ = _table(folder / TRUTH, _truth_columns(robots, points, sensed), count)
        truth = Truth(
            table[:, : 3 * r].reshape(count, r, 3).copy(),
            _array(head, "truth.points", _field(head, about, "points", (list,)), (m, 3)),
            table[:, 3 * r :].reshape(count, r, m).copy() if sensed else None,
        )
    told = _field(head, data, "prior", (dict,))
    prior = Prior(
        _array(head, "prior.depth", told.get("depth"), (r, m))[None],
        _array(head, "prior.pose", told.get("pose"), (len(pairs), 3))[None],
        float(_field(head, told, "depth_sd", (int, float))),
        _array(head, "prior.pose_sd", told.get("pose_sd"), (3,)),
    )
    return Log(
        name=str(_field(head, data, "name", (str,))),
        kind="relloc",
        robots=robots,
        points=points,
        samples=Samples(
            period[None].copy(),
            odometry.reshape(1, count, r, 3).astype(np.float32),
            np.ascontiguousarray(sights[None, ..., 1:]).astype(np.float32),
            np.ascontiguousarray(sights[None, ..., 0] == 1.0),
            arrived,
        ),
        prior=prior,
        truth=truth,
        velocity=str(_field(head, data, "velocity", (str,))),
        start=float(_field(head, data, "start", (int, float))),
        configuration=_field(head, data, "configuration", (dict,)),
    )
