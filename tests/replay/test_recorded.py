"""What the recorded sets must give (the sets' own data; skipped where they are not at hand)."""

from pathlib import Path

import numpy as np
import pytest

from relloc_env.logs import MrclamFolder, read_mrclam
from relloc_env.replay import replay, run_estimator, scores
from relloc_env.replay.settings import configure


@pytest.fixture(scope="module")
def mrclam(data_dir: Path) -> MrclamFolder:
    path = data_dir / "mrclam" / "MRCLAM_Dataset7"
    if not path.is_dir():
        pytest.skip(f"no {path}")
    return read_mrclam(path)


def test_starloc_depth_with_the_papers_gains_and_critically_damped(data_dir: Path) -> None:
    path = data_dir / "starloc" / "zigzag_s4"
    if not path.is_dir():
        pytest.skip(f"no {path}")
    data = replay(path, estimator=["cascade", "cascade-critical", "map-alignment"]).to_dict()["estimators"]
    paper, critical, joint = data["cascade"], data["cascade-critical"], data["map-alignment"]
    assert (paper["config"]["h"], paper["config"]["alpha_lambda"]) == (2.5, 120.0)
    assert (critical["config"]["damping"], critical["config"]["alpha_lambda"]) == ("critical", 120.0)
    assert paper["depth"]["tracks"] > 30
    assert paper["depth"]["median_initial_error_m"] == pytest.approx(1.0, abs=0.01)
    assert paper["depth"]["median_final_error_m"] <= 0.36
    assert critical["depth"]["median_final_error_m"] <= 0.25
    # The right camera, which knows nothing of the tags' positions, agrees.
    assert paper["depth"]["median_final_error_against_sensor_m"] <= 0.36
    assert critical["depth"]["median_final_error_against_sensor_m"] <= 0.25
    # Where the motion shows the depth, the joint map is the better one; it claims to know as many tracks or more.
    assert joint["depth"]["sure_tracks"] >= max(12, critical["depth"]["sure_tracks"])
    sure = "median_final_error_where_sure_m"
    assert joint["depth"][sure] < 0.5 * critical["depth"][sure]
    # Sizes of the errors in units of the claimed spread: the median of a normal one is 0.67.
    claimed = [abs(t["final_error_m"]) / t["final_sd_m"] for t in joint["logs"][0]["depth"]["per_track"]]
    assert 0.4 < np.median(claimed) < 1.3


def test_starloc_from_one_guess_without_truth(data_dir: Path) -> None:
    """3 ± 2 m for every track: what docs/recorded-data.md says, and the joint map twice as good as the observers."""
    path = data_dir / "starloc" / "zigzag_s4"
    if not path.is_dir():
        pytest.skip(f"no {path}")
    found = replay(path, estimator=["map-alignment", "cascade-critical"], initial_depth=(3.0, 2.0)).to_dict()
    joint, critical = (part["depth"]["median_final_error_m"] for part in found["estimators"].values())
    assert joint == pytest.approx(0.14, abs=0.02)
    assert critical == pytest.approx(0.30, abs=0.02)


def _medians(folder: MrclamFolder, velocity: str) -> tuple[float, float, float]:
    """Median errors [m, degrees] over the seconds of all ten pairs, and the part of the seconds with an estimate."""
    series = []
    pairs = folder.pairs()
    assert len(pairs) == 10
    for pair in pairs:
        log = folder.log(pair, velocity=velocity)  # type: ignore[arg-type]
        run = run_estimator(log, "map-alignment", configure(log, "map-alignment"))
        series += [scores.per_second(log.time, errors) for errors in run.poses]
    every = scores.join(series)
    part = len(every.position) / every.seconds_shared
    return float(np.median(every.position)), float(np.degrees(np.median(every.heading))), part


def test_mrclam_all_pairs_with_motion_capture(mrclam: MrclamFolder) -> None:
    position, heading, part = _medians(mrclam, "mocap")
    assert position <= 0.10
    assert heading <= 1.0
    assert part > 0.9


def test_mrclam_all_pairs_with_the_logged_commands(mrclam: MrclamFolder) -> None:
    position, heading, part = _medians(mrclam, "commands")
    assert position <= 0.5
    assert heading <= 6.0
    assert part >= 0.95


def test_mrclam_file_facts(mrclam: MrclamFolder) -> None:
    """Figures of the set that its authors' description and a count of its lines give."""
    assert len(mrclam.landmarks) == 15
    assert sorted(mrclam.robots) == [1, 2, 3, 4, 5]
    log = mrclam.log((2, 3), start=452.0, stop=479.0)
    together = log.samples.seen[0].any(axis=0).all(axis=0)
    assert {"landmark_7", "landmark_8"} <= {log.points[m] for m in np.flatnonzero(together)}
    assert log.truth is not None
    assert log.truth.sensed_depth is not None
    error = log.truth.sensed_depth - log.truth.depth
    assert np.nanmedian(np.abs(error)) < 0.2
