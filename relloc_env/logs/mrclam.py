"""Reader of MR.CLAM folders (UTIAS Multi-Robot Cooperative Localization and Mapping, Leung et al., IJRR 2011).

Bearings alone are taken from the camera: x = -tan(bearing), no image height. The range is kept for scores.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np

from relloc_env.logs.checks import LIMITS, Limits, check_cells, check_samples
from relloc_env.logs.errors import LogError
from relloc_env.logs.mrclam_files import RobotTables, numbers_of, read_robot, robot_table
from relloc_env.logs.odometry import GRID, count_times, dead_reckon, fill_times, mean_velocity, smooth_poses
from relloc_env.logs.source import Log, Truth, perfect_network
from relloc_env.logs.tables import read_table
from relloc_env.samples import Float, Prior, Samples, ordered_pairs

Velocity = Literal["commands", "mocap"]

CLOCKS = 10.0
"""[s] records of robots that begin or end further apart are reported: one of the clocks may be off."""
ENDS = 2.0
"""[s] odometry that begins later or ends earlier than the log, by more than this, is reported."""


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
class MrclamFolder:
    """A data set, read and checked."""

    path: Path
    start: float
    """[s] time stamp of its first command, the zero of the replay's time."""
    landmarks: tuple[int, ...]
    positions: Float
    robots: dict[int, RobotTables]
    warnings: tuple[str, ...] = ()
    """What is odd about the folder, in words."""
    limits: Limits = LIMITS

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
        if not longest_step > 0.0:
            raise ValueError(f"Argument `longest_step` must be positive, but is {longest_step}")
        frames = np.unique(np.concatenate([table.measurement[:, 0] for table in tables]))
        warnings = self._check_times(chosen, frames, longest_step)
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
        samples = Samples(period[None], odometry, image, seen, perfect_network(len(time), len(chosen)))
        names, points = tuple(f"robot_{r}" for r in chosen), tuple(f"landmark_{number}" for number in self.landmarks)
        warnings += check_samples(
            samples, names, points, lambda k, words: LogError(self.path, f"{time[k]:.3f} s: {words}"), self.limits
        )
        log = Log(
            name=f"{self.path.name}, robots {' and '.join(map(str, chosen))}",
            kind="mrclam",
            robots=names,
            points=points,
            samples=samples,
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
            warnings=tuple(dict.fromkeys(warnings)),
        )
        return log.cut(start, stop)

    def _check_times(self, chosen: Sequence[int], frames: Float, longest_step: float) -> list[str]:
        """Raise where robots have no time in common, or too much of it; return what is odd, in words."""
        limits, times = self.limits, {r: self.robots[r].odometry[[0, -1], 0] for r in chosen}
        warnings = [*self.warnings, *(words for r in chosen for words in self.robots[r].warnings)]
        for which, part in enumerate(("begin", "end")):
            early, late = (f(chosen, key=lambda r: times[r][which]) for f in (min, max))
            apart = float(times[late][which] - times[early][which])
            if apart > CLOCKS:
                warnings.append(
                    f"the records of robots {early} and {late} {part} {apart:.0f} s apart "
                    f"({times[early][which]:.3f} and {times[late][which]:.3f}): are their clocks far apart?"
                )
        silent = float(np.maximum(0.0, max(t[0] for t in times.values()) - min(t[1] for t in times.values())))
        if silent > limits.gap:
            raise LogError(
                self.path,
                f"robots {', '.join(map(str, chosen))} must have recorded at the same time, but {silent:.2g} s lie "
                "between two of their records: are their clocks far apart?",
            )
        for r in chosen:
            late, early = times[r][0] - frames[0], frames[-1] - times[r][1]
            if late > ENDS:
                warnings.append(f"the odometry of robot {r} begins {late:.1f} s after the log: it stands until then")
            if early > ENDS:
                warnings.append(
                    f"the odometry of robot {r} ends {early:.1f} s before the log: its last command is held"
                )
        wrong = check_cells(count_times(frames, longest_step), len(chosen), len(self.landmarks), limits)
        tables = (self.robots[r].truth for r in chosen)
        longest = max((float(np.ptp(truth[:, 0])) for truth in tables if truth is not None), default=0.0)
        wrong = wrong or check_cells(longest / GRID, 1, 1, limits)
        if wrong:
            raise LogError(self.path, wrong)
        return warnings


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


def read_mrclam(path: str | Path, robots: Sequence[int] | None = None, limits: Limits = LIMITS) -> MrclamFolder:
    """Read and check an `MRCLAM_DatasetN` folder as published; any file may be compressed by gzip (`.dat.gz`).

    Args:
        path: the folder.
        robots: read these alone (default: all there are).
        limits: what is refused.

    Raises:
        LogError: naming file and line, for files that are missing, empty, malformed, unsorted, or mixed up.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise LogError(folder, "must be a folder with RobotN_Odometry.dat and its like")
    found = numbers_of(folder)
    if not found:
        raise LogError(folder, "holds no RobotN_Odometry.dat")
    wanted = found if robots is None else [int(r) for r in robots]
    if not set(wanted) <= set(found):
        raise ValueError(f"Argument `robots` must be of {found}, but is {wanted}")
    barcodes = read_table(folder / "Barcodes.dat", ("subject", "barcode"))
    barcodes.check_whole("subject")
    barcodes.check_whole("barcode")
    subjects: dict[int, int] = {}
    for row, (subject, code) in enumerate(barcodes.rows):
        if int(code) in subjects:
            raise barcodes.fail(row, f"barcode {code:g} is listed twice")
        subjects[int(code)] = int(subject)
    marks = read_table(folder / "Landmark_Groundtruth.dat", ("subject", "x", "y", "sd_x", "sd_y"))
    marks.check_whole("subject")
    marks.check({"x": "place", "y": "place"}, limits)
    landmarks = tuple(int(s) for s in marks["subject"])
    index: dict[int, int] = {}
    for row, number in enumerate(landmarks):
        if number in index:
            raise marks.fail(row, f"landmark {number} is listed twice")
        index[number] = row
    positions = np.column_stack([marks["x"], marks["y"], np.full(len(landmarks), np.nan)])
    warnings = barcodes.warnings + marks.warnings
    tables = {number: read_robot(folder, number, subjects, index, limits) for number in wanted}
    first = [float(table.odometry[0, 0]) for table in tables.values()]
    for number in sorted(set(found) - set(wanted)):
        try:
            first.append(float(robot_table(folder, number, "Odometry", limits)["time"][0]))
        except LogError as error:
            warnings.append(f"times count from the first command of the robots that are read: {error}")
    return MrclamFolder(folder, min(first), landmarks, positions, tables, tuple(warnings), limits)
