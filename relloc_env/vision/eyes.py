"""Cameras that take pictures, in place of analytic ones: what robots measure is what detectors find in them."""

import math
import warnings

import numpy as np

from relloc_env.config import EnvConfig
from relloc_env.kernels.streams import IMAGE, draw_u64
from relloc_env.kernels.world import Truth, World
from relloc_env.samples import Rows, Samples
from relloc_env.vision.checks import find
from relloc_env.vision.protocol import BUILT_IN, make_detector
from relloc_env.vision.sensor import Sensor
from relloc_env.vision.tracking import Tracks, assign, empty_tracks, predict


class Eyes:
    """The cameras of N environments whose configuration has pictures, with detectors and trackers.

    Attributes:
        robots: those whose cameras take pictures.
        tracks: what the trackers remember, live arrays.
    """

    def __init__(self, config: EnvConfig, num_envs: int, threads: int) -> None:
        self.config = config
        self.robots = [r for r in range(config.robots) if config.camera_of(r).kind == "image"]
        _warn_of_repeated_colours(config, self.robots)
        self.tracks: Tracks = empty_tracks(num_envs, config.robots, config.targets)
        self._sensors = [{r: Sensor(config, r) for r in self.robots} for _ in range(threads)]
        self._detectors = [{r: make_detector(config, r) for r in self.robots} for _ in range(threads)]
        self._own = [r for r in self.robots if config.detector_of(r) not in BUILT_IN]
        self._pictures = [
            {r: np.zeros((s.view.height, s.view.width, 3), np.uint8) for r, s in sensors.items()}
            for sensors in self._sensors
        ]

    def start(self, world: World, samples: Samples, truth: Truth, rows: Rows, thread: int = 0) -> None:
        """Take the first pictures of new episodes."""
        self.tracks.age[rows] = -1
        self.look(world, samples, truth, rows, thread)

    def look(self, world: World, samples: Samples, truth: Truth, rows: Rows, thread: int = 0) -> None:
        """Take a picture in each sample in which a frame is due, and write what is found over what is in `samples`.

        Args:
            world: after the last sample.
            samples: whose `image` and `seen` are written.
            truth: of the samples; its `visible` becomes what is found.
            rows: indices of the environments.
            thread: number of the calling thread.
        """
        block = samples.seen.shape[1]
        for n in rows.tolist():
            for k in range(block):
                tick = int(world.tick[n]) - block + 1 + k
                for r in self.robots:
                    self._sample(world, samples, truth, (n, k, r), tick, thread)

    def _sample(
        self, world: World, samples: Samples, truth: Truth, place: tuple[int, int, int], tick: int, thread: int
    ) -> None:
        """One sample of one robot."""
        n, k, r = place
        image, seen = samples.image[n, k, r], samples.seen[n, k, r]
        rays, age = self.tracks.rays[n, r], self.tracks.age[n, r]
        predict(rays, age, float(samples.odometry[place][2] * samples.period[n, k]))
        image[:], seen[:] = 0.0, False
        if self._due(tick, r):
            picture, sensor = self._pictures[thread][r], self._sensors[thread][r]
            seed = np.empty(1, np.uint64)
            draw_u64(world.streams, np.array([n]), IMAGE, seed)
            moment = np.s_[n : n + 1, k]
            sensor.take(picture[None], truth.pose[moment], truth.velocity[moment], world.points[n : n + 1], seed)
            detector = self._detectors[thread][r]
            found = find(detector, picture, sensor.view) if r in self._own else detector.detect(picture)
            places = sensor.view.rays(found.pixels)
            fits = found.fits & np.isfinite(places).all(axis=1, keepdims=True)  # of what the lens can show
            chosen = assign(rays, age, places, fits, found.score)
            hit = chosen >= 0
            seen[:] = hit
            image[hit] = places[chosen[hit]]
            rays[hit], age[hit] = places[chosen[hit]], 0
        truth.visible[place] = seen

    def _due(self, tick: int, robot: int) -> bool:
        """Whether a frame is taken: as `kernels.sensing.frame_due`."""
        frames = self.config.camera_of(robot).frame_rate
        rate = 1.0 if frames is None else frames / self.config.sample_rate
        return rate >= 1.0 or tick == 0 or math.floor(tick * rate + 1e-9) > math.floor((tick - 1) * rate + 1e-9)


def _warn_of_repeated_colours(config: EnvConfig, robots: list[int]) -> None:
    """Say so where two robots or more tell targets by colours that several targets have."""
    by_colour = [r for r in robots if config.detector_of(r) == "colour"]
    colours = [config.look.colour_of(m) for m in range(config.targets)]
    repeated = len(colours) - len(set(colours))
    if len(by_colour) > 1 and repeated and config.marker.kind == "sphere":
        warnings.warn(
            f"Of {len(colours)} targets, {repeated} have the colour of another: each robot numbers those of one colour "
            "from left to right as it first sees them, so robots may take one for another and estimates be wrong. Give "
            'each target a colour of its own in `marker.colours`, or use tags (`marker.kind="tag"`)',
            stacklevel=2,
        )
