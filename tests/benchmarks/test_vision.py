import json

import numpy as np

from benchmarks.vision import FALSE, play, run, tables
from benchmarks.vision_trials import CASES
from relloc_env.config import load_config


def test_small_run_holds_what_is_required(tmp_path) -> None:
    """One episode of each kind, 2 s of it, and two pictures of each hard case."""
    results = run(tmp_path, episodes=1, repetitions=1, pictures=2, actions=8, tell=lambda *_: None)
    assert json.loads((tmp_path / "vision.json").read_text("utf-8")) == results
    assert set(results["trials"]) == set(CASES)
    for name, row in results["runs"].items():
        found = row["detections"]
        assert found["false"] == 0, name
        assert found["median_px"] < 1.0
        assert found["error_95_px"] < 2.0 < FALSE
        assert found["found_of_visible"] > 0.9
    assert np.isfinite([case["found"] for case in results["trials"].values()]).all()
    assert [table.row_count for table in tables(results)] == [4, 16, len(CASES)]


def test_plays_to_the_end() -> None:
    """Every action of the episode counts, the last one too."""
    config = load_config(None, max_cycles=3)
    outcome = play(config, "straight", [1, 2], None, lambda *_: None)
    assert len(outcome.seen) == 3
    assert outcome.frames == 3 * config.samples_per_action * 2 * config.robots
