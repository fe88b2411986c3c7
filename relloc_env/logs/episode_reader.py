"""Reader of the project's own log format (docs/log-format.md)."""

from collections.abc import Iterable, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.logs.checks import LIMITS, Fail, Limits, Numbers, check_cells, check_numbers, check_samples
from relloc_env.logs.episode import (
    FORMAT,
    HEADER,
    MESSAGE_COLUMNS,
    MESSAGES,
    SAMPLES,
    TRUTH,
    VERSION,
    sample_columns,
    truth_columns,
)
from relloc_env.logs.errors import LogError
from relloc_env.logs.source import Log, Truth
from relloc_env.logs.tables import Table, read_table
from relloc_env.logs.text import read_json, read_text, stored
from relloc_env.quoting import quote
from relloc_env.samples import Float, Prior, Samples, ordered_pairs

MOST_ROBOTS = 100
"""Messages are kept for each sample and pair of robots."""
VELOCITIES = ("odometry", "commands", "mocap")


def read_log(path: str | Path, limits: Limits = LIMITS) -> Log:
    """Read a folder of the project's own format; any file may be compressed by gzip (`samples.csv.gz`).

    Args:
        path: the folder.
        limits: what is refused.

    Raises:
        LogError: naming file and line, for files that are missing, empty, malformed, truncated, or mixed up.
    """
    folder = Path(path)
    head = stored(folder / HEADER)
    data = read_json(head)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise LogError(head, f'`format` must be "{FORMAT}"')
    if data.get("version") != VERSION:
        raise LogError(head, f"`version` must be {VERSION}, but is {quote(data.get('version'))}")
    robots, points = (_names(head, data, name) for name in ("robots", "points"))
    count = _field(head, data, "samples", (int,))
    if count < 1 or not robots or not points:
        raise LogError(head, "`robots`, `points` and `samples` must not be empty")
    if len(robots) > MOST_ROBOTS:
        raise LogError(head, f"`robots` must be at most {MOST_ROBOTS}, but are {len(robots)}")
    if wrong := check_cells(count, len(robots), len(points), limits):
        raise LogError(head, f"the log {wrong}")
    velocity = str(_field(head, data, "velocity", (str,)))
    if velocity not in VELOCITIES:
        raise LogError(head, f"`velocity` must be one of {', '.join(VELOCITIES)}, but is {quote(velocity)}")
    samples, odd = _samples(folder, robots, points, count, _field(head, data, "messages", (int,)), limits)
    prior = _prior(head, _field(head, data, "prior", (dict,)), len(robots), len(points), limits)
    start = float(_field(head, data, "start", (int, float)))
    _check(head, "start", np.array([start]), limits)
    return Log(
        name=_name(head, "name", _field(head, data, "name", (str,))),
        kind="relloc",
        robots=robots,
        points=points,
        samples=samples,
        prior=prior,
        truth=_truth(folder, head, _field(head, data, "truth", (dict, type(None))), robots, points, count, limits),
        velocity=velocity,
        start=start,
        configuration=_field(head, data, "configuration", (dict,)),
        warnings=(*_texts(head, data, "warnings"), *odd),
    )


def _samples(
    folder: Path, robots: tuple[str, ...], points: tuple[str, ...], count: int, messages: int, limits: Limits
) -> tuple[Samples, list[str]]:
    """Read what was measured and received; return it, and what is odd about it."""
    r, m = len(robots), len(points)
    table = _table(folder / SAMPLES, sample_columns(robots, points), count)
    detections = table.rows[:, 1 + 3 * r :].reshape(count, r, m, 3)
    seen = detections[..., 0]
    keys = [f"{robot}.{point}.seen" for robot in robots for point in points]
    check_numbers([Numbers("seen", keys, seen.reshape(count, -1), "`seen`")], table.fail, limits)
    heard = _table(folder / MESSAGES, MESSAGE_COLUMNS, messages)
    rows, pairs = heard.rows, ordered_pairs(r)
    whole = (rows == np.rint(rows)).all(axis=1) & (rows >= 0).all(axis=1)
    inside = (rows[:, 0] < count) & (rows[:, 1] < r) & (rows[:, 2] < r) & (rows[:, 1] != rows[:, 2]) & (rows[:, 3] < 64)
    _require(heard, whole & inside, "must name a sample, two robots and an age below 64")
    _require(
        heard, rows[:, 3] <= rows[:, 0], "`age` must be at most `sample`: the message was made before the log began"
    )
    arrived = np.zeros((1, count, len(pairs)), dtype=np.uint64)
    number = np.zeros((r, r), dtype=np.int64)
    number[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
    k, a, b, age = rows.astype(np.int64).T
    np.bitwise_or.at(arrived[0], (k, number[a, b]), np.uint64(1) << age.astype(np.uint64))
    period, odometry = table.rows[None, :, 0], table.rows[:, 1 : 1 + 3 * r].reshape(1, count, r, 3)
    samples = Samples(period, odometry, detections[None, ..., 1:], seen[None] == 1.0, arrived)  # type: ignore[arg-type]
    odd = check_samples(samples, robots, points, table.fail, limits)
    if period[0, 0] != 0.0:
        odd.append(f"{table.path.name}: the first `period` is {period[0, 0]:g} s, where 0 is expected")
    samples = Samples(
        period.copy(),
        odometry.astype(np.float32),
        np.ascontiguousarray(detections[None, ..., 1:]).astype(np.float32),
        np.ascontiguousarray(samples.seen),
        arrived,
    )
    return samples, odd


def _prior(path: Path, stated: Mapping[str, Any], robots: int, points: int, limits: Limits) -> Prior:
    pairs = len(ordered_pairs(robots))
    prior = Prior(
        _array(path, "prior.depth", stated.get("depth"), (robots, points))[None],
        _array(path, "prior.pose", stated.get("pose"), (pairs, 3))[None],
        float(_field(path, stated, "depth_sd", (int, float), "prior.")),
        _array(path, "prior.pose_sd", stated.get("pose_sd"), (3,)),
    )
    _check(path, "prior.depth", prior.depth, limits, "depth")
    _check(path, "prior.pose", prior.pose, limits)
    _check(path, "prior.depth_sd", np.array([prior.depth_sd]), limits, "depth")
    _check(path, "prior.pose_sd", prior.pose_sd, limits, "depth")
    return prior


def _truth(
    folder: Path,
    head: Path,
    about: Mapping[str, Any] | None,
    robots: tuple[str, ...],
    points: tuple[str, ...],
    count: int,
    limits: Limits,
) -> Truth | None:
    if about is None:
        return None
    r, m = len(robots), len(points)
    sensed = bool(_field(head, about, "sensed_depth", (bool,), "truth."))
    table = _table(folder / TRUTH, truth_columns(robots, points, sensed), count)
    places = _array(head, "truth.points", _field(head, about, "points", (list,), "truth."), (m, 3))
    _check(head, "truth.points", places, limits, "place", unknown=True)
    check_numbers([Numbers("place", table.columns, table.rows, unknown=True)], table.fail, limits)
    return Truth(
        table.rows[:, : 3 * r].reshape(count, r, 3).copy(),
        places,
        table.rows[:, 3 * r :].reshape(count, r, m).copy() if sensed else None,
    )


def _name(path: Path, key: str, value: Any) -> str:
    try:
        str(value).encode()
    except UnicodeEncodeError:
        raise LogError(path, f"`{key}` must be text, but is {quote(value)}") from None
    return str(value)


def _names(path: Path, data: Mapping[str, Any], key: str) -> tuple[str, ...]:
    names = _field(path, data, key, (list,))
    wrong = next((name for name in names if not isinstance(name, str) or not name), None)
    if wrong is not None or len(set(map(str, names))) != len(names):
        but = "a name is there twice" if wrong is None else f"one is {quote(wrong)}"
        raise LogError(path, f"`{key}` must be list of distinct names, but {but}")
    return tuple(_name(path, key, name) for name in names)


def _texts(path: Path, data: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """Return a list of texts that may be missing."""
    return tuple(_name(path, key, words) for words in _field(path, {key: [], **data}, key, (list,)))


def _field(path: Path, data: Mapping[str, Any], name: str, kinds: tuple[type, ...], within: str = "") -> Any:
    value = data.get(name)
    if name not in data or not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        wanted = " or ".join("null" if k is type(None) else k.__name__ for k in kinds)
        raise LogError(path, f"`{within}{name}` must be {wanted}, but is {quote(value)}")
    return value


def _array(path: Path, name: str, value: Any, shape: tuple[int, ...]) -> Float:
    """Return numbers of a shape, with NaN for null."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise LogError(path, f"`{name}` must be numbers of shape {shape}") from None
    if 0 in shape and array.size == 0:
        array = array.reshape(shape)
    if array.shape != shape:
        raise LogError(path, f"`{name}` must have shape {shape}, but has {array.shape}")
    return array


def _check(path: Path, key: str, values: Float, limits: Limits, kind: Any = "number", *, unknown: bool = False) -> None:
    """Check numbers of the header."""
    check_numbers([Numbers(kind, (key,), values.reshape(-1, 1), unknown=unknown)], _head_fail(path), limits)


def _head_fail(path: Path) -> Fail:
    return lambda _, words: LogError(path, words)


def _table(path: Path, names: Iterable[str], rows: int) -> Table:
    """Read one CSV table whose header and number of rows are known."""
    text, path = read_text(path), stored(path)
    first = tuple(text.splitlines()[0].split(","))
    for number, (name, has) in enumerate(zip_longest(names, first), start=1):
        if name != has:
            wanted, found = ("nothing" if x is None else quote(x) for x in (name, has))
            raise LogError(path, f"column {number} must be {wanted}, but is {found}", 1)
    if rows == 0:
        return Table(path, text, 1, first, np.zeros((0, len(first))), np.arange(0))
    table = read_table(path, first, delimiter=",", skip=1, finite=False)
    if len(table.rows) != rows:
        raise LogError(path, f"must have {rows} rows as {HEADER} says, but has {len(table.rows)}: truncated?")
    if not text.endswith("\n"):
        raise table.fail(rows - 1, "the line must have an end, but has none: cut inside a number?")
    return table


def _require(table: Table, good: NDArray[np.bool_], message: str) -> None:
    if not good.all():
        raise table.fail(int(np.argmin(good)), message)
