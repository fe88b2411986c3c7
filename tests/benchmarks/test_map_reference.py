"""The posterior of whole episodes: at the bound, which it gives by equations of its own, and consistent."""

import json
from pathlib import Path

import numpy as np
import pytest

gtsam = pytest.importorskip("gtsam")

from typer.testing import CliRunner  # noqa: E402

from benchmarks import map_graph, map_reference  # noqa: E402
from benchmarks.__main__ import app  # noqa: E402
from benchmarks.map_reference import NOISE, POINTS, simulate  # noqa: E402
from relloc_env.metrics import nees, relative_poses, whitened_error, wrap  # noqa: E402

LAST = 200
"""Samples, 10 s."""


def test_at_the_truth_the_graph_is_the_bound() -> None:
    """Two computations with nothing in common but the noise: elimination of a factor graph, and the kernels'."""
    drawn = simulate(1, 20.0, 1)
    episode = map_graph.Episode(drawn.samples, drawn.prior, 0, NOISE)
    for last in (0, 20, 100, 400):
        values = map_graph.place(drawn.poses[: last + 1], POINTS)
        found = map_graph.relative(episode.graph(last, map_graph.TIES[-1]), values, last, 0.0)
        np.testing.assert_allclose(found.pose, relative_poses(drawn.poses[last])[0], atol=1e-9)
        sd = np.sqrt(np.diag(drawn.bound[last]))
        np.testing.assert_allclose(found.covariance / np.outer(sd, sd), drawn.bound[last] / np.outer(sd, sd), atol=2e-3)


def test_the_posterior_is_at_the_bound_and_consistent_6_runs() -> None:
    """The sum of 18 squares is chi squared, 99.9 % within 4.4 and 45; the mean of 6 within 0.7 and 7.5."""
    drawn = simulate(6, LAST * 0.05, 2)
    poses, covariances = map_reference.posterior(drawn, [LAST], lambda *_: None)
    errors = poses[:, 0] - relative_poses(drawn.poses[LAST])[0]
    errors[..., 2] = wrap(errors[..., 2])
    assert 0.7 < nees(errors, covariances[:, 0]).mean() < 7.5
    assert whitened_error(errors, drawn.bound[LAST]) < 1.5


def test_the_optimum_fits_the_data_as_well_as_noise_allows_and_better_than_the_truth() -> None:
    """Twice the cost is chi squared: 8 numbers a sample and 7 guesses, less 9 unknown beside the odometry."""
    drawn = simulate(1, LAST * 0.05, 3)
    episode = map_graph.Episode(drawn.samples, drawn.prior, 0, NOISE)
    (found,) = episode.follow([LAST])
    freedom = 8 * (LAST + 1) + 7 - 9
    assert abs(2.0 * found.cost - freedom) < 4.0 * np.sqrt(2.0 * freedom)
    truth = map_graph.place(drawn.poses, POINTS)
    assert found.cost < episode.graph(LAST, map_graph.TIES[-1]).error(truth)


def test_missed_images_and_late_sights_are_borne() -> None:
    drawn = simulate(1, LAST * 0.05, 4)
    seen = np.random.default_rng(4).random(drawn.samples.seen.shape) < 0.5
    seen[:, :30, 0, 1] = seen[:, :10, 1, 0] = False
    (found,) = map_graph.Episode(drawn.samples._replace(seen=seen), drawn.prior, 0, NOISE).follow([LAST])
    error = found.pose - relative_poses(drawn.poses[LAST])[0]
    assert nees(error, found.covariance) < 20.0
    assert np.linalg.det(found.covariance) > np.linalg.det(drawn.bound[LAST])


def test_the_command_writes_and_shows_the_table(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["map-reference", "--runs", "2", "--seconds", "5", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "posterior" in done.output
    results = json.loads((tmp_path / "map-reference.json").read_text("utf-8"))
    assert results["times"] == [5.0]
    assert all(0.0 < results[name]["whitened"][0] < 3.0 for name in ("posterior", "map-alignment"))
