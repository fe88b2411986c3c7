import json

import numpy as np

from benchmarks.vision import FALSE, run, tables
from benchmarks.vision_trials import CASES


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
