"""A run: what it leaves, that it can be killed, that the same seed gives the same policy."""

import inspect
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import gymnasium as gym
import torch
import yaml
from stable_baselines3 import PPO
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from agents import results
from agents.alone import LOCK
from agents.learned import trained_with
from agents.playing import play
from agents.policy import Task
from agents.registry import agent, needs
from relloc_env.config import ConfigError, load_config
from relloc_env.envs.variation import Variation
from relloc_env.scenarios import seeds
from train import checkpoints
from train.__main__ import app
from train.config import CONFIGS, PAIR, EnvironmentConfig, TrainConfig, load
from train.folder import CHECKPOINT, CONFIG, EVALUATION, claim
from train.run import DivergedError, train
from train.tune import tune
from train.worlds import layout_of

TINY: dict[str, Any] = {
    "name": "tiny",
    "environment": {"robots": 1, "options": {"estimator": "cascade", "max_cycles": 8}},
    "algorithm": {"name": "PPO", "n_steps": 8, "batch_size": 32, "n_epochs": 2},
    "network": {"hidden": [8]},
    "num_envs": 4,
    "steps": 320,
    "checkpoint": 64,
    "evaluation": {"every": 128, "episodes": 3, "test": 3, "scripts": ["straight", "edge"]},
    "film": "",
}


def weights(folder: Path) -> dict[str, Any]:
    state = checkpoints.read(folder / CHECKPOINT)["model"]
    return state["parameters"]["policy"]


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)


def tiny(**changes: Any) -> TrainConfig:
    return load({**TINY, **changes})


def test_a_run_leaves_a_policy_that_acts_as_the_trained_one(tmp_path: Path) -> None:
    config = tiny()
    policy = train(config, tmp_path)
    assert policy == tmp_path / "policy.onnx"
    lines = [json.loads(line) for line in (tmp_path / EVALUATION).read_text("utf-8").splitlines()]
    assert [line["steps"] for line in lines] == [0, 128, 256, 320]
    assert lines[-1]["best"] == max(line["score"] for line in lines)
    task = Task.of(config.played[0])
    with pytest.warns(UserWarning, match="pickle"):
        saved = agent(f"learned:{tmp_path / 'policy.zip'}")(task)
    shipped = agent(f"learned:{policy}")(task)
    rows = np.random.default_rng(0).normal(size=(50, 1, task.size)).astype(np.float32)
    np.testing.assert_allclose(shipped.act(rows), saved.act(rows), atol=1e-5)
    card = json.loads((tmp_path / "policy.json").read_text("utf-8"))
    assert load(card["configuration"]) == config
    score = card["metrics"]["scores"]["information_end"]
    assert score["low"] <= score["value"] <= score["high"]


def test_the_same_seed_gives_the_same_policy_and_another_another(tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        train(tiny(seed=seed), tmp_path / name)
    a, b, c = (weights(tmp_path / name) for name in "abc")
    assert same(a, b)
    assert not same(a, c)
    assert (tmp_path / "a" / "policy.onnx").read_bytes() == (tmp_path / "b" / "policy.onnx").read_bytes()


def test_killed_it_goes_on_and_ends_as_if_nothing_had_happened(tmp_path: Path) -> None:
    changes = ["steps=1600", "checkpoint=64", "evaluation.every=320"]
    config = tmp_path / "tiny.json"
    config.write_text(json.dumps(TINY), encoding="utf-8")
    whole = load(config, changes)
    train(whole, tmp_path / "whole")
    command = [sys.executable, "-m", "train", "run", str(config), *changes, "--out", str(tmp_path / "killed")]
    place = Path(__file__).parents[2]
    process = subprocess.Popen(command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    path = tmp_path / "killed" / CHECKPOINT
    steps = 0
    while steps < 400:
        assert process.poll() is None, "the run was over before it was killed"
        steps = checkpoints.read(path)["model"]["kept"]["num_timesteps"] if path.exists() else 0
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    with (tmp_path / "killed" / EVALUATION).open("a", encoding="utf-8") as file:
        file.write('{"steps": 1599, "score"')  # what a killed run may leave
    train(whole, tmp_path / "killed")
    assert same(weights(tmp_path / "killed"), weights(tmp_path / "whole"))
    assert (tmp_path / "killed" / EVALUATION).read_bytes() == (tmp_path / "whole" / EVALUATION).read_bytes()


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_published_configurations_are_whole_and_plain_data(path: Path) -> None:
    config = load(path.stem, ["seed=7", "algorithm.learning_rate=3e-4", "environment.options.robot.max_speed=0.2"])
    assert (config.seed, config.algorithm.learning_rate) == (7, 3e-4)
    assert config.played[0].robot_of(0).max_speed == 0.2
    assert load(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config
    options: Any = config.algorithm
    rows = config.num_envs * (2 if config.environment.decentralised else 1)
    assert options.batch_size <= options.n_steps * rows


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("algorithm.n_step=3", "did you mean `n_steps`"),
        ("environment.options.robot.max_sped=2", "did you mean `max_speed`"),
        ("evaluation.score=information", "did you mean `information_end`"),
        ("evaluation.score=-time_pose", "one robot alone has, but is '-time_pose'"),
        ("environment.stages=[{suite: many-points}]", "points as in training, 3 to 6, but has 2"),
        ("environment.without=[pose]", "must be of"),
        ("network.policy=MlpLstmPolicy", "RecurrentPPO"),
        ("stepps=3", "did you mean `steps`"),
        ("steps", "must look like"),
    ],
)
def test_what_is_wrong_with_an_override_is_said(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load("active-depth", [override])


def test_one_robot_alone_has_all_scores_but_those_that_are_refused() -> None:
    scores, _ = play(tiny().played[0], agent("straight"), [0, 1])
    assert {name for name, values in scores.items() if np.isnan(values).all()} == set(PAIR)


def test_where_the_score_never_happens_the_first_policy_is_the_best(tmp_path: Path) -> None:
    config = tiny(evaluation=TINY["evaluation"] | {"score": "-time_depth"}, steps=64)
    train(config, tmp_path)
    card = json.loads((tmp_path / "policy.json").read_text("utf-8"), parse_constant=pytest.fail)
    assert (card["validation_score"], card["steps"]) == (None, 0)


@pytest.mark.parametrize(
    ("stages", "span"),
    [
        ([{}], (2, 2)),
        ([{"suite": "many-points"}], (3, 6)),
        ([{"vary": {"targets": [3, 6]}}], (3, 6)),
        ([{"vary": {"targets": {"choices": [5, 4]}}}], (4, 5)),
        ([{"until": 9, "options": {"targets": 4}}, {"options": {"targets": 3}}], (3, 4)),
    ],
)
def test_a_policy_is_laid_out_for_the_numbers_of_points_that_it_is_trained_on(
    stages: list[dict[str, Any]], span: tuple[int, int]
) -> None:
    environment = EnvironmentConfig.model_validate(TINY["environment"] | {"stages": stages})
    layout = layout_of(environment)
    assert (layout.fewest, layout.targets) == span
    if environment.varied:
        drawn = Variation(environment.shared, environment.stages)
        rng = np.random.default_rng(0)
        seen = {drawn.draw(k % len(stages), k, rng).targets for k in range(60)}
        assert (min(seen), max(seen)) == span


def test_the_trainer_of_the_zoo_finds_arguments_that_there_are() -> None:
    data = yaml.safe_load((CONFIGS.parent / "zoo" / "ppo.yml").read_text("utf-8"))
    assert set(data) == {"relloc_env/ActiveDepth-v0", "relloc_env/RelativePose-v0"}
    zoo = {"normalize", "n_envs", "n_timesteps", "policy", "env_kwargs"}
    for name, options in data.items():
        assert name in gym.registry
        given = {key: value for key, value in options.items() if key not in zoo}
        assert set(given) <= set(inspect.signature(PPO).parameters)
        load_config(options.get("env_kwargs"))


def test_the_folder_of_another_run_is_left_alone(tmp_path: Path) -> None:
    train(tiny(), tmp_path)
    with pytest.raises(ConfigError, match=r"other values of algorithm\.gamma, seed"):
        train(load(TINY, ["seed=2", "algorithm.gamma=0.9"]), tmp_path)


def test_a_folder_from_before_a_field_was_there_is_of_the_same_run(tmp_path: Path) -> None:
    config = tiny()
    older = config.to_dict()
    del older["film"], older["environment"]["finite"], older["evaluation"]["options"]
    (tmp_path / CONFIG).write_text(yaml.safe_dump(older), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"other values of film$"):
        claim(config, tmp_path)
    claim(load(config.to_dict() | {"film": "gif"}), tmp_path)


def test_a_wrong_configuration_is_one_line() -> None:
    result = CliRunner().invoke(app, ["run", "relativ-pose"])
    assert result.exit_code == 2
    assert "did you mean `relative-pose`" in result.output


def test_a_run_that_breaks_stops_with_a_message_and_keeps_its_checkpoint(tmp_path: Path) -> None:
    config = tiny(algorithm=TINY["algorithm"] | {"learning_rate": 1e7})
    with pytest.raises(DivergedError, match=r"checkpoint at .* steps stays"):
        train(config, tmp_path)
    assert all(bool(torch.isfinite(value).all()) for value in weights(tmp_path).values())


MEMORY = {"network": {"policy": "MlpLstmPolicy", "hidden": [8], "lstm": 8}}
DRAWN = TINY["environment"] | {"stages": [{"vary": {"targets": [2, 4]}}], "groups": 2}
OFF = {"learning_starts": 32, "batch_size": 16, "buffer_size": 200, "gradient_steps": 2}


@pytest.mark.parametrize(
    ("algorithm", "more"),
    [
        ({**TINY["algorithm"], "schedule": "linear"}, {"normalise": {"rewards": True}}),
        (TINY["algorithm"], {"environment": DRAWN}),
        ({**TINY["algorithm"], "name": "RecurrentPPO"}, MEMORY),
        ({"name": "SAC", **OFF}, {}),
        ({"name": "TD3", "action_noise": 0.1, **OFF}, {}),
    ],
    ids=["PPO", "PPO, options drawn", "RecurrentPPO", "SAC", "TD3"],
)
def test_stopped_while_it_writes_a_checkpoint_it_goes_on_from_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: dict[str, Any], more: dict[str, Any]
) -> None:
    config = tiny(algorithm=algorithm, **more)
    train(config, tmp_path / "whole")
    write, written = checkpoints.write, []

    def stop(path: Path, state: Any) -> None:
        written.append(state["saved"])
        if len(written) == 4:
            raise KeyboardInterrupt
        write(path, state)

    monkeypatch.setattr(checkpoints, "write", stop)
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "stopped")
    monkeypatch.setattr(checkpoints, "write", write)
    saved = train(config, tmp_path / "stopped")
    assert same(weights(tmp_path / "stopped"), weights(tmp_path / "whole"))
    lines = [(tmp_path / name / EVALUATION).read_bytes() for name in ("stopped", "whole")]
    assert lines[0] == lines[1]
    board = EventAccumulator(str(tmp_path / "stopped" / "tensorboard")).Reload()
    steps = [event.step for event in board.Scalars("evaluation/information_end")]
    assert steps == [json.loads(line)["steps"] for line in lines[0].splitlines()]
    assert saved.name == ("policy.zip" if algorithm["name"] == "RecurrentPPO" else "policy.onnx")


def test_a_recurrent_policy_is_played_in_the_layout_that_its_card_tells(tmp_path: Path) -> None:
    environment = TINY["environment"] | {"nearest_first": True, "without": ["progress"]}
    config = tiny(
        environment=environment, algorithm={**TINY["algorithm"], "name": "RecurrentPPO"}, steps=32, **MEMORY
    )  # fmt: skip
    policy = train(config, tmp_path)
    assert policy == tmp_path / "policy.zip"
    assert trained_with(str(policy)) == (1, "cascade")
    task = Task.of(config.played[0])
    rows = np.random.default_rng(0).normal(size=(20, 1, task.size)).astype(np.float32)
    points = rows[..., task.slices["points"]].reshape(20, 1, task.targets, -1)
    swapped = rows.copy()
    swapped[..., task.slices["points"]] = points[:, :, ::-1].reshape(20, 1, -1)
    actions = []
    for each in (rows, swapped):
        with pytest.warns(UserWarning, match="pickle"):
            actions.append(agent(f"learned:{policy}")(task).act(each))
    np.testing.assert_array_equal(actions[0], actions[1])  # the nearest first, in whatever order they are given


def test_an_export_on_the_way_is_not_the_end_and_leaves_the_run_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny()
    train(config, tmp_path / "whole")
    write = checkpoints.write

    def stop(path: Path, state: Any) -> None:
        if state["saved"] == 192:
            raise KeyboardInterrupt
        write(path, state)

    monkeypatch.setattr(checkpoints, "write", stop)
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "live", command="python -m train run tiny")
    monkeypatch.setattr(checkpoints, "write", write)
    with (tmp_path / "live" / EVALUATION).open("a", encoding="utf-8") as file:
        file.write('{"steps": 256}\n')  # the run has got further than its checkpoint
    journal = (tmp_path / "live" / EVALUATION).read_bytes()
    result = CliRunner().invoke(app, ["export", str(tmp_path / "live")])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "live" / EVALUATION).read_bytes() == journal
    assert json.loads((tmp_path / "live" / "policy.json").read_text("utf-8"))["command"] == "python -m train run tiny"
    train(config, tmp_path / "live")
    assert same(weights(tmp_path / "live"), weights(tmp_path / "whole"))
    assert {path.name for path in tmp_path.glob("*/.*")} == {LOCK}
    left = (tmp_path / "live" / "policy.json").stat().st_mtime_ns
    assert train(config, tmp_path / "live").name == "policy.onnx"
    assert (tmp_path / "live" / "policy.json").stat().st_mtime_ns == left


def test_robots_that_share_a_policy_and_points_of_any_number(tmp_path: Path) -> None:
    variants = [{"targets": 2}, {"targets": 3}]
    options = {"estimator": "cascade", "max_cycles": 8, "reward": {"information_pose": 3.0, "change": -0.1}}
    stages = [{"until": 100, "vary": {"targets": {"choices": [2, 3]}}}, {"vary": {"camera.pixel_noise": [0.8, 3.2]}}]
    environment = {
        "robots": 2, "decentralised": True, "stages": stages, "options": options, "nearest_first": True, "groups": 3,
        "without": ["message_age"], "finite": True,
    }  # fmt: skip
    evaluation = TINY["evaluation"] | {"variants": variants}
    policy = train(tiny(environment=environment, evaluation=evaluation), tmp_path)
    for targets in (2, 3):
        task = Task.of(load_config(estimator="cascade", targets=targets))
        rows = np.random.default_rng(0).normal(size=(20, 2, task.size)).astype(np.float32)
        acting = agent(f"learned:{policy}")(task)
        actions = acting.act(rows)
        assert actions.shape == (20, 2, 2)
        np.testing.assert_allclose(acting.act(rows[:, ::-1])[:, ::-1], actions, atol=1e-6)  # each robot on its own
    with pytest.raises(ValueError, match="2 to 3 points, but the task has 4"):
        agent(f"learned:{policy}")(Task.of(load_config(estimator="cascade", targets=4)))


def test_a_search_goes_on_and_leaves_the_best_configuration(tmp_path: Path) -> None:
    search = {
        "algorithm.learning_rate": {"low": 1e-4, "high": 1e-2, "log": True},
        "network.hidden": {"choices": [[4], [8]]},
    }
    config = tiny(search=search)
    found: list[str] = []
    tune(config, 2, tmp_path, found.append)
    best = tune(config, 3, tmp_path, found.append)
    assert [line.partition(":")[0] for line in found] == [f"Trial {n} of {2 if n < 3 else 3}" for n in (1, 2, 3)]
    assert len({line.rpartition(", {")[2] for line in found}) == 3  # the third is not the first once more
    chosen = load(best)
    assert 1e-4 <= chosen.algorithm.learning_rate <= 1e-2
    assert chosen.network.hidden in ((4,), (8,))
    assert chosen.model_copy(update={"search": {}, "algorithm": config.algorithm, "network": config.network}) == tiny()


SIGHT: dict[str, Any] = {
    "environment": {
        "robots": 1,
        "options": {"estimator": "cascade", "max_cycles": 8, "observation": "image", "image_size": [36, 36]},
    },
    "network": {"policy": "CnnPolicy", "hidden": [8]},
    "normalise": {"observations": False},
}  # fmt: skip


def test_a_policy_learns_from_pictures_and_is_played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tiny(**SIGHT, steps=128)
    train(config, tmp_path / "whole")
    write = checkpoints.write

    def stop(path: Path, state: Any) -> None:
        write(path, state)
        if state["saved"] == 64:
            raise KeyboardInterrupt

    monkeypatch.setattr(checkpoints, "write", stop)
    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "stopped")
    monkeypatch.setattr(checkpoints, "write", write)
    policy = train(config, tmp_path / "stopped")
    assert same(weights(tmp_path / "stopped"), weights(tmp_path / "whole"))
    assert policy.name == "policy.zip"
    card = json.loads((tmp_path / "stopped" / "policy.json").read_text("utf-8"))
    name = f"learned:{policy}"
    with pytest.warns(UserWarning, match="pickle"):
        scores, _ = play(load_config(None, robots=1, estimator="cascade", max_cycles=8, **needs(name)),
                         agent(name), seeds("test", 3))  # fmt: skip
    assert np.mean(scores["information_end"]) == pytest.approx(card["metrics"]["scores"]["information_end"]["value"])
    with pytest.raises(ValueError, match="needs the field `picture`"), pytest.warns(UserWarning, match="pickle"):
        agent(name)(Task.of(load_config(None, robots=1, estimator="cascade")))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"network": {}}, "must be CnnPolicy for `observation: image`"),
        ({"environment": TINY["environment"]}, "must be CnnPolicy for `observation: image`, and for it alone"),
        ({"normalise": {}}, "`normalise.observations` must be false"),
        ({"film": "gif"}, '`film` must be "" for'),
        ({"environment": SIGHT["environment"] | {"nearest_first": True}}, "must have no `stages`"),
        ({"environment": SIGHT["environment"] | {"stages": [{"vary": {"targets": [2, 3]}}]}}, "must have no `stages`"),
        ({"evaluation": {"options": {"observation": "flat"}}}, "must have the same `observation`"),
    ],
)
def test_what_pictures_cannot_be_with_is_said(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        tiny(**SIGHT | changes)


def test_a_trial_that_was_stopped_goes_on_from_its_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tiny(search={"algorithm.learning_rate": {"low": 1e-4, "high": 1e-2, "log": True}})
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    tune(config, 2, whole, lambda _: None)
    write, written = checkpoints.write, []

    def stop(path: Path, state: Any) -> None:
        if path.parent.name == "trial-0001" and state["saved"] == 192:
            raise KeyboardInterrupt
        written.append((path.parent.name, state["saved"]))
        write(path, state)

    monkeypatch.setattr(checkpoints, "write", stop)
    with pytest.raises(KeyboardInterrupt):
        tune(config, 2, stopped, lambda _: None)
    before = len(written)
    assert written[-1] == ("trial-0001", 128)

    def note(path: Path, state: Any) -> None:
        written.append((path.parent.name, state["saved"]))
        write(path, state)

    monkeypatch.setattr(checkpoints, "write", note)
    found: list[str] = []
    best = tune(config, 2, stopped, found.append)
    assert written[before:] == [("trial-0001", 192), ("trial-0001", 256), ("trial-0001", 320)]
    assert len(found) == 1
    assert same(weights(stopped / "trial-0001"), weights(whole / "trial-0001"))
    assert best.read_bytes() == (whole / best.name).read_bytes()


def test_a_policy_is_evaluated_beside_scripts(tmp_path: Path) -> None:
    options = {"estimator": "cascade"}
    policy = train(tiny(environment={"robots": 1, "options": options}), tmp_path / "run")
    arguments = ["evaluate", str(policy), "--out", str(tmp_path / "out"), "--agents", "edge", "--episodes", "4"]
    arguments += ["--set", "max_cycles=6", "--set", "robot.lag=[0.2,0.1]"]
    result = CliRunner().invoke(app, [*arguments, "--no-animations", "--cores", "1"])
    assert result.exit_code == 0, result.output
    assert "policy.onnx" in (tmp_path / "out" / "summary.json").read_text("utf-8")
    for each in results.load(tmp_path / "out")[1]:
        config, _ = each.job.configurations()[0]
        assert (config.robot_of(0).lag, config.max_cycles) == ((0.2, 0.1), 6)
        assert len(each.time) == 7


def test_a_film_is_left_out_where_nothing_says_otherwise() -> None:
    """Of policies that see pictures there is none; `film=` on the command line means none too."""
    seeing = {name: value for name, value in (TINY | SIGHT).items() if name != "film"}
    assert load(seeing).film == ""
    assert load(load(seeing).to_dict()) == load(seeing)
    assert load("active-depth").film == "gif"
    assert load("active-depth", ["film="]).film == ""
