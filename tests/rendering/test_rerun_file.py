"""Recordings for Rerun read back by Rerun's own reader: what is where, when."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from relloc_env.play import Session
from relloc_env.rendering.geometry import axes, in_space
from relloc_env.rendering.rerun_file import RerunFile, recorder
from tests.rendering.scenes import columns_of, random_scene

chunk = pytest.importorskip("rerun.chunk")


def read(path: Path) -> dict[str, dict[float | None, dict[str, Any]]]:
    """Rows of each entity by their time [s]; those that are static have None."""
    rows: dict[str, dict[float | None, dict[str, Any]]] = {}
    for part in chunk.RrdReader(str(path)).stream():
        columns = columns_of(part)
        for k in range(part.num_rows):
            row = {name: value[k] for name, value in columns.items()}
            time = None if part.is_static else row["episode"].total_seconds()
            rows.setdefault(part.entity_path, {}).setdefault(time, {}).update(row)
    return rows


def test_a_recording_holds_the_scenes(tmp_path: Path) -> None:
    scenes = [random_scene(3, time=float(k)) for k in (1, 2, 4)]
    with RerunFile(tmp_path / "a.rrd", "edge law") as file:
        for scene in scenes:
            file.add(scene)
    rows = read(tmp_path / "a.rrd")
    for scene in scenes:
        for r, name in enumerate(("robot_a", "robot_b")):
            placed = rows[f"/world/{name}"][scene.time]
            assert placed["Transform3D:translation"][0] == pytest.approx([*scene.poses[r, :2], 0.0], rel=1e-6)
            for slug, strip in zip(("depth_error", "nees", "excitation"), scene.strips, strict=True):
                assert rows[f"/{slug}/{name}"][scene.time]["Scalars:scalars"] == [strip.lines[r, -1]]
            picture = rows[f"/world/{name}/camera/image"][scene.time]
            assert bytes(picture["EncodedImage:blob"][0])[:3] == b"\xff\xd8\xff"  # JPEG
            measured = rows[f"/world/{name}/camera/image/measured"][scene.time]["Points2D:positions"]
            u = 0.5 * (320.0 + 525.0 * scene.image[r, scene.seen[r], 0])  # kept at half the size
            assert [x for x, _ in measured] == pytest.approx(u, rel=1e-5)
        bound = scenes[-1].strips[0].bound
        assert bound is not None
        assert rows["/depth_error/bound"][4.0]["Scalars:scalars"] == [bound[-1]]
    points = rows["/world/points"][None]
    assert np.array(points["Points3D:positions"]) == pytest.approx(scenes[0].points, rel=1e-6)
    assert len(rows["/world/arena"][None]["LineStrips3D:strips"][0]) == 5
    assert len(rows["/world/obstacles/discs"][None]["Cylinders3D:radii"]) == 1
    assert rows["/world/obstacles/boxes"][None]["Boxes3D:half_sizes"][0] == pytest.approx([0.9, 0.3, 0.3])
    assert len(rows["/world/ways/robot_b"][None]["LineStrips3D:strips"][0]) == len(scenes[-1].trails[1])


def test_believed_places_and_regions(tmp_path: Path) -> None:
    scene = random_scene(5)
    with RerunFile(tmp_path / "a.rrd") as file:
        file.add(scene)
    rows = read(tmp_path / "a.rrd")
    assert scene.estimate is not None
    regions = rows["/world/robot_a/believed/points"][scene.time]
    for m, (beta, eta, rho) in enumerate(scene.estimate.points[0]):
        place = [np.cos(beta) / rho, np.sin(beta) / rho, scene.cameras[0].mount + eta / rho]
        assert regions["Ellipsoids3D:centers"][m] == pytest.approx(place, rel=1e-5)
        sd_along = np.sqrt(scene.estimate.points_covariance[0, m, 2, 2]) / rho**2
        assert max(regions["Ellipsoids3D:half_sizes"][m]) == pytest.approx(2.0 * sd_along, rel=0.02)
    other = rows["/world/robot_a/believed/robot_b"][scene.time]
    assert other["Transform3D:translation"][0] == pytest.approx([*scene.estimate.pose[0, :2], 0.0], rel=1e-5)
    area = np.prod(sorted(rows["/world/robot_a/believed/robot_b_region"][scene.time]["Ellipsoids3D:half_sizes"][0])[1:])
    assert area == pytest.approx(4.0 * np.sqrt(np.linalg.det(scene.estimate.pose_covariance[0, :2, :2])), rel=1e-4)


def test_frames_lead_from_the_world_into_the_pictures(tmp_path: Path) -> None:
    """Through the transforms in the file, targets come where its picture, taken by a camera, has their colour."""
    session = Session(camera="image", marker={"radius": 0.25}, estimator="cascade", seed=4, arena=(12.0, 12.0))
    session.step(np.array([[1.0, 0.3], [0.6, -0.5]]))
    scene = session.scene()
    with RerunFile(tmp_path / "a.rrd") as file:
        file.add(scene)
    rows, looked = read(tmp_path / "a.rrd"), 0
    world = np.array(rows["/world/points"][None]["Points3D:positions"])
    for r, name in enumerate(("robot_a", "robot_b")):
        body, camera = rows[f"/world/{name}"][scene.time], rows[f"/world/{name}/camera"][None]
        angle, lens = scene.poses[r, 2], rows[f"/world/{name}/camera/image"][None]
        assert body["Transform3D:rotation_axis_angle"][0]["angle"] == pytest.approx(angle, rel=1e-6)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        in_body = (world - body["Transform3D:translation"][0]) @ turn
        mat = np.array(camera["Transform3D:mat3x3"][0]).reshape(3, 3).T  # columns one after the other
        in_camera = (in_body - camera["Transform3D:translation"][0]) @ mat
        pixels = in_camera @ np.array(lens["Pinhole:image_from_camera"][0]).reshape(3, 3)
        pixels = pixels[:, :2] / pixels[:, 2:]
        jpeg = rows[f"/world/{name}/camera/image"][scene.time]["EncodedImage:blob"][0]
        picture = np.asarray(Image.open(io.BytesIO(bytes(jpeg))), float)
        for m in np.flatnonzero(scene.in_view[r]):
            x, y = pixels[m].astype(int)
            patch = picture[y - 9 : y + 10, x - 9 : x + 10].reshape(-1, 3)  # with a cross on it, where it was found
            hue, painted = patch - patch.mean(axis=1, keepdims=True), scene.colours[m] - scene.colours[m].mean()
            alike = hue @ painted > 0.5 * painted @ painted
            assert alike.mean() > 0.3
            looked += 1
    assert looked == 4


@pytest.mark.parametrize("seed", range(5))
def test_axes_and_turn_make_the_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(3, 3)) * [[1.0], [0.1], [2.0]]
    half, (x, y, z, w) = axes(factor @ factor.T)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert turn @ np.diag((half / 2.0) ** 2) @ turn.T == pytest.approx(factor @ factor.T)


def test_covariance_in_space_is_that_of_samples() -> None:
    rng = np.random.default_rng(0)
    point, sd = np.array([0.4, 0.2, 0.3]), np.array([0.01, 0.02, 0.004])
    place, covariance = in_space(point, np.diag(sd**2))
    beta, eta, rho = (point + sd * rng.normal(size=(200_000, 3))).T
    drawn = np.stack([np.cos(beta), np.sin(beta), eta]) / rho
    assert place == pytest.approx(drawn.mean(axis=1), abs=2e-3)
    assert np.cov(drawn) == pytest.approx(covariance, rel=0.02, abs=2e-5)


def test_every_start_has_a_file(tmp_path: Path) -> None:
    with recorder(tmp_path / "drive.rrd", every=0.5) as write:
        assert write is not None
        for time in (0.0, 0.25, 0.5, 0.0, 1.0):
            write(random_scene(0, time=time, trails=()))
    first, second = (read(tmp_path / name)["/world/robot_a"] for name in ("drive.rrd", "drive-2.rrd"))
    assert set(first) == {0.0, 0.5}
    assert set(second) == {0.0, 1.0}
    with recorder(None) as write:
        assert write is None


def test_a_wrong_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`path` must end in \.rrd"):
        RerunFile(tmp_path / "a.mcap")
