"""Films: one motion, or two side by side from the same start; and the recording of the first."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from agents.__main__ import app
from agents.film import film, scenes
from agents.registry import agent
from relloc_env.config import load_config
from tests.rendering.scenes import columns_of

pytest.importorskip("rerun")
from rerun.chunk import RrdReader

CONFIG = load_config(estimator="cascade", max_cycles=8)


def test_two_motions_start_alike_side_by_side(tmp_path: Path) -> None:
    motions = {"one": agent("edge"), "other": agent("stationary")}
    film(tmp_path / "two.gif", CONFIG, motions, seed=2, width=840, faster=4.0, rerun=tmp_path / "two.rrd")
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
            times |= {time.total_seconds() for time in columns_of(part)["episode"]}
    assert times == set(np.arange(0.0, 2.01, 0.25).tolist())


def _at(animation: Image.Image, frame: int) -> Image.Image:
    animation.seek(frame)
    return animation.convert("RGB")


def test_scenes_are_those_of_the_episode() -> None:
    seen = scenes(CONFIG, agent("stationary"), 3, "still")
    assert [scene.time for scene in seen] == pytest.approx(np.arange(0.0, 2.01, 0.25))
    assert {scene.title for scene in seen} == {"still"}
    assert all((scene.poses == seen[0].poses).all() for scene in seen)
    assert [len(scene.strips[0].time) for scene in seen] == list(range(1, 10))


@pytest.mark.parametrize("names", [(), ("edge", "arc", "circle")])
def test_one_motion_or_two(tmp_path: Path, names: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=f"`motions` must have one entry or two, but has {len(names)}"):
        film(tmp_path / "a.gif", CONFIG, {name: agent(name) for name in names}, seed=0)


def test_command_shows_a_policy_of_one_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each agent has the suite's options and those that it needs."""
    asked = []
    monkeypatch.setattr("agents.film.film", lambda _, configs, motions, **__: asked.append((configs, list(motions))))
    needed = {"learned:gains": {"action": "motion+gains"}}
    monkeypatch.setattr("agents.jobs.needs", lambda name: needed.get(name, {}))
    words = ["film", "--env", "relloc_env/ActiveDepth-v0", "--suite", "narrow-view", "--estimator", "cascade"]
    words += ["--set", "camera.kind=image", "--set", "targets=3"]
    words += ["--motion", "learned:gains", "--beside", "edge", "--out", str(tmp_path / "a.gif")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    ((configs, names),) = asked
    assert names == ["gains", "edge"]
    assert [(config.robots, config.action) for config in configs] == [(1, "motion+gains"), (1, "motion")]
    assert [np.degrees(2.0 * config.camera_of(0).half_view) for config in configs] == pytest.approx([40.0, 40.0])
    assert [(config.camera_of(0).kind, config.targets) for config in configs] == [("image", 3)] * 2


def test_command_tells_an_id_that_is_none(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["film", "--env", "ActiveDepth", "--out", str(tmp_path / "a.gif")])
    assert result.exit_code == 2
    assert "Argument `env` must be one of relloc_env/ActiveDepth-v0" in result.output
