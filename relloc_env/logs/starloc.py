"""Reader of STAR-loc sequences (Dümbgen et al., arXiv:2309.05518): one camera on a cart, tags on the walls.

Pixels of the left camera are levelled by its fixed pitch and roll, so that the planar equations hold. There are no
wheel encoders: velocities come from the motion capture. The right camera gives a depth of its own, for scores.
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relloc_env.logs.checks import LIMITS, Limits, check_cells, check_samples, contradiction, contradictions
from relloc_env.logs.errors import LogError
from relloc_env.logs.odometry import count_times, fill_times, mean_velocity
from relloc_env.logs.source import Log, Truth, perfect_network
from relloc_env.logs.tables import Table, read_table
from relloc_env.logs.text import read_json, read_text, stored
from relloc_env.samples import Float, Prior, Samples

DETECTIONS = "apriltag_cal_individual.csv"
CAMERA_DELAY = 0.08
"""[s] of the images behind the motion capture: with it the image flow fits the turning of the camera best."""
POSE = ("cam_x", "cam_y", "cam_z", "cam_rot_x", "cam_rot_y", "cam_rot_z", "cam_w")
NEEDED = ("time_s", "apriltag_id", "left_u", "left_v", "right_u", "right_v", *POSE)


@dataclass(frozen=True)
class Track:
    """One uninterrupted run of sights of a tag."""

    tag: int
    rows: "np.ndarray[tuple[int], np.dtype[np.int64]]"
    """Rows of the detections."""


def _header(path: Path, needed: tuple[str, ...]) -> tuple[str, ...]:
    """Return the column names of a CSV file; raise where one of `needed` is missing."""
    try:
        names = tuple(name.strip() for name in next(csv.reader([read_text(path).splitlines()[0]])))
    except csv.Error as error:
        raise LogError(stored(path), f"is not CSV ({error})", 1) from None
    missing = [name for name in needed if name not in names]
    if missing:
        raise LogError(stored(path), f"must have the columns {', '.join(needed)}, but lacks {', '.join(missing)}", 1)
    return names


def _read_columns(path: Path, needed: tuple[str, ...]) -> Table:
    """Read a CSV file with a header line."""
    return read_table(path, _header(path, needed), delimiter=",", skip=1)


def _calibration(path: Path) -> dict[str, float]:
    data = read_json(path)
    values = {}
    for name in ("fu", "fv", "cu", "cv", "b"):
        value = data.get(name) if isinstance(data, dict) else None
        low = 1.0 / LIMITS.distance if name in ("fu", "fv", "b") else -LIMITS.distance
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= LIMITS.distance:
            raise LogError(
                stored(path),
                f"`{name}` must be a finite number (focal lengths and baseline positive) of at most "
                f"{LIMITS.distance:g} in size, but is {value!r}",
            )
        values[name] = float(value)
    return values


def _environment(sequence: Path) -> Path:
    """Return the file of the tags' positions that belongs to a sequence."""
    folder = sequence.parent / "mocap"
    listing = sequence.parent / "dataset_params.json"
    if stored(listing).exists():
        entries = read_json(listing)
        for entry in entries if isinstance(entries, list) else []:
            if isinstance(entry, dict) and entry.get("name") == sequence.name and "landmarks" in entry:
                return folder / f"environment_{entry['landmarks']}.csv"
    found = sorted({path.with_name(path.name.removesuffix(".gz")) for path in folder.glob("environment_*.csv*")})
    if len(found) != 1:
        raise LogError(folder, f"must hold the tags' positions (one environment_*.csv), but holds {len(found)}")
    return found[0]


def camera_axes(quaternion: Float) -> Float:
    """Axes of the camera in the world, (…, 3, 3) with columns right, down, forward.

    The published quaternion (…, 4: x, y, z, w) turns the world into the camera; its conjugate is taken here.
    """
    x, y, z, w = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    x, y, z = -x, -y, -z
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def levelling(axes: Float) -> Float:
    """Rotation (3, 3) from the camera to a level camera with the same heading: the mean over the frames' axes."""
    forward = axes[:, :, 2]
    yaw = np.arctan2(forward[:, 1], forward[:, 0])
    cos, sin, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    level = np.stack(
        [np.stack([sin, -cos, zero], -1), np.stack([zero, zero, -one], -1), np.stack([cos, sin, zero], -1)], 1
    )
    u, _, vt = np.linalg.svd((level @ axes).mean(axis=0))
    mean: Float = u @ vt
    return mean


def split_tracks(time: Float, tag: Float, longest_gap: float, shortest: float) -> list[Track]:
    """Runs of sights of each tag without a gap over `longest_gap` [s], at least `shortest` [s] long, by first sight."""
    tracks: list[Track] = []
    for number in np.unique(tag):
        rows = np.flatnonzero(tag == number)
        parts = np.split(rows, np.flatnonzero(np.diff(time[rows]) > longest_gap) + 1)
        tracks += [Track(int(number), part) for part in parts if time[part[-1]] - time[part[0]] >= shortest]
    return sorted(tracks, key=lambda track: (track.rows[0], track.tag))


def read_starloc(
    path: str | Path,
    *,
    environment: str | Path | None = None,
    longest_gap: float = 1.5,
    shortest: float = 6.0,
    longest_step: float = 0.25,
    camera_delay: float = CAMERA_DELAY,
    limits: Limits = LIMITS,
) -> Log:
    """Read a STAR-loc sequence as published; each track is a point of its own. Any file may be compressed (`.gz`).

    Args:
        path: folder of the sequence, with apriltag_cal_individual.csv and calib.json.
        environment: file of the tags' positions; default: what ../dataset_params.json says, in ../mocap.
        longest_gap: [s] a tag that is out of view for longer begins a new track.
        shortest: [s] shorter tracks are left out.
        longest_step: [s] gaps between frames are filled with samples without sights so that no step is longer.
        camera_delay: [s] an image shows what was seen this long before its time stamp; poses and velocities are those
            of that moment.
        limits: what is refused.

    Raises:
        LogError: naming file and line, for files that are missing, empty, malformed, unsorted, or mixed up.
    """
    folder = Path(path)
    source = folder / DETECTIONS
    columns = _read_columns(source, NEEDED)
    columns.check({"time_s": "stamp", "cam_x": "place", "cam_y": "place", "cam_z": "place"}, limits)
    columns.check(dict.fromkeys(("left_u", "left_v", "right_u", "right_v", *POSE[3:]), "number"), limits)
    columns.check_whole("apriltag_id")
    stamp, tag = columns["time_s"], columns["apriltag_id"]
    calibration = _calibration(folder / "calib.json")
    places_path = _environment(folder) if environment is None else Path(environment)
    places = _read_columns(places_path, ("x", "y", "z", "april_id"))
    places.check({"x": "place", "y": "place", "z": "place"}, limits)
    places.check_whole("april_id")
    position = {int(a): (x, y, z) for a, x, y, z in zip(*(places[k] for k in ("april_id", "x", "y", "z")), strict=True)}
    unknown = [row for row, number in enumerate(tag) if int(number) not in position]
    if unknown:
        row = unknown[0]
        raise columns.fail(row, f"tag {tag[row]:g} must be listed in {places_path.name}, but is not")
    quaternion = np.column_stack([columns[name] for name in POSE[3:]])
    bad = np.flatnonzero(~(np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) <= 0.01))
    if bad.size:
        raise columns.fail(int(bad[0]), "the camera's quaternion must have length 1")
    disparity = columns["left_u"] - columns["right_u"]
    axes = camera_axes(quaternion)
    level = levelling(axes)
    rays = (
        np.column_stack(
            [
                (columns["left_u"] - calibration["cu"]) / calibration["fu"],
                (columns["left_v"] - calibration["cv"]) / calibration["fv"],
                np.ones(len(stamp)),
            ]
        )
        @ level.T
    )
    hidden = ~(rays[:, 2] > 0.0) | (np.abs(rays).max(axis=1) > limits.image * rays[:, 2])
    if hidden.any():
        row = int(hidden.argmax())
        raise columns.fail(
            row, "the pixels must lie before the camera, but are beside it or behind: are units mixed up?"
        )
    tracks = split_tracks(stamp, tag, longest_gap, shortest)
    if not tracks:
        raise LogError(source, f"holds no tag that is seen for {shortest:g} s without a gap of {longest_gap:g} s")

    for row in (twice := contradictions(stamp, tag, rays[:, :2] / rays[:, 2:]))[:1]:
        columns.warn(contradiction(len(twice), f"tag {tag[row]:g}"), row)
    frames, first = np.unique(stamp, return_index=True)
    if wrong := check_cells(count_times(frames, longest_step), 1, len(tracks), limits):
        raise LogError(columns.path, wrong)
    time = fill_times(frames, longest_step)
    period = np.diff(time, prepend=time[0])
    yaw = np.unwrap(np.arctan2(axes[first, 1, 2], axes[first, 0, 2]))
    planar = np.column_stack([columns["cam_x"][first], columns["cam_y"][first], yaw])
    poses = np.column_stack([np.interp(time - camera_delay, frames, planar[:, j]) for j in range(3)])
    count, points = len(time), len(tracks)
    image = np.zeros((1, count, 1, points, 2), dtype=np.float32)
    seen = np.zeros((1, count, 1, points), dtype=np.bool_)
    sensed = np.full((count, 1, points), np.nan)
    sample = np.searchsorted(time, stamp)
    with np.errstate(divide="ignore", over="ignore"):
        stereo = np.where(disparity > 0.0, calibration["fu"] * calibration["b"] / disparity * rays[:, 2], np.nan)
    stereo[~(stereo <= limits.distance)] = np.nan  # no depth can be told
    for m, track in enumerate(tracks):
        k = sample[track.rows]
        image[0, k, 0, m] = rays[track.rows, :2] / rays[track.rows, 2:]
        seen[0, k, 0, m] = True
        sensed[k, 0, m] = stereo[track.rows]
    samples = Samples(period[None], mean_velocity(poses, period)[None, :, None], image, seen, perfect_network(count, 1))
    names = tuple(f"tag_{t.tag} from {stamp[t.rows[0]] - stamp[0]:.1f} s" for t in tracks)
    odd = check_samples(
        samples, ("camera",), names, lambda k, words: LogError(columns.path, f"{time[k]:.3f} s: {words}"), limits
    )
    log = Log(
        name=folder.name,
        kind="starloc",
        robots=("camera",),
        points=names,
        samples=samples,
        prior=Prior(np.full((1, 1, points), 3.0), np.zeros((1, 0, 3)), 2.0, np.ones(3)),
        truth=Truth(poses[:, None], np.array([position[t.tag] for t in tracks]), sensed),
        velocity="mocap",
        configuration={
            "velocity": "mocap",
            "environment": places_path.name,
            "pitch_deg": math.degrees(math.asin(-level[1, 2])),
            "longest_gap": longest_gap,
            "shortest": shortest,
            "longest_step": longest_step,
            "camera_delay": camera_delay,
        },
        warnings=(*columns.warnings, *places.warnings, *odd),
    )
    return log.cut()
