"""How often random places of robots and targets give the paper's times of convergence."""

from dataclasses import dataclass

import numpy as np

from relloc_env.config import load_config
from relloc_env.kernels._compile import plain
from relloc_env.kernels.camera import image_flow
from relloc_env.kernels.motion import arc
from relloc_env.paper.runs import CONVERGED, DURATION, EXPERIMENT, PAPER_GAINS
from relloc_env.samples import Bool, Float

PAPER_TIMES = (13.0, 25.0)
"""[s] after which the depths of robots A and B converge, as the paper prints."""
TIME_TOLERANCE = 1.5
"""[s] within which a time counts as the paper's."""

COUNT = 20_000
"""Geometries that are judged."""
DEPTH, APART, HEIGHT = (3.0, 10.0), 3.0, 2.5
"""[m] depths of the targets before A, greatest distance of B from A, greatest height of a target over or under the
cameras: all that is drawn is uniform within these, the view and all headings."""
DRAWN = 50_000
"""Targets that are drawn at a time; few stay in view."""
GUESSES = (1.0, -1.0)
"""[m] errors of the depth at the start, too far and too near: the paper prints no sign."""
STEP = 0.2
"""[s] of the integration (Runge-Kutta, fourth order)."""

Places = Float | tuple[Float, Float, Float]
"""[m] (3, ...) forward, left, and height over the camera, at the start."""


@dataclass(frozen=True)
class Geometries:
    """Times of convergence in geometries that keep both targets in the views of both robots for 40 s."""

    times: Float
    """[s] (2, N, 2, 2) for a guess too far and too near, geometry, robot, target; infinite for not within 40 s."""

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.times[0])

    def share(self, guess: int, *, later: bool = False) -> float:
        """Share of the geometries that give both robots their times."""
        return self.number(guess, later=later) / self.count

    def number(self, guess: int, *, later: bool = False) -> int:
        """How many give both robots their times.

        Args:
            guess: 0 for too far, 1 for too near.
            later: judge the later target of each robot, in place of both.
        """
        times = self.times[guess].max(axis=-1, keepdims=True) if later else self.times[guess]
        fits = np.abs(times - np.array(PAPER_TIMES)[:, None]) <= TIME_TOLERANCE
        return int(np.count_nonzero(fits.all(axis=(1, 2))))

    def share_of(self, robot: int) -> float:
        """Share of single targets that give the robot its time, guessed too far."""
        return float(np.mean(np.abs(self.times[0, :, robot] - PAPER_TIMES[robot]) <= TIME_TOLERANCE))


def study_geometries(count: int = COUNT, seed: int = 0) -> Geometries:
    """Draw geometries until `count` keep both targets in view, and see when the depths converge in each."""
    robots = places_in_view(count, seed)
    settled = [
        [settle(places, velocity, guess) for places, velocity in zip(robots, EXPERIMENT, strict=True)]
        for guess in GUESSES
    ]
    return Geometries(np.moveaxis(np.array(settled), 1, 2))


def places_in_view(count: int, seed: int) -> Float:
    """`Places` of two targets, as A and as B see them, (2, 3, `count`, 2), of geometries that stay in view for 40 s."""
    rng, kept = np.random.default_rng(seed), list[Float]()
    while sum(part.shape[2] for part in kept) < count:
        kept.append(_in_view(rng))
    return np.concatenate(kept, axis=2)[:, :, :count]


def _in_view(rng: np.random.Generator) -> Float:
    """The same of those that stay in view out of some that are drawn."""
    half = load_config("paper-experiment").camera_of(0).half_view
    depth, bearing, height = (rng.uniform(*ends, DRAWN) for ends in (DEPTH, (-half, half), (-HEIGHT, HEIGHT)))
    targets = depth, depth * np.tan(bearing), height
    seen = np.flatnonzero(_seen(targets, EXPERIMENT[0]))
    depth, left, height = (part[seen[: len(seen) // 2 * 2]].reshape(-1, 2) for part in targets)
    shape = (len(depth), 1)
    away, toward = APART * np.sqrt(rng.random(shape)), rng.uniform(-np.pi, np.pi, shape)
    east, north = depth - away * np.cos(toward), left - away * np.sin(toward)
    # Of all headings of B, those that have the first target in view.
    heading = np.arctan2(north[:, :1], east[:, :1]) + rng.uniform(-half, half, shape)
    cos, sin = np.cos(heading), np.sin(heading)
    of_b = cos * east + sin * north, cos * north - sin * east, height
    both = _seen(of_b, EXPERIMENT[1]).all(axis=1)
    return np.array([(depth, left, height), of_b])[:, :, both]


def _seen(places: Places, velocity: tuple[float, float]) -> Bool:
    """Whether targets stay in the view of the reproduced experiment's camera for 40 s."""
    camera = load_config("paper-experiment").camera_of(0)
    wide, high = (0.5 * size / camera.focal_length for size in (camera.width, camera.height))
    seen: Bool = np.ones(places[0].shape, np.bool_)
    for time in np.linspace(0.0, DURATION, 41):
        x, y, chi = image(places, velocity, time)
        seen &= (np.abs(x) < wide) & (np.abs(y) < high) & (chi > 0.0) & (chi < 1.0 / camera.near)
    return seen


def image(places: Places, velocity: tuple[float, float], time: float) -> tuple[Float, Float, Float]:
    """[-, -, 1/m] image points and inverse depths after the robot's exact arc."""
    chord_x, chord_y, turn = arc(velocity[0], 0.0, velocity[1], time)
    forward, left, height = places[0] - chord_x, places[1] - chord_y, places[2]
    ahead = np.cos(turn) * forward + np.sin(turn) * left
    aside = np.cos(turn) * left - np.sin(turn) * forward
    return -aside / ahead, -height / ahead, 1.0 / ahead


def settle(places: Places, velocity: tuple[float, float], guess: float) -> Float:
    """[s] when the depth observer's error is below 0.1 m for good; infinite where it is not within 40 s.

    Args:
        places: of the targets.
        velocity: [m/s, rad/s] of the robot.
        guess: [m] error of the depth at the start.
    """
    flow, (h, alpha_lambda), (v, w) = plain(image_flow), PAPER_GAINS, velocity

    def rate(seen: tuple[Float, Float, Float], state: Float) -> Float:
        (x, y, _), (x_hat, y_hat, chi_hat) = seen, state
        flow_x, flow_y, flow_chi = flow(x, y, chi_hat, v, 0.0, w)
        e_x, e_y = x - x_hat, y - y_hat
        return np.array([flow_x + h * e_x, flow_y + h * e_y, flow_chi + alpha_lambda * v * (x * e_x + y * e_y)])

    now = image(places, velocity, 0.0)
    state = np.array([now[0], now[1], 1.0 / (1.0 / now[2] + guess)])
    size, settled = np.full(now[0].shape, abs(guess)), np.full(now[0].shape, np.inf)
    for k in range(round(DURATION / STEP)):
        middle, after = (image(places, velocity, (k + part) * STEP) for part in (0.5, 1.0))
        first = rate(now, state)
        second = rate(middle, state + 0.5 * STEP * first)
        third = rate(middle, state + 0.5 * STEP * second)
        fourth = rate(after, state + STEP * third)
        state = state + STEP / 6.0 * (first + 2.0 * (second + third) + fourth)
        state[2] = np.clip(state[2], 0.01, 10.0)
        error = np.abs(1.0 / state[2] - 1.0 / after[2])
        crossed = (k + (size - CONVERGED) / np.where(size > error, size - error, 1.0)) * STEP
        settled = np.where(error >= CONVERGED, np.inf, np.where(size >= CONVERGED, crossed, settled))
        now, size = after, error
    return settled
