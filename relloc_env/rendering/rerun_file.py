"""An episode as a file that the viewer of Rerun opens: scene after scene on one time line (needs the extra `rerun`)."""

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from relloc_env.extras import extra
from relloc_env.files import whole
from relloc_env.folders import open_file
from relloc_env.rendering.camera_view import ImageFrame, draw_camera
from relloc_env.rendering.canvas import Canvas
from relloc_env.rendering.geometry import SIGMAS, axes, in_space
from relloc_env.rendering.scene import Scene, robot_name
from relloc_env.rendering.theme import LIGHT
from relloc_env.samples import Float, ordered_pairs

TIMELINE = "episode"
"""Name of the time line, [s]."""
_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: right, down and ahead of a camera in the body, whose x is ahead and z up."""
_WIDEST = 320
"""[px] width of the pictures that are kept."""
_EYE = np.array([-0.9, -1.1, 1.1])
"""Where the viewer looks at the targets from, in distances of the farther robot from their middle."""
_FLAT = 0.01
"""[m] half height of regions in the plane."""


class RerunFile:
    """Writes scenes to a recording.

    `world/robot_a` is the true robot; below it, in its body frame, is what it believes (`points`, `robot_b`: 2 sigma
    ellipsoids of the covariances) and its `camera`. The numbers over time are `depth_error/robot_a` and so on.

    Args:
        path: file to write, .rrd.
        name: of the recording.
    """

    def __init__(self, path: str | Path, name: str = "episode") -> None:
        with extra("rerun"):
            import rerun

        self.path = Path(path)
        if self.path.suffix != ".rrd":
            raise ValueError(f"Argument `path` must end in .rrd, but is {str(path)!r}")
        self.path = open_file(self.path, "path")
        self._rr, self._started = rerun, False
        self._stream = rerun.RecordingStream("relloc_env")
        self._closing = ExitStack()
        self._stream.save(self._closing.enter_context(whole(self.path)))
        self._stream.send_recording_name(name)
        self._canvases: dict[tuple[int, int], Canvas] = {}
        self._last: Scene | None = None

    def add(self, scene: Scene) -> None:
        """Write a scene at its time."""
        if not self._started:
            self._begin(scene)
        self._stream.set_time(TIMELINE, duration=scene.time)
        for robot, pose in enumerate(scene.poses):
            self._log(_path(robot), self._transform(pose))
            self._camera(scene, robot)
        if scene.estimate is not None:
            self._beliefs(scene)
        for strip in scene.strips:
            if len(strip.time):
                for robot, line in enumerate(strip.lines):
                    self._number(f"{_slug(strip.label)}/{_robot(robot)}", line[-1])
                if strip.bound is not None:
                    self._number(f"{_slug(strip.label)}/bound", strip.bound[-1])
        self._last = scene

    def close(self) -> Path:
        """Finish the file, put it in its place and return its path."""
        if self._last is not None:
            for robot, trail in enumerate(self._last.trails):
                line = np.column_stack([trail, np.zeros(len(trail))])
                shape = self._rr.LineStrips3D([line], colors=[LIGHT.robot(robot)], radii=0.01)
                self._log(f"world/ways/{_robot(robot)}", shape, static=True)
        self._stream.flush()
        self._stream.disconnect()
        self._closing.close()
        return self.path

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _log(self, path: str, thing: Any, *, static: bool = False) -> None:
        self._stream.log(path, thing, static=static)

    def _number(self, path: str, value: float) -> None:
        if math.isfinite(value):
            self._log(path, self._rr.Scalars(float(value)))

    def _begin(self, scene: Scene) -> None:
        """Write what does not change, and how the viewer lays it out."""
        rr, self._started = self._rr, True
        self._stream.send_blueprint(_blueprint(scene))
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if scene.arena is not None:
            x_min, x_max, y_min, y_max = scene.arena
            corners = np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max], [x_min, y_min]])
            wall = np.column_stack([corners, np.zeros(5)])
            self._log("world/arena", rr.LineStrips3D([wall], colors=[LIGHT.edge], radii=0.03), static=True)
        self._obstacles(scene)
        labels = [str(m + 1) for m in range(len(scene.points))]
        points = rr.Points3D(scene.points, colors=scene.colours, radii=0.06, labels=labels)
        self._log("world/points", points, static=True)
        for robot, camera in enumerate(scene.cameras):
            body, colour = scene.robot_height, LIGHT.robot(robot)
            shape = rr.Cylinders3D(
                lengths=[body], radii=[scene.robot_radius], centers=[[0.0, 0.0, 0.5 * body]], colors=[colour],
                labels=[robot_name(robot)],
            )  # fmt: skip
            self._log(f"{_path(robot)}/body", shape, static=True)
            place = rr.Transform3D(translation=[0.0, 0.0, camera.mount], mat3x3=_CAMERA)
            self._log(f"{_path(robot)}/camera", place, static=True)
            share = self._share(scene, robot)
            lens = rr.Pinhole(
                focal_length=share * camera.focal, principal_point=[share * camera.c_x, share * camera.c_y],
                width=round(share * camera.width), height=round(share * camera.height),
                camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=0.6, color=colour,
            )  # fmt: skip
            self._log(f"{_path(robot)}/camera/image", lens, static=True)
        for strip in scene.strips:
            for robot in range(len(strip.lines)):
                line = rr.SeriesLines(colors=[LIGHT.robot(robot)], names=[robot_name(robot)], widths=[2.0])
                self._log(f"{_slug(strip.label)}/{_robot(robot)}", line, static=True)
            if strip.bound is not None:
                line = rr.SeriesLines(colors=[LIGHT.muted], names=["bound"], widths=[1.0])
                self._log(f"{_slug(strip.label)}/bound", line, static=True)

    def _obstacles(self, scene: Scene) -> None:
        rr = self._rr
        obstacles = np.zeros((0, 7)) if scene.obstacles is None else scene.obstacles
        discs, boxes = obstacles[obstacles[:, 0] == 0], obstacles[obstacles[:, 0] != 0]
        for name, some in (("discs", discs), ("boxes", boxes)):
            if not len(some):
                continue
            centres = np.column_stack([some[:, 1:3], 0.5 * some[:, 6]])
            if name == "discs":
                shape: Any = rr.Cylinders3D(
                    lengths=some[:, 6], radii=some[:, 3], centers=centres, colors=[LIGHT.obstacle]
                )
            else:
                turns = [rr.RotationAxisAngle([0.0, 0.0, 1.0], radians=float(angle)) for angle in some[:, 5]]
                half = np.column_stack([some[:, 3:5], 0.5 * some[:, 6]])
                shape = rr.Boxes3D(
                    half_sizes=half, centers=centres, rotation_axis_angles=turns, colors=[LIGHT.obstacle]
                )
            self._log(f"world/obstacles/{name}", shape, static=True)

    def _transform(self, pose: Float) -> Any:
        turn = self._rr.RotationAxisAngle([0.0, 0.0, 1.0], radians=float(pose[2]))
        return self._rr.Transform3D(translation=[pose[0], pose[1], 0.0], rotation=turn)

    def _share(self, scene: Scene, robot: int) -> float:
        """How much smaller than the camera's the kept pictures are."""
        return min(1.0, _WIDEST / scene.cameras[robot].width)

    def _camera(self, scene: Scene, robot: int) -> None:
        """Write what the camera shows, and where points were measured in it."""
        rr, camera, share = self._rr, scene.cameras[robot], self._share(scene, robot)
        path = f"{_path(robot)}/camera/image"
        self._log(path, rr.Image(self._picture(scene, robot, share)).compress(jpeg_quality=85))
        seen = np.flatnonzero(scene.seen[robot] & np.isfinite(scene.image[robot]).all(axis=1))
        centre = np.array([camera.c_x, camera.c_y])
        places = share * (centre + camera.focal * scene.image[robot, seen])
        self._log(f"{path}/measured", rr.Points2D(places, colors=scene.colours[seen], radii=3.0 * share))

    def _picture(self, scene: Scene, robot: int, share: float) -> NDArray[np.uint8]:
        """What the camera took, or a sketch of it, with what the robot believes, as in the pictures of environments."""
        camera = scene.cameras[robot]
        size = round(share * camera.width), round(share * camera.height)
        if size not in self._canvases:
            self._canvases[size] = Canvas(size)
        canvas = self._canvases[size]
        canvas.fill(LIGHT.page)
        draw_camera(
            canvas, ImageFrame((0.0, 0.0, float(size[0]), float(size[1])), camera), scene, robot, LIGHT, 0.8, 11.0
        )
        return canvas.finish()

    def _beliefs(self, scene: Scene) -> None:
        """Write each robot's points and the other robots' poses with their covariances."""
        rr, believed = self._rr, scene.estimate
        assert believed is not None
        for robot, camera in enumerate(scene.cameras):
            known = np.flatnonzero(believed.known[robot])
            places, covariances = [], []
            for m in known:
                place, covariance = in_space(believed.points[robot, m], believed.points_covariance[robot, m])
                places.append(place + np.array([0.0, 0.0, camera.mount]))
                covariances.append(covariance)
            path = f"{_path(robot)}/believed/points"
            self._log(path, self._regions(places, covariances, LIGHT.robot(robot)))
            self._log(f"{path}/places", rr.Points3D(places, colors=scene.colours[known], radii=0.03))
        for pair, (robot, other) in enumerate(ordered_pairs(len(scene.poses)).tolist()):
            mean, covariance = believed.pose[pair], np.zeros((3, 3))
            covariance[:2, :2], covariance[2, 2] = believed.pose_covariance[pair, :2, :2], (_FLAT / SIGMAS) ** 2
            path = f"{_path(robot)}/believed/{_robot(other)}"
            self._log(path, self._transform(mean))
            arrow = rr.Arrows3D(vectors=[[2.0 * scene.robot_radius, 0.0, 0.0]], colors=[LIGHT.robot(robot)])
            self._log(f"{path}/heading", arrow)
            region = self._regions([[mean[0], mean[1], 0.0]], [covariance], LIGHT.robot(robot))
            self._log(f"{path}_region", region)
            error = math.remainder(mean[2] - scene.poses[other, 2] + scene.poses[robot, 2], 2.0 * math.pi)
            self._number(f"heading_error/{_robot(robot)}", math.degrees(abs(error)))

    def _regions(self, places: list[Any], covariances: list[Float], colour: tuple[int, int, int]) -> Any:
        """2 sigma ellipsoids."""
        halves, turns = [], []
        for covariance in covariances:
            half, turn = axes(covariance)
            halves.append(half)
            turns.append(self._rr.Quaternion(xyzw=turn))
        return self._rr.Ellipsoids3D(
            centers=np.reshape(places, (-1, 3)), half_sizes=np.reshape(halves, (-1, 3)), quaternions=turns,
            colors=[colour] * len(places),
        )  # fmt: skip


@contextmanager
def recorder(path: str | Path | None, every: float = 0.25) -> Iterator[Callable[[Scene], None] | None]:
    """Yield what writes scenes to a file, or to several: a scene earlier than the one before it starts the next file.

    Args:
        path: of the first file; the others have `-2`, `-3`, … behind its name. None: nothing is written.
        every: [s] scenes nearer to the one before are left out.
    """
    if path is None:
        yield None
        return
    base = Path(path)
    files = [RerunFile(base)]
    last = -math.inf

    def write(scene: Scene) -> None:
        nonlocal last
        if scene.time < last:
            files[-1].close()
            files.append(RerunFile(base.with_stem(f"{base.stem}-{len(files) + 1}")))
            last = -math.inf
        if scene.time - last > every - 1e-6:
            files[-1].add(scene)
            last = scene.time

    try:
        yield write
    finally:
        files[-1].close()


def _blueprint(scene: Scene) -> Any:
    """The world at the left, cameras and numbers at the right."""
    with extra("rerun"):
        import rerun.blueprint as rrb

    labels = [strip.label for strip in scene.strips]
    cameras = [
        rrb.Spatial2DView(origin=f"{_path(robot)}/camera/image", name=f"camera {robot_name(robot)}")
        for robot in range(len(scene.cameras))
    ]
    numbers = [rrb.TimeSeriesView(origin=_slug(label), name=label) for label in labels]
    centre = np.append(scene.points[:, :2].mean(axis=0), 0.0)
    reach = float(np.hypot(*(scene.poses[:, :2] - centre[:2]).T).max())
    eye = rrb.EyeControls3D(position=centre + reach * _EYE, look_target=centre, eye_up=[0.0, 0.0, 1.0])
    world = rrb.Spatial3DView(origin="world", name="world", eye_controls=eye)
    right = rrb.Vertical(rrb.Horizontal(*cameras), *numbers, row_shares=[2.0] + [1.0] * len(numbers))
    return rrb.Blueprint(rrb.Horizontal(world, right, column_shares=[3.0, 2.0]), collapse_panels=True)


def _robot(robot: int) -> str:
    return f"robot_{robot_name(robot).lower()}"


def _path(robot: int) -> str:
    return f"world/{_robot(robot)}"


def _slug(label: str) -> str:
    """A label without its unit, as part of a path."""
    return label.partition(" [")[0].lower().replace(" ", "_")
