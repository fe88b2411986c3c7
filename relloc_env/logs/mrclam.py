"""Reader of MR.CLAM folders (UTIAS Multi-Robot Cooperative Localization and Mapping, Leung et al., IJRR 2011).

Bearings alone are taken from the camera: x = -tan(bearing), no image height. The range is kept for scores.
"""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np

from relloc_env.logs.errors import LogError
from relloc_env.logs.odometry import dead_reckon, fill_times, mean_velocity, smooth_poses
from relloc_env.logs.source import Log, Truth, perfect_network
from relloc_env.logs.tables import check_order, line_of_row, read_table, read_text
from relloc_env.samples import Float, Prior, Samples, ordered_pairs

Velocity = Literal["commands", "mocap"]

COLUMNS = {
    "Odometry": ("time", "v", "w"),
    "Measurement": ("time", "barcode", "range", "bearing"),
    "Groundtruth": ("time", "x", "y", "theta"),
}
UNKNOWN_BARCODES = 0.05
"""Largest part of a robot's detections whose barcode is not listed: the camera misreads some, a wrong file many."""


@dataclass(frozen=True)
class CommandModel:
    """How a robot follows the logged commands (v, w).

    The robot moves with w(t) = turn_scale w_c, v(t) = speed_scale v_c - turn_loss |w_c|, l(t) = axle w(t), where the
    commands c are those of `lag` seconds ago.
    """

    lag: float = 0.2
    """[s] between a command and the motion."""
    speed_scale: float = 1.0
    turn_scale: float = 1.0
    turn_loss: float = 0.0
    """[m/rad] forward speed lost in a turn."""
    axle: float = 0.0
    """[m] of the camera's (and the truth's) reference point before the wheels' axle."""

    def velocity(self, commands: Float) -> Float:
        """Velocities (T, 3) of the robot for commands (T, 2)."""
        w = self.turn_scale * commands[:, 1]
        v = self.speed_scale * commands[:, 0] - self.turn_loss * np.abs(commands[:, 1])
        return np.column_stack([v, self.axle * w, w])


@dataclass(frozen=True)
class RobotTables:
    """The files of one robot."""

    odometry: Float
    measurement: Float
    """(F, 4) time, index of the landmark (in `MrclamFolder.landmarks`), range, bearing. Other robots are left out."""
    truth: Float | None
    misread: int
    """Detections whose barcode is not listed."""


@dataclass(frozen=True)
class MrclamFolder:
    """A data set, read and checked."""

    path: Path
    start: float
    """[s] time stamp of its first command, the zero of the replay's time."""
    landmarks: tuple[int, ...]
    positions: Float
    robots: dict[int, RobotTables]

    def pairs(self) -> list[tuple[int, int]]:
        """Return all unordered pairs of robots."""
        return list(combinations(sorted(self.robots), 2))

    def log(
        self,
        robots: Sequence[int],
        *,
        velocity: Velocity = "commands",
        command_model: CommandModel | dict[int, CommandModel] | None = None,
        start: float | None = None,
        stop: float | None = None,
        longest_step: float = 0.25,
        smoothing: float = 0.1,
    ) -> Log:
        """Return the run of `robots` as a source of observations.

        Args:
            robots: their numbers; one or more.
            velocity: "commands" as logged, or "mocap": the truth differentiated, said to be so in the log.
            command_model: how commands turn into motion, one for all or by robot; default: 0.2 s of lag.
            start, stop: [s] after the first command of the set; default all.
            longest_step: [s] camera gaps are filled with samples without sights so that no step is longer.
            smoothing: [s] standard deviation of the window over the truth ("mocap").
        """
        if velocity not in ("commands", "mocap"):
            raise ValueError(f'Argument `velocity` must be "commands" or "mocap", but is {velocity!r}')
        chosen = tuple(int(r) for r in robots)
        if not chosen or len(set(chosen)) != len(chosen) or not set(chosen) <= set(self.robots):
            raise ValueError(
                f"Argument `robots` must be distinct numbers of {sorted(self.robots)}, but is {list(robots)}"
            )
        tables = [self.robots[r] for r in chosen]
        frames = np.unique(np.concatenate([table.measurement[:, 0] for table in tables]))
        time = fill_times(frames, longest_step)
        period = np.diff(time, prepend=time[0])
        shape = (1, len(time), len(chosen))
        odometry = np.zeros((*shape, 3), dtype=np.float32)
        image = np.zeros((*shape, len(self.landmarks), 2), dtype=np.float32)
        seen = np.zeros((*shape, len(self.landmarks)), dtype=np.bool_)
        sensed = np.full((len(time), len(chosen), len(self.landmarks)), np.nan)
        poses = np.full((len(time), len(chosen), 3), np.nan)
        models = {}
        for i, (number, table) in enumerate(zip(chosen, tables, strict=True)):
            model = command_model.get(number) if isinstance(command_model, dict) else command_model
            models[number] = model or CommandModel()
            if table.truth is not None:
                poses[:, i] = _truth_at(table.truth, time)
            if velocity == "commands":
                moved = dead_reckon(
                    table.odometry[:, 0] + models[number].lag, models[number].velocity(table.odometry[:, 1:]), time
                )
            elif table.truth is None:
                raise ValueError(f'Argument `velocity` must be "commands": {self.path} has no truth of robot {number}')
            else:
                moved = smooth_poses(table.truth[:, 0], table.truth[:, 1:], time, smoothing)
            odometry[0, :, i] = mean_velocity(moved, period)
            k = np.searchsorted(time, table.measurement[:, 0])
            m = table.measurement[:, 1].astype(np.int64)
            bearing = table.measurement[:, 3]
            image[0, k, i, m, 0], image[0, k, i, m, 1] = -np.tan(bearing), np.nan
            seen[0, k, i, m] = True
            sensed[k, i, m] = table.measurement[:, 2] * np.cos(bearing)
        log = Log(
            name=f"{self.path.name}, robots {' and '.join(map(str, chosen))}",
            kind="mrclam",
            robots=tuple(f"robot_{r}" for r in chosen),
            points=tuple(f"landmark_{number}" for number in self.landmarks),
            samples=Samples(period[None], odometry, image, seen, perfect_network(len(time), len(chosen))),
            prior=_prior(len(chosen), len(self.landmarks)),
            truth=Truth(poses, self.positions, sensed) if np.isfinite(poses).any() else None,
            velocity=velocity,
            start=float(time[0] - self.start),
            configuration={
                "robots": list(chosen),
                "velocity": velocity,
                "command_model": {str(r): asdict(m) for r, m in models.items()} if velocity == "commands" else None,
                "longest_step": longest_step,
                "misread_barcodes": sum(table.misread for table in tables),
            },
        )
        return log.cut(start, stop)


def _prior(robots: int, points: int) -> Prior:
    """Guesses that use no truth: a depth of 3 ± 2 m; the other robot anywhere within about 4 m, any heading."""
    pairs = len(ordered_pairs(robots))
    sd = np.array([4.0, 4.0, np.pi / np.sqrt(3.0)])
    return Prior(np.full((1, robots, points), 3.0), np.zeros((1, pairs, 3)), 2.0, sd)


def _truth_at(truth: Float, time: Float, gap: float = 0.5) -> Float:
    """Poses (K, 3) at `time` by linear interpolation; NaN outside the record and in gaps longer than `gap` [s]."""
    heading = np.unwrap(truth[:, 3])
    poses = np.column_stack([np.interp(time, truth[:, 0], column) for column in (truth[:, 1], truth[:, 2], heading)])
    after = np.searchsorted(truth[:, 0], time).clip(1, len(truth) - 1)
    far = truth[after, 0] - truth[after - 1, 0] > gap
    poses[far | (time < truth[0, 0]) | (time > truth[-1, 0])] = np.nan
    return poses


def _robot_table(path: Path, kind: str) -> tuple[Float, str]:
    """Read one `RobotN_<kind>.dat`, refusing another kind of file under its name."""
    text = read_text(path)
    head = re.search(r"^#\s*(?:Robot\s+)?(Odometry|Measurement|Groundtruth)\b", text, re.MULTILINE)
    if head is not None and head.group(1) != kind:
        line = text[: head.start()].count("\n") + 1
        raise LogError(path, f"must hold {kind} data, but its header says {head.group(1)}", line)
    table, text = read_table(path, COLUMNS[kind])
    check_order(path, text, table[:, 0])
    return table, text


def _read_robot(folder: Path, number: int, subjects: dict[int, int], index: dict[int, int]) -> RobotTables:
    odometry, text = _robot_table(folder / f"Robot{number}_Odometry.dat", "Odometry")
    path = folder / f"Robot{number}_Measurement.dat"
    measurement, text = _robot_table(path, "Measurement")
    wrong = (measurement[:, 1] != np.rint(measurement[:, 1])) | (measurement[:, 1] < 0)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            path, f"`barcode` must be a whole number, but is {measurement[row, 1]:g}", line_of_row(text, row)
        )
    wrong = (np.abs(measurement[:, 3]) >= 0.5 * np.pi) | (measurement[:, 2] <= 0.0)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            path,
            "must have a positive range and a bearing within ±π/2, but has "
            f"{measurement[row, 2]:g} m and {measurement[row, 3]:g} rad",
            line_of_row(text, row),
        )
    subject = np.array([subjects.get(int(code), -1) for code in measurement[:, 1]])
    misread = subject < 0
    if misread.mean() > UNKNOWN_BARCODES:
        row = int(misread.argmax())
        raise LogError(
            path,
            f"barcode {measurement[row, 1]:g} (like {100 * misread.mean():.0f} % of the detections) must be listed in "
            "Barcodes.dat, but is not",
            line_of_row(text, row),
        )
    late, early = measurement[-1, 0] - odometry[-1, 0], odometry[0, 0] - measurement[0, 0]
    if max(late, early) > 30.0:
        raise LogError(
            folder / f"Robot{number}_Odometry.dat",
            f"must cover the times of {path.name}, but {'ends' if late > early else 'begins'} "
            f"{max(late, early):.0f} s too {'early' if late > early else 'late'}: truncated, or of another set?",
        )
    landmark = np.array([index.get(s, -1) for s in subject])
    kept = landmark >= 0
    if not kept.any():
        raise LogError(path, "holds no detection of a landmark")
    detections = np.column_stack([measurement[kept, 0], landmark[kept], measurement[kept, 2:]])
    truth_path = folder / f"Robot{number}_Groundtruth.dat"
    truth = _robot_table(truth_path, "Groundtruth")[0] if truth_path.exists() else None
    return RobotTables(odometry, detections, truth, int(misread.sum()))


def read_mrclam(path: str | Path, robots: Sequence[int] | None = None) -> MrclamFolder:
    """Read and check an `MRCLAM_DatasetN` folder as published.

    Args:
        path: the folder.
        robots: read these alone (default: all there are).

    Raises:
        LogError: naming file and line, for files that are missing, empty, malformed, unsorted, or mixed up.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise LogError(folder, "must be a folder with RobotN_Odometry.dat and its like")
    found = sorted(int(p.name[5:-13]) for p in folder.glob("Robot*_Odometry.dat") if p.name[5:-13].isdigit())
    if not found:
        raise LogError(folder, "holds no RobotN_Odometry.dat")
    wanted = found if robots is None else [int(r) for r in robots]
    if not set(wanted) <= set(found):
        raise ValueError(f"Argument `robots` must be of {found}, but is {wanted}")
    barcodes, text = read_table(folder / "Barcodes.dat", ("subject", "barcode"))
    subjects: dict[int, int] = {}
    for row, (subject, code) in enumerate(barcodes):
        if int(code) in subjects:
            raise LogError(folder / "Barcodes.dat", f"barcode {code:g} is listed twice", line_of_row(text, row))
        subjects[int(code)] = int(subject)
    marks, _ = read_table(folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "sd_x", "sd_y"))
    landmarks = tuple(int(s) for s in marks[:, 0])
    positions = np.column_stack([marks[:, 1:3], np.full(len(marks), np.nan)])
    index = {subject: i for i, subject in enumerate(landmarks)}
    tables = {number: _read_robot(folder, number, subjects, index) for number in wanted}
    first = min(_first_time(folder / f"Robot{number}_Odometry.dat") for number in found)
    return MrclamFolder(folder, first, landmarks, positions, tables)


def _first_time(path: Path) -> float:
    """Time stamp of a file's first row."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            if line.strip() and not line.startswith("#"):
                try:
                    return float(line.split()[0])
                except ValueError:
                    raise LogError(path, f"`time` must be a number, but is {line.split()[0]!r}", number) from None
    raise LogError(path, "holds no data, only comments")
