"""An estimator of the user's own: taken at every door, as an object, a factory, or the place of one."""

import functools
import json
import pickle
import re
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import relloc_env
from relloc_env.config import ConfigError, load_config
from relloc_env.envs.sb3 import RellocVecEnv
from relloc_env.envs.vector import RellocVectorEnv
from relloc_env.estimators import OwnConfig, make, resolve
from relloc_env.places import load
from relloc_env.replay import replay
from relloc_env.samples import Estimate, Prior, Rows, Samples
from relloc_env.wrappers import EstimateObservation, RecordLog

ID = "relloc_env/RelativePose-v0"


class Ahead:
    """Believes that every point it saw is 4 m straight ahead, and the first guess of the pose for ever."""

    def __init__(self, num_envs: int, robots: int, points: int, *, message_window: int = 1) -> None:
        n, r, m, p = num_envs, robots, points, robots * (robots - 1)
        self.window, self.rows_seen = message_window, [0]
        self.estimate = Estimate(
            np.tile([0.0, 0.0, 0.25], (n, r, m, 1)),
            np.tile(0.01 * np.eye(3), (n, r, m, 1, 1)),
            np.zeros((n, r, m), np.bool_),
            np.zeros((n, p, 3)),
            np.tile(np.eye(3), (n, p, 1, 1)),
        )

    def reset(self, prior: Prior, rows: Rows) -> None:
        self.estimate.known[rows] = False
        self.estimate.pose[rows] = prior.pose[rows]

    def update(self, samples: Samples, rows: Rows) -> None:
        self.rows_seen.append(len(rows))
        self.estimate.known[rows] |= samples.seen[rows].any(axis=1)

    def get_state(self, rows: Rows) -> dict[str, Any]:
        return {"known": self.estimate.known[rows], "pose": self.estimate.pose[rows]}

    def set_state(self, state: dict[str, Any], rows: Rows) -> None:
        self.estimate.known[rows], self.estimate.pose[rows] = state["known"], state["pose"]


SOURCE = Path(__file__).read_text("utf-8")
FORMS = ["class", "function", "module", "file", "mapping", "configuration"]


def form(kind: str, folder: Path) -> Any:
    file = folder / "mine.py"
    file.write_text(SOURCE, encoding="utf-8")
    return {
        "class": Ahead,
        "function": functools.partial(Ahead),
        "module": f"{__name__}:Ahead",
        "file": f"{file}:Ahead",
        "mapping": {"kind": "own", "factory": f"{file}:Ahead"},
        "configuration": OwnConfig(factory=Ahead),
    }[kind]


@pytest.mark.parametrize("kind", FORMS)
def test_every_form_is_taken_at_every_door(kind: str, tmp_path: Path) -> None:
    """The object's own behaviour, known by heart, is what each door shows."""
    estimator = form(kind, tmp_path)
    single: Any = gym.make(ID, estimator=estimator).unwrapped
    parallel: Any = relloc_env.parallel_env(estimator=estimator, network={"latency": 0.1})
    turns: Any = relloc_env.env(estimator=estimator)
    vector: Any = gym.make_vec(ID, num_envs=3, estimator=estimator)
    learner = RellocVecEnv(3, estimator=estimator)
    outside = EstimateObservation(gym.make(ID, estimator=None), estimator)
    assert parallel.core.onboard.estimator.window == 3
    for core in (single.core, parallel.core, turns.unwrapped.core, vector.core, learner.core):
        assert type(core.onboard.estimator).__name__ == "Ahead"
    seen, _ = single.reset(seed=1)
    assert_array_equal(outside.reset(seed=1)[0], seen)
    assert_array_equal(vector.reset(seed=1)[0][0], seen)
    parallel.reset(seed=1)
    for env in (single, parallel, vector):
        estimate = env.core.onboard.estimate
        assert estimate.known.all()
        assert_array_equal(estimate.pose, env.core.simulation.prior.pose)
        first, width = single.core.slices["points"].start, 8
        shown = seen.reshape(2, -1)[:, first : first + 2 * width].reshape(2, 2, width)
        assert np.allclose(shown[..., 3:7], [0.0, 1.0, 0.0, 0.25])


@pytest.mark.parametrize("kind", FORMS)
def test_configurations_go_through_data_and_clones(kind: str, tmp_path: Path) -> None:
    config = load_config(estimator=form(kind, tmp_path), max_cycles=30)
    assert load_config(config).estimator == config.estimator
    env = RellocVectorEnv(2, config)
    env.reset(seed=3)
    env.step(np.ones((2, 4)))
    clones = env.clone(1, 3, same_streams=True)
    assert_array_equal(clones.step(np.zeros((3, 4)))[0][0], env.step(np.zeros((2, 4)))[0][1])
    if kind != "function":  # without a name it has no place
        text = json.dumps(config.to_dict())
        again = load_config(json.loads(text))
        assert json.dumps(again.to_dict()) == text
        own = again.estimator
        assert isinstance(own, OwnConfig)
        assert own.name == "Ahead"
        assert type(make(own, 1, 2, 2)).__name__ == "Ahead"
        assert pickle.loads(pickle.dumps(config)) == config


def test_a_large_batch_calls_it_from_one_thread() -> None:
    env = RellocVectorEnv(600, estimator=Ahead, threads=4)
    env.reset(seed=1)
    own: Any = env.core.onboard.estimator
    assert env.core.threads == 1
    assert own.rows_seen[-1] == 600


def test_a_log_is_replayed_through_it(tmp_path: Path) -> None:
    env = RecordLog(gym.make(ID, estimator=Ahead, max_cycles=4), tmp_path / "logs")
    env.reset(seed=2)
    for _ in range(4):
        env.step(np.zeros(4))
    for estimator in (Ahead, form("file", tmp_path)):
        result = replay(tmp_path / "logs" / "episode_000", estimator=estimator, out=tmp_path / "out")
        trace = result.runs["Ahead"][0].trace
        assert np.all(trace.points[..., 2] == 0.25)
        assert json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))["options"]["estimators"] == ["Ahead"]


WRONG: dict[str, tuple[Any, str]] = {
    "no module": ("no_such_module:Ahead", "'no_such_module:Ahead' does not: No module named"),
    "no file": ("no_such_file.py:Ahead", "'no_such_file.py:Ahead' does not: .*No such file"),
    "no such name": ("math:Ahead", "'math:Ahead' does not: module 'math' has no attribute"),
    "not callable": ("math:pi", "'math:pi' is float"),
    "no place": (":Ahead", "must be a class, a function, 'module:Name'"),
    "no name": ("math:", "must be a class, a function, 'module:Name'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_places_that_lead_nowhere(name: str) -> None:
    estimator, message = WRONG[name]
    with pytest.raises((ValueError, TypeError), match=message):
        gym.make(ID, estimator=estimator)


def changed(**fields: Any) -> Any:
    """A factory of estimators whose estimate has other arrays."""

    def factory(*sizes: int, message_window: int) -> Ahead:
        made = Ahead(*sizes, message_window=message_window)
        made.estimate = made.estimate._replace(**fields)
        return made

    return factory


class Anew(Ahead):
    """Makes new arrays at each look."""

    def __getattribute__(self, name: str) -> Any:
        found = super().__getattribute__(name)
        return Estimate(*(array.copy() for array in found)) if name == "estimate" else found


class Forgetful(Ahead):
    get_state: Any = None


WRONG_MAKES: dict[str, tuple[Any, str]] = {
    "nothing": (lambda *_, **__: None, "but NoneType has no reset, update, get_state, set_state"),
    "no state": (Forgetful, "but Forgetful has no get_state"),
    "no estimate": (lambda *a, **k: changed()(*a, **k).__class__.__new__(Ahead), "`estimate` of type .* NoneType"),
    "shape": (changed(pose=np.zeros((1, 3))), r"`estimator.estimate.pose` must be .* \(1, 2, 3\), but is .* \(1, 3\)"),
    "type": (changed(pose=np.zeros((1, 2, 3), np.float32)), r"`estimator.estimate.pose` must be .* float64"),
    "list": (changed(known=[[True]]), "`estimator.estimate.known` must be an array, but is list"),
    "anew": (Anew, "must be live arrays, refreshed in place"),
}


@pytest.mark.parametrize("name", WRONG_MAKES)
def test_what_a_factory_makes_is_looked_at_once(name: str) -> None:
    factory, message = WRONG_MAKES[name]
    with pytest.raises((ValueError, TypeError), match=message):
        gym.make(ID, estimator=factory)


class Rebinds(Ahead):
    def update(self, samples: Samples, rows: Rows) -> None:
        super().update(samples, rows)
        self.estimate = self.estimate._replace(pose=self.estimate.pose + 0.0)


class Breaks(Ahead):
    """Believes nothing that is a number after the second update, of what was seen."""

    field, value, where = "pose", np.nan, ()

    def update(self, samples: Samples, rows: Rows) -> None:
        super().update(samples, rows)
        if len(self.rows_seen) > 2:
            getattr(self.estimate, self.field)[(rows[-1:], *self.where)] = self.value


def breaks(**what: Any) -> Any:
    return type("Breaks", (Breaks,), what)


@pytest.mark.parametrize("door", [gym.make, lambda name, estimator: gym.make_vec(name, 2, estimator=estimator)])
def test_arrays_that_are_not_refreshed_in_place(door: Any) -> None:
    env = door(ID, estimator=Rebinds)
    with pytest.raises(ValueError, match=r"Estimator `Rebinds` must refresh .* another one in the place of `pose`"):
        env.reset(seed=1)
    bare = EstimateObservation(gym.make(ID, estimator=None), Rebinds)
    with pytest.raises(ValueError, match="Estimator `Rebinds` must refresh"):
        bare.reset(seed=1)


@pytest.mark.parametrize(
    ("what", "broken"),
    [
        ({}, True),
        ({"value": np.inf}, True),
        ({"field": "points"}, True),
        ({"field": "points", "where": (0, 1, 2)}, True),
        ({"field": "points_covariance"}, True),
        ({"field": "pose_covariance"}, True),
        ({"field": "pose_covariance", "value": np.inf}, True),
        # What is not known may be anything.
        ({"field": "known", "value": False}, False),
    ],
)
def test_beliefs_that_are_no_numbers(what: dict[str, Any], broken: bool) -> None:
    env = gym.make_vec(ID, num_envs=3, estimator=breaks(**what))
    env.reset(seed=1)
    if not broken:
        assert np.isfinite(env.step(np.zeros((3, 4)))[0]).all()
        return
    name = what.get("field", "pose")
    with pytest.raises(
        ValueError, match=rf"Estimator `Breaks` must give finite numbers, but its `estimate.{name}` of env.* 2 "
    ):
        env.step(np.zeros((3, 4)))


@pytest.mark.parametrize(
    "factory", [functools.partial(Ahead), lambda *numbers, **more: Ahead(*numbers, **more | {}), breaks()]
)
def test_what_has_no_place_is_not_written_down(factory: Any, tmp_path: Path) -> None:
    config = load_config(estimator=factory)
    with pytest.raises(
        ValueError, match=r"`estimator.factory` must be a class or function that its module has by name"
    ):
        config.to_dict()
    with pytest.raises(ValueError, match=r"`estimator.factory` must be"):
        RecordLog(gym.make(ID, estimator=factory), tmp_path)
    assert load_config(config, max_cycles=3).estimator == config.estimator


class Guess(Ahead):
    """Keeps no map; sure of its first guess."""

    def update(self, samples: Samples, rows: Rows) -> None:
        self.estimate.pose_covariance[rows] = 0.01 * np.eye(3)


def test_a_replay_scores_the_pose_of_who_keeps_no_map(tmp_path: Path) -> None:
    env = RecordLog(gym.make(ID, estimator="cascade", max_cycles=12), tmp_path / "logs")
    env.reset(seed=2)
    for _ in range(12):
        env.step(np.zeros(4))
    run = replay(tmp_path / "logs" / "episode_000", estimator=functools.partial(Guess), out=tmp_path / "out")
    scored = json.loads((tmp_path / "out" / "replay.json").read_text("utf-8"))["estimators"]["Guess"]
    assert scored["config"] == {"kind": "own"}
    assert scored["pose"]["seconds_with_two_common_points"] > 0
    assert scored["pose"]["seconds_with_estimate"] == scored["pose"]["seconds_with_two_common_points"]
    # The robots stood: the error is that of the first guess.
    log, errors = run.runs["Guess"][0].log, run.runs["Guess"][0].poses[0]
    assert log.truth is not None
    off = log.prior.pose[0, 0, :2] - log.truth.relative[0, 0, :2]
    assert np.allclose(np.hypot(*errors.error[-1, :2]), np.hypot(*off), atol=0.02)
    assert scored["pose"]["median_position_error_m"] == pytest.approx(np.hypot(*off), abs=0.02)


def test_what_an_object_believes_is_looked_at_too() -> None:
    with pytest.raises(
        ValueError, match=r"`estimator.estimate.points` must be .* \(1, 2, 2, 3\), but is .* \(2, 2, 2, 3\)"
    ):
        gym.make(ID, estimator=Ahead(2, 2, 2))
    with pytest.raises(ConfigError, match=r"must be a name, .* but is float"):
        gym.make(ID, estimator=3.5)


def test_names_are_not_taken_for_places() -> None:
    assert resolve("cascade").kind == "cascade"
    with pytest.raises(ValueError, match=re.escape("is 'mine.py'")):
        resolve("mine.py")


def test_a_file_may_import_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "neighbour_of_mine.py").write_text("def build(*numbers, message_window): return numbers\n", "utf-8")
    (tmp_path / "mine.py").write_text("from neighbour_of_mine import build\n", "utf-8")
    before = sys.path[:]
    assert load(f"{tmp_path / 'mine.py'}:build", "estimator")(1, 2, message_window=3) == (1, 2)
    assert sys.path == before
