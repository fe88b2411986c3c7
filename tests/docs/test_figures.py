"""The figures that explain the problem show what their words say."""

from pathlib import Path

import numpy as np
import pytest

from docs.figures import bound, motion, observer, pose
from relloc_env.metrics import convergence_time


@pytest.mark.parametrize(("name", "v", "w", "bearing"), motion.MOTIONS)
def test_only_driving_past_a_point_shows_how_far_it_is(name: str, v: float, w: float, bearing: float) -> None:
    images = motion.images(v, w, motion.candidates(bearing))
    apart = np.ptp(images, axis=1)
    assert apart[0] < 1e-12
    assert (apart.max() > 0.1) == (name == "drive past it")
    assert apart.max() < 1e-12 or name == "drive past it"


def test_the_observer_takes_the_times_of_the_equations() -> None:
    time, error = observer.errors()  # docs/equations.md, section 3: from +1 m to 0.1 m for good
    settled = convergence_time(time, np.abs(error).T, 0.1)
    assert settled[0] == np.inf
    assert settled[1:] == pytest.approx([3.75, 3.75, 1.85], abs=0.1)
    assert error[:, 0] == pytest.approx(np.ones(len(time)), abs=0.02)


def test_poses_on_the_circle_see_the_point_alike() -> None:
    (seen,) = {tuple(np.round(pose.seen_from(each, pose.POINTS[0]), 9)) for each in [pose.B, *pose.alike()]}
    assert np.hypot(*seen) == pytest.approx(np.hypot(*(pose.POINTS[0] - pose.B[:2])))


def test_each_figure_is_a_picture_and_the_same_each_time(tmp_path: Path) -> None:
    for draw in (motion.draw, pose.draw):
        draw(tmp_path / "one.svg")
        draw(tmp_path / "two.svg")
        assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


def test_standing_still_tells_least() -> None:
    still, feedback = (bound.play(name).information[-1] for name in ("stationary", "edge-two"))
    assert feedback > still + 2.0  # nats
