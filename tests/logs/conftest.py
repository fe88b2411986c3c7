"""Small recordings with a known truth, written in the formats of the published sets."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

LANDMARKS = {6: (3.0, 1.0), 7: (4.0, -0.5), 8: (3.5, 2.0)}
BARCODES = {1: 5, 2: 14, 6: 63, 7: 81, 8: 7}
START = 1_000_000.0


def _write(path: Path, head: str, rows: list[str]) -> None:
    path.write_text("\n".join([f"# {head}", *rows]) + "\n", encoding="utf-8")


def write_mrclam(folder: Path, seconds: float = 20.0, noise: float = 0.0) -> Path:
    """Write two robots that drive arcs past three landmarks, with commands that act after 0.2 s."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(5)
    _write(folder / "Barcodes.dat", "Subject Barcode", [f"{s} {b}" for s, b in BARCODES.items()])
    _write(
        folder / "Landmark_Groundtruth.dat",
        "Subject x y sx sy",
        [f"{s} {x} {y} 0.0001 0.0001" for s, (x, y) in LANDMARKS.items()],
    )
    for robot, (y0, v, w) in {1: (0.0, 0.1, 0.02), 2: (-1.0, 0.08, -0.03)}.items():
        time = np.arange(0.0, seconds, 0.02)
        theta = w * time
        x, y = v / w * np.sin(theta), y0 + v / w * (1.0 - np.cos(theta))
        stamp = [f"{START + t:.3f}" for t in time]
        _write(
            folder / f"Robot{robot}_Groundtruth.dat",
            "Robot Groundtruth Data Format",
            [f"{s} {a:.9f} {b:.9f} {c:.9f}" for s, a, b, c in zip(stamp, x, y, theta, strict=True)],
        )
        _write(
            folder / f"Robot{robot}_Odometry.dat",
            "Odometry Data Format",
            [f"{START + t - 0.2:.3f} {v} {w}" for t in time],
        )
        rows = []
        for k in range(50 + robot, len(time), 12):
            for subject, (lx, ly) in LANDMARKS.items():
                d = np.array([lx - x[k], ly - y[k]])
                bearing = np.arctan2(d[1], d[0]) - theta[k] + noise * rng.standard_normal()
                if abs(bearing) < 1.2:
                    rows.append(f"{stamp[k]} {BARCODES[subject]} {np.hypot(*d):.6f} {bearing:.9f}")
            rows.append(f"{stamp[k]} {BARCODES[3 - robot]} 1.0 0.1")
        _write(folder / f"Robot{robot}_Measurement.dat", "Measurement Data Format", rows)
    return folder


def write_starloc(folder: Path, delay: float = 0.08) -> Path:
    """Write one camera, pitched down by 0.25 rad, that drives along a wave past four tags."""
    sequence = folder / "wave_s1"
    sequence.mkdir(parents=True)
    (folder / "mocap").mkdir()
    tags = {11: (4.0, 1.2, 1.4), 12: (4.5, -1.0, 0.3), 13: (5.0, 0.3, 1.8), 14: (3.5, -0.4, 0.1)}
    lines = [f"{i},{x},{y},{z},{tag}" for i, (tag, (x, y, z)) in enumerate(tags.items(), start=1)]
    (folder / "mocap" / "environment_v1.csv").write_text("\n".join(["id,x,y,z,april_id", *lines]) + "\n", "utf-8")
    (sequence / "calib.json").write_text('{"fu": 1000.0, "fv": 1000.0, "cu": 900.0, "cv": 500.0, "b": 0.12}', "utf-8")

    def axes(t: float) -> tuple[np.ndarray, np.ndarray]:
        yaw, pitch = 0.2 * np.sin(t), -0.25
        forward = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        place = np.array([0.1 * t, 0.05 * np.sin(0.5 * t), 0.9])
        return place, np.column_stack([right, np.cross(forward, right), forward])

    head = "time_s,apriltag_id,left_u,left_v,right_u,right_v,cam_x,cam_y,cam_z,cam_rot_x,cam_rot_y,cam_rot_z,cam_w"
    rows = [head]
    for t in np.arange(0.0, 12.0, 0.1):
        place, turned = axes(t)
        q = _quaternion(turned) * np.array([-1.0, -1.0, -1.0, 1.0])
        eye, seen = axes(t - delay)
        for tag, where in tags.items():
            if tag == 14 and 5.0 < t < 7.0:
                continue
            p = seen.T @ (np.array(where) - eye)
            u, v = 900.0 + 1000.0 * p[0] / p[2], 500.0 + 1000.0 * p[1] / p[2]
            cells = [t, tag, u, v, u - 120.0 / p[2], v, *place, *q]
            rows.append(",".join(f"{cell:.9f}" for cell in cells))
    (sequence / "apriltag_cal_individual.csv").write_text("\n".join(rows) + "\n", "utf-8")
    return sequence


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.array(Rotation.from_matrix(matrix).as_quat())


@pytest.fixture
def mrclam(tmp_path: Path) -> Path:
    return write_mrclam(tmp_path / "MRCLAM_Dataset0")


@pytest.fixture
def long_mrclam(tmp_path: Path) -> Path:
    return write_mrclam(tmp_path / "MRCLAM_Dataset00", seconds=60.0)


@pytest.fixture
def starloc(tmp_path: Path) -> Path:
    return write_starloc(tmp_path)


@pytest.fixture
def edit() -> Callable[[Path, int, str], None]:
    """Replace one line (from 1) of a file."""

    def replace(path: Path, line: int, text: str) -> None:
        lines = path.read_text("utf-8").splitlines()
        lines[line - 1] = text
        path.write_text("\n".join(lines) + "\n", "utf-8")

    return replace
