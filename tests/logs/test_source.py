from pathlib import Path

import numpy as np
import pytest

from relloc_env.kernels.motion import relative
from relloc_env.logs import Log, Truth, read_mrclam
from relloc_env.logs.odometry import fill_times, smooth_poses


def test_relative_truth_is_that_of_the_kernel() -> None:
    rng = np.random.default_rng(1)
    poses = rng.uniform(-4.0, 4.0, (50, 3, 3))
    truth = Truth(poses, np.zeros((1, 3)))
    pairs = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]
    for t in range(50):
        for p, (a, b) in enumerate(pairs):
            assert truth.relative[t, p] == pytest.approx(relative(*poses[t, a], *poses[t, b]), abs=1e-12)


def test_blocks_join_to_the_whole(mrclam: Path) -> None:
    log = read_mrclam(mrclam).log((1, 2))
    for size in (1, 7, 1000):
        parts = list(log.blocks(size))
        for name, whole in log.samples._asdict().items():
            pieces = [getattr(part, name) for part in parts]
            assert np.concatenate(pieces, axis=1).tobytes() == whole.tobytes()
            assert all(piece.flags.c_contiguous for piece in pieces)


def test_initial_errors_are_what_was_asked_for(mrclam: Path) -> None:
    log = read_mrclam(mrclam).log((1, 2)).with_initial_error(depth=1.0, pose=(1.5, -1.5, 1.0))
    truth = log.truth
    assert truth is not None
    first = log.first_sight()
    for r in range(2):
        for m in range(3):
            assert log.samples.seen[0, first[r, m], r, m]
            assert not log.samples.seen[0, : first[r, m], r, m].any()
            assert log.prior.depth[0, r, m] == pytest.approx(truth.depth[first[r, m], r, m] + 1.0)
    np.testing.assert_allclose(log.prior.pose[0] - truth.relative[0], [[1.5, -1.5, 1.0]] * 2)
    assert log.prior.depth_sd == 1.0
    assert log.prior.pose_sd.tolist() == [1.5, 1.5, 1.0]


def test_no_initial_error_without_truth(mrclam: Path) -> None:
    log = read_mrclam(mrclam).log((1, 2))
    bare = Log(**{**{name: getattr(log, name) for name in log.__dataclass_fields__}, "truth": None})
    with pytest.raises(ValueError, match="without truth"):
        bare.with_initial_error(depth=1.0)


def test_times_are_filled_evenly() -> None:
    frames = np.array([0.0, 0.1, 1.1, 1.2])
    time = fill_times(frames, 0.25)
    np.testing.assert_allclose(time, [0.0, 0.1, 0.35, 0.6, 0.85, 1.1, 1.2])
    assert set(frames) <= set(time)


def test_smoothing_keeps_steady_motion_and_takes_out_noise() -> None:
    rng = np.random.default_rng(2)
    time = np.sort(rng.uniform(0.0, 20.0, 1300))
    line = np.column_stack([0.2 * time, -0.1 * time, 2.0 + 0.5 * time])
    wrapped = line.copy()
    wrapped[:, 2] = np.mod(wrapped[:, 2] + np.pi, 2 * np.pi) - np.pi
    at = np.linspace(1.0, 19.0, 50)
    smooth = smooth_poses(time, wrapped, at, 0.1)
    truth = np.column_stack([0.2 * at, -0.1 * at, 2.0 + 0.5 * at])
    np.testing.assert_allclose(smooth - smooth[0], truth - truth[0], atol=2e-3)
    noisy = wrapped + 0.01 * rng.standard_normal(wrapped.shape)
    error = smooth_poses(time, noisy, at, 0.1) - truth
    raw = smooth_poses(time, noisy, at, 0.0) - truth
    error[:, 2] -= np.round(error[:, 2].mean() / (2 * np.pi)) * 2 * np.pi
    raw[:, 2] -= np.round(raw[:, 2].mean() / (2 * np.pi)) * 2 * np.pi
    assert error.std() < 0.5 * raw.std()
