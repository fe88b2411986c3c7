"""Films: one motion, or two side by side from the same start; and the recording of the first."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from agents.film import film, scenes

pytest.importorskip("rerun")
from rerun.chunk import RrdReader


@pytest.fixture(autouse=True)
def short_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    import relloc_env

    whole = relloc_env.parallel_env
    monkeypatch.setattr(relloc_env, "parallel_env", lambda **options: whole(**options, max_cycles=8))


def test_two_motions_start_alike_side_by_side(tmp_path: Path) -> None:
    film(
        tmp_path / "two.gif", motion="edge", beside="stationary", names=("one", "other"), estimator="cascade", seed=2,
        width=840, faster=4.0, rerun=tmp_path / "two.rrd",
    )  # fmt: skip
    with Image.open(tmp_path / "two.gif") as animation:
        assert animation.size == (840, 437)
        assert animation.n_frames == 5  # actions 0, 2, 4, 6 and 8, the last one held
        first, last = (np.asarray(_at(animation, k)).astype(int) for k in (0, 4))
    # The strips and the title apart, both panels begin as the same picture.
    map_of = np.s_[40:270, 10:250]
    left, right = first[:, :420][map_of], first[:, 420:][map_of]
    assert np.abs(left - right).mean() < 0.5
    assert np.abs(last[:, :420][map_of] - last[:, 420:][map_of]).mean() > 0.5
    times = set()
    for part in RrdReader(str(tmp_path / "two.rrd")).stream():
        if part.entity_path == "/world/robot_a" and not part.is_static:
            times |= {time.total_seconds() for time in part.to_record_batch().to_pydict()["episode"]}
    assert times == set(np.arange(0.0, 2.01, 0.25).tolist())


def _at(animation: Image.Image, frame: int) -> Image.Image:
    animation.seek(frame)
    return animation.convert("RGB")


def test_scenes_are_those_of_the_episode() -> None:
    seen = scenes("stationary", "cascade", 3, "still")
    assert [scene.time for scene in seen] == pytest.approx(np.arange(0.0, 2.01, 0.25))
    assert {scene.title for scene in seen} == {"still"}
    assert all((scene.poses == seen[0].poses).all() for scene in seen)
    assert [len(scene.strips[0].time) for scene in seen] == list(range(1, 10))


def test_names_must_be_as_many_as_motions(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="`names` must have one for each of 1 motions, but has 2"):
        film(tmp_path / "a.gif", motion="edge", names=("a", "b"), estimator="cascade", seed=0, width=480, faster=4.0)
