from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relloc_env.kernels.motion import advance
from relloc_env.logs import LogError, read_starloc
from relloc_env.logs.starloc import levelling, split_tracks

Edit = Callable[[Path, int, str], None]
DETECTIONS = "apriltag_cal_individual.csv"


def test_levelled_pixels_and_depths_fit_the_truth(starloc: Path) -> None:
    log = read_starloc(starloc, shortest=4.0)
    truth, s = log.truth, log.samples
    assert truth is not None
    assert log.velocity == "mocap"
    assert log.configuration["pitch_deg"] == pytest.approx(np.degrees(-0.25), abs=0.01)
    late = log.time > 1.0
    seen = s.seen[0, :, 0] & late[:, None]
    offset = truth.points[None, :, :2] - truth.poses[:, :1, :2]
    left = -np.sin(truth.poses[:, 0, 2, None]) * offset[..., 0] + np.cos(truth.poses[:, 0, 2, None]) * offset[..., 1]
    depth = truth.depth[:, 0]
    assert (depth[seen] > 0.0).all()
    np.testing.assert_allclose(s.image[0, :, 0, :, 0][seen], (-left / depth)[seen], atol=1e-3)
    np.testing.assert_allclose(s.image[0, :, 0, :, 1][seen], ((0.9 - truth.points[:, 2]) / depth)[seen], atol=1e-3)
    assert truth.sensed_depth is not None
    np.testing.assert_allclose(truth.sensed_depth[:, 0][seen], depth[seen], atol=5e-3)


def test_velocities_follow_the_camera(starloc: Path) -> None:
    log = read_starloc(starloc)
    assert log.truth is not None
    pose = tuple(log.truth.poses[0, 0])
    for k in range(1, len(log)):
        pose = advance(*pose, *(float(u) for u in log.samples.odometry[0, k, 0]), log.samples.period[0, k])
    assert pose == pytest.approx(tuple(log.truth.poses[-1, 0]), abs=1e-5)
    assert np.abs(log.samples.odometry[0, :, 0, 1]).max() > 1e-3


def test_tracks_split_at_gaps_and_short_ones_are_left_out(starloc: Path) -> None:
    assert len(read_starloc(starloc).points) == 3
    log = read_starloc(starloc, shortest=4.0)
    assert len(log.points) == 5
    assert sum("tag_14" in name for name in log.points) == 2
    assert len(read_starloc(starloc, longest_gap=2.5).points) == 4


def test_split_tracks_by_hand() -> None:
    time = np.array([0.0, 0.0, 1.0, 2.0, 5.0, 6.0, 6.5])
    tag = np.array([1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 2.0])
    tracks = split_tracks(time, tag, 1.5, 0.9)
    assert [(t.tag, t.rows.tolist()) for t in tracks] == [(1, [0, 2, 3]), (1, [4, 5])]


def test_levelling_takes_out_pitch_and_roll_and_leaves_the_heading() -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(3)
    tilt = Rotation.from_euler("xyz", [0.3, 0.0, 0.05]).as_matrix()
    yaw = rng.uniform(-3.0, 3.0, 20)
    level = np.stack([[[np.sin(a), 0.0, np.cos(a)], [-np.cos(a), 0.0, np.sin(a)], [0.0, -1.0, 0.0]] for a in yaw])
    found = levelling(level @ tilt)
    # A turn about the vertical (the image's y) is what the heading takes up.
    down = found.T @ np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(down, tilt.T @ np.array([0.0, 1.0, 0.0]), atol=1e-9)
    assert abs((found @ tilt.T)[0, 2]) < 0.05


@pytest.mark.parametrize(
    ("line", "text", "message"),
    [
        (1, "time_s,apriltag_id,left_u", r"csv, line 1: must have the columns .* lacks left_v"),
        (5, "1,2,3", r"csv, line 5: must have 13 columns .* but has 3"),
        (6, "0.1,11,a,0,0,0,0,0,0,0,0,0,1", r"csv, line 6: `left_u` must be a number, but is 'a'"),
        (6, "0.1,11,nan,0,0,0,0,0,0,0,0,0,1", r"csv, line 6: `left_u` must be finite"),
        (12, "-3,11,0,0,0,0,0,0,0,0,0,0,1", r"csv, line 12: time must not go back"),
        (3, "0.0,99,0,0,0,0,0,0,0,0,0,0,1", r"csv, line 3: tag 99 must be listed in environment_v1.csv"),
        (3, "0.0,11,0,0,0,0,0,0,0,0,0,0,0.5", r"csv, line 3: the camera's quaternion must have length 1"),
    ],
)
def test_a_wrong_line_is_named(starloc: Path, edit: Edit, line: int, text: str, message: str) -> None:
    edit(starloc / DETECTIONS, line, text)
    with pytest.raises(LogError, match=message):
        read_starloc(starloc)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("{", r"line 1: is not JSON"),
        ('{"fu": 1000}', "`fv` must be a finite number"),
        ('{"fu": -1, "fv": 1, "cu": 0, "cv": 0, "b": 0.1}', "`fu` must be .* but is -1"),
        ("[]", "`fu` must be"),
    ],
)
def test_a_wrong_calibration_is_named(starloc: Path, text: str, message: str) -> None:
    (starloc / "calib.json").write_text(text, "utf-8")
    with pytest.raises(LogError, match=rf"calib\.json.*{message}"):
        read_starloc(starloc)


def test_missing_and_mixed_up_files_are_named(starloc: Path) -> None:
    with pytest.raises(LogError, match="file not found"):
        read_starloc(starloc.parent)
    places = starloc.parent / "mocap" / "environment_v1.csv"
    kept = places.read_bytes()
    places.write_bytes((starloc / DETECTIONS).read_bytes())
    with pytest.raises(LogError, match=r"environment_v1\.csv, line 1: must have the columns x, y, z, april_id"):
        read_starloc(starloc)
    (starloc.parent / "mocap" / "environment_v2.csv").write_bytes(kept)
    with pytest.raises(LogError, match="must hold the tags' positions"):
        read_starloc(starloc)
    (starloc.parent / "dataset_params.json").write_text('[{"name": "wave_s1", "landmarks": "v2"}]', "utf-8")
    assert read_starloc(starloc).configuration["environment"] == "environment_v2.csv"


def test_no_track_is_an_error(starloc: Path) -> None:
    with pytest.raises(LogError, match="holds no tag that is seen for 60 s"):
        read_starloc(starloc, shortest=60.0)


def test_images_lag_behind_the_motion_capture(data_dir: Path) -> None:
    """The turn seen in the image between two frames fits the yaw of 0.08 s before best; no tag's position is used."""
    sequence = data_dir / "starloc" / "zigzag_s4"
    if not sequence.is_dir():
        pytest.skip(f"no {sequence}")
    log = read_starloc(sequence, camera_delay=0.0)
    assert log.truth is not None
    time, yaw = log.time, log.truth.poses[:, 0, 2]
    x, seen = log.samples.image[0, :, 0, :, 0].astype(float), log.samples.seen[0, :, 0]
    delays = np.arange(-0.04, 0.2, 0.02)
    spread = []
    for delay in delays:
        heading = np.interp(time - delay, time, yaw)
        rest = []
        for m in range(seen.shape[1]):
            at = np.flatnonzero(seen[:, m])
            a, b = at[:-1], at[1:]
            near = time[b] - time[a] < 0.3
            rest.append((heading[b] - heading[a] - np.arctan(x[b, m]) + np.arctan(x[a, m]))[near])
        every = np.concatenate(rest)
        spread.append(float(np.sqrt(np.mean(every[np.abs(every) < 0.1] ** 2))))
    assert delays[int(np.argmin(spread))] == pytest.approx(0.08, abs=0.021)
