"""The files of an MR.CLAM folder, read and checked one by one."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from relloc_env.logs.checks import LIMITS, Kind, Limits, contradiction, contradictions
from relloc_env.logs.errors import LogError
from relloc_env.logs.tables import Table, read_table
from relloc_env.logs.text import read_text, stored
from relloc_env.samples import Float

COLUMNS: dict[str, dict[str, Kind]] = {
    "Odometry": {"time": "stamp", "v": "speed", "w": "turn"},
    # A camera that sees nothing is silent.
    "Measurement": {"time": "moment", "barcode": "number", "range": "number", "bearing": "number"},
    "Groundtruth": {"time": "stamp", "x": "place", "y": "place", "theta": "number"},
}
UNKNOWN_BARCODES = 0.05
"""Largest part of a robot's detections whose barcode is not listed: the camera misreads some, a wrong file many."""


@dataclass(frozen=True)
class RobotTables:
    """The files of one robot."""

    odometry: Float
    measurement: Float
    """(F, 4) time, index of the landmark (in `MrclamFolder.landmarks`), range, bearing. Other robots are left out."""
    truth: Float | None
    misread: int
    """Detections whose barcode is not listed."""
    warnings: list[str] = field(default_factory=list)


def numbers_of(folder: Path) -> list[int]:
    """Return the numbers of the robots of a folder, whichever of their files there are."""
    name = re.compile(r"Robot(\d{1,9})_(?:Odometry|Measurement|Groundtruth)\.dat(?:\.gz)?")
    found = (name.fullmatch(path.name) for path in folder.glob("Robot*_*.dat*"))
    return sorted({int(match.group(1)) for match in found if match is not None})


def robot_table(folder: Path, number: int, kind: str, limits: Limits = LIMITS) -> Table:
    """Read `RobotN_<kind>.dat`, refusing another kind of file under its name."""
    path = folder / f"Robot{number}_{kind}.dat"
    text, path = read_text(path), stored(path)
    head = re.search(r"^#\s*(?:Robot\s+)?(Odometry|Measurement|Groundtruth)\b", text, re.MULTILINE)
    if head is not None and head.group(1) != kind:
        line = text[: head.start()].count("\n") + 1
        raise LogError(path, f"must hold {kind} data, but its header says {head.group(1)}", line)
    table = read_table(path, tuple(COLUMNS[kind]))
    table.check(COLUMNS[kind], limits)
    return table


def read_robot(
    folder: Path, number: int, subjects: dict[int, int], index: dict[int, int], limits: Limits = LIMITS
) -> RobotTables:
    """Read the files of one robot.

    Args:
        folder: of the set.
        number: of the robot.
        subjects: subject of each barcode.
        index: of each landmark's subject.
        limits: what is refused.
    """
    odometry = robot_table(folder, number, "Odometry", limits)
    table = robot_table(folder, number, "Measurement", limits)
    table.check_whole("barcode")
    measurement = table.rows
    wrong = (np.abs(measurement[:, 3]) >= 0.5 * np.pi) | ~(measurement[:, 2] > 0.0)
    if wrong.any():
        row = int(wrong.argmax())
        raise table.fail(
            row,
            "must have a positive range and a bearing within ±π/2, but has "
            f"{measurement[row, 2]:g} m and {measurement[row, 3]:g} rad",
        )
    subject = np.array([subjects.get(int(code), -1) for code in measurement[:, 1]])
    misread = subject < 0
    if misread.mean() > UNKNOWN_BARCODES:
        row = int(misread.argmax())
        raise table.fail(
            row,
            f"barcode {measurement[row, 1]:g} (like {100 * misread.mean():.0f} % of the detections) must be listed in "
            "Barcodes.dat, but is not",
        )
    _check_cover(odometry, table, limits)
    for row in (rows := contradictions(measurement[:, 0], measurement[:, 1], measurement[:, 3:]))[:1]:
        table.warn(contradiction(len(rows), f"barcode {measurement[row, 1]:g}"), row)
    landmark = np.array([index.get(s, -1) for s in subject])
    kept = landmark >= 0
    if not kept.any():
        raise LogError(table.path, "holds no detection of a landmark")
    detections = np.column_stack([measurement[kept, 0], landmark[kept], measurement[kept, 2:]])
    warnings, truth = odometry.warnings + table.warnings, None
    if stored(folder / f"Robot{number}_Groundtruth.dat").exists():
        truth = robot_table(folder, number, "Groundtruth", limits)
        warnings += truth.warnings
        if truth["time"][-1] < measurement[0, 0] or truth["time"][0] > measurement[-1, 0]:
            words = f"ends at {truth['time'][-1]:.3f}" if truth["time"][-1] < measurement[0, 0] else "begins too late"
            raise truth.fail(0, f"must cover the times of {table.path.name}, but {words}: is its clock another one?")
    return RobotTables(odometry.rows, detections, None if truth is None else truth.rows, int(misread.sum()), warnings)


def _check_cover(odometry: Table, table: Table, limits: Limits) -> None:
    """Raise where detections are far from the times of the odometry."""
    times, stamps = odometry["time"], table["time"]
    lonely = (stamps < times[0] - limits.uncovered) | (stamps > times[-1] + limits.uncovered)
    jump = np.flatnonzero(np.diff(stamps) > limits.gap)
    for before, after in ((int(k), int(k) + 1) for k in jump):
        if lonely[before] != lonely[after]:
            odd = before if lonely[before] else after
            raise table.fail(
                odd,
                f"time must be near those of the odometry ({times[0]:.3f} to {times[-1]:.3f}), but is "
                f"{stamps[odd]:.3f}: it jumps by {stamps[after] - stamps[before]:.2g} s; did the clock jump, or was it "
                "not set yet?",
            )
    late, early = stamps[-1] - times[-1], times[0] - stamps[0]
    if max(late, early) > limits.uncovered:
        raise LogError(
            odometry.path,
            f"must cover the times of {table.path.name}, but {'ends' if late > early else 'begins'} "
            f"{max(late, early):.0f} s too {'early' if late > early else 'late'}: truncated, or of another set?",
        )
