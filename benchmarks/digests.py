"""What must not change when code is rebuilt: numbers of episodes, replays, the paper and policies, and their digest.

`record` runs everything by the public interfaces and keeps every number in one file; `compare` says, part by part,
whether two such files hold the same bits, and how far apart they are where they do not.
"""

import hashlib
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import relloc_env  # noqa: F401 (the ids)
from relloc_env.files import whole
from relloc_env.folders import open_file
from relloc_env.scenarios import SCENARIOS, SUITES

EPISODES = 20
"""Seeds of each configuration."""
RECORDED = 100
"""First seed."""
TOLERANCE = 1e-9
"""Difference from which on a number counts as changed."""
_TWO, _ONE = "relloc_env/RelativePose-v0", "relloc_env/ActiveDepth-v0"
_POLICIES = {
    "active-depth": 1,
    "many": 1,
    "depth-gains": 1,
    "relative-pose": 2,
    "relative-pose-joint": 2,
}
"""Shipped policies, and the robots that each drives."""
Arrays = dict[str, NDArray[Any]]
Tell = Callable[[float, str], None]


def configurations() -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the id and the options of every configuration, by name."""
    found: dict[str, tuple[str, dict[str, Any]]] = {}
    estimator: str | None
    for suite in SUITES.values():
        for i, variant in enumerate(suite.variants):
            for estimator in ("map-alignment", "cascade"):
                found[f"two/{suite.name}-{i}/{estimator}"] = (_TWO, {**variant, "estimator": estimator})
            found[f"one/{suite.name}-{i}/map-alignment"] = (_ONE, {**variant, "estimator": "map-alignment"})
    for name in ("paper-simulation", "paper-experiment"):
        found[f"two/{name}"] = (_TWO, {"config": name, "max_cycles": 400})
    found["one/paper-depth"] = (_ONE, {"config": "paper-depth", "max_cycles": 400})
    assert len(SCENARIOS) == 4  # a scenario that is added belongs here
    contacts = {"shield": None, "arena": (5.0, 5.0), "start": {"target_distance": (1.0, 3.0)}}
    boxes = [
        {"shape": "box", "position": (1.2, -1.0), "size": (0.8, 0.4), "angle": 0.4},
        {"shape": "disc", "position": (-1.2, 1.1), "radius": 0.3},
    ]
    lossy = {"latency": 0.15, "jitter": 0.1, "loss": 0.3, "rate": 10.0}
    for estimator in ("cascade-critical", "inverse-depth", None):
        found[f"two/open-field/{estimator}"] = (_TWO, {"estimator": estimator})
        found[f"one/open-field/{estimator}"] = (_ONE, {"estimator": estimator})
        found[f"two/lossy/{estimator}"] = (_TWO, {"estimator": estimator, "network": lossy})
    for estimator in ("map-alignment", "cascade", None):
        found[f"two/contacts/{estimator}"] = (_TWO, {**contacts, "obstacles": boxes, "estimator": estimator})
        found[f"one/contacts/{estimator}"] = (_ONE, {**contacts, "obstacles": boxes, "estimator": estimator})
    found["two/collision-ends"] = (_TWO, {**contacts, "estimator": "cascade", "terminate_on_collision": True})
    found["two/success-ends"] = (_TWO, {"estimator": "cascade", "terminate_on_success": True, "success": (0.2, 4.0)})
    found["two/lag-scales"] = (
        _TWO,
        {
            "estimator": "map-alignment",
            "robot": {"lag": (0.2, 0.1)},
            "camera": {"preset": "kinect", "frame_rate": 10.0},
        },
    )
    found["two/commands"] = (_TWO, {"estimator": "map-alignment-commands"})
    found["two/each-sample"] = (_TWO, {"estimator": {"kind": "map-alignment", "align_every": 1}})
    found["two/gains"] = (_TWO, {"estimator": "cascade", "action": "motion+gains"})
    found["one/gains-critical"] = (_ONE, {"estimator": "cascade-critical", "action": "motion+gains"})
    found["two/eight-points"] = (
        _TWO,
        {
            "estimator": "cascade",
            "targets": 8,
            "start": {"target_separation": (0.3, 6.0), "target_distance": (1.5, 8.0)},
        },
    )
    found["two/all-rewards"] = (_TWO, {"estimator": "cascade", "reward": dict.fromkeys(_terms(), 1.0)})
    found["two/dict"] = (_TWO, {"estimator": "cascade", "observation": "dict"})
    found["two/pictures"] = (_TWO, {"estimator": "cascade", "camera": "image", "max_cycles": 10})
    found["two/seen-pictures"] = (_TWO, {"estimator": "cascade", "observation": "image", "max_cycles": 10})
    return found


def _terms() -> tuple[str, ...]:
    from relloc_env.config.models import REWARD_TERMS

    return REWARD_TERMS


def record(path: Path, tell: Tell = lambda _part, _what: None) -> int:
    """Run everything and write its numbers; return how many arrays there are.

    Args:
        path: a new .npz file. RELLOC_DATA, where it is set, adds the recorded robots.
        tell: called with the part of all the work that is done, and what comes next.
    """
    arrays: Arrays = {}
    todo = configurations()
    for i, (name, (task, options)) in enumerate(todo.items()):
        tell(0.8 * i / len(todo), name)
        arrays.update(_named(name, episodes(task, options)))
    for part, (name, make) in enumerate({"replay": replays, "paper": paper, "policy": policies}.items()):
        tell(0.8 + 0.07 * part, name)
        arrays.update(_named(name, make()))
    path = open_file(path)
    with whole(path) as partial:
        np.savez_compressed(partial, **arrays)  # type: ignore[arg-type]
    return len(arrays)


def episodes(task: str, options: Mapping[str, Any]) -> Arrays:
    """Whole episodes of one configuration: what every step showed, paid and told, and what was believed."""
    env: Any = gym.make_vec(task, num_envs=EPISODES, autoreset_mode="Disabled", **options)
    base = env.unwrapped
    cycles = base.config.max_cycles
    draw = np.random.default_rng(1)
    shape = (cycles, EPISODES, env.action_space.shape[1])
    smooth = np.repeat(draw.normal(0.0, 0.6, (cycles // 10 + 1, *shape[1:])), 10, axis=0)
    actions = np.clip(smooth[:cycles], -1.0, 1.0)
    actions[:, : EPISODES // 2, 0::2] = np.abs(actions[:, : EPISODES // 2, 0::2])  # half of them keep on
    kept: dict[str, list[NDArray[Any]]] = {}

    def keep(observation: Any, rest: Mapping[str, Any]) -> None:
        for name, array in _flat({"observation": observation, **rest}):
            kept.setdefault(name, []).append(np.array(array))

    observation, info = env.reset(seed=list(range(RECORDED, RECORDED + EPISODES)))
    keep(observation, {"info": info})
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action.astype(np.float32))
        rest = {"reward": reward, "terminated": terminated, "truncated": truncated, "info": info}
        if base.config.estimator is not None:
            rest["estimate"] = base.core.onboard.estimate._asdict()
        keep(observation, rest)
        over = terminated | truncated
        if over.any() and not truncated.all():
            env.reset(options={"reset_mask": over})
    env.close()
    return {name: np.stack(each) for name, each in kept.items()}


def replays() -> Arrays:
    """Estimates along recorded logs: a simulated episode, and the recorded robots where they are."""
    from relloc_env.replay import replay
    from relloc_env.wrappers import RecordLog

    found: Arrays = {}
    with TemporaryDirectory() as folder:
        env = RecordLog(gym.make(_TWO, estimator="cascade", max_cycles=60), Path(folder) / "log")
        env.reset(seed=5)
        for k in range(60):
            env.step(np.array([1.0, 0.3 * (-1) ** (k // 10), 1.0, -0.2], np.float32))
        env.close()
        logs: list[tuple[str, Path, dict[str, Any]]] = [
            ("simulated", next((Path(folder) / "log").rglob("episode_000")), {})
        ]
        recorded = os.environ.get("RELLOC_DATA")
        if recorded:
            mrclam = Path(recorded) / "mrclam" / "MRCLAM_Dataset7"
            logs.append(("mrclam", mrclam, {"robots": (2, 3), "start": 430.0, "stop": 520.0}))
            logs.append(("starloc", Path(recorded) / "starloc" / "zigzag_s4", {}))
        for name, path, options in logs:
            result = replay(path, estimator=["map-alignment", "cascade", "cascade-critical"], **options)
            for estimator, runs in result.runs.items():
                found.update(_named(f"{name}/{estimator}", dict(_flat(runs[0].trace._asdict()))))
    return found


def paper() -> Arrays:
    """What was measured for each of the paper's claims."""
    from relloc_env.paper import reproduce

    with TemporaryDirectory() as folder:
        claims = reproduce(Path(folder))
    return {
        f"{claim.id}/{name}": np.array(np.nan if value is None else value)
        for claim in claims
        for name, value in claim.measured.items()
    }


def policies() -> Arrays:
    """Scores of the policies that ship."""
    from agents.learned import options as environment
    from agents.playing import play
    from agents.registry import agent
    from relloc_env.config import load_config

    found: Arrays = {}
    for name, robots in _POLICIES.items():
        config = load_config(None, **{"robots": robots, "max_cycles": 60, "estimator": "cascade", **environment(name)})
        scores, _ = play(config, agent(f"learned:{name}"), range(RECORDED, RECORDED + EPISODES))
        found.update(_named(name, {key: np.asarray(value) for key, value in scores.items()}))
    return found


def compare(old: Path, new: Path) -> list[tuple[str, str, float]]:
    """Return every part that is not the same to the bit: its name, what is different, and the greatest difference."""
    found: list[tuple[str, str, float]] = []
    with np.load(old, allow_pickle=False) as before, np.load(new, allow_pickle=False) as after:
        for name in sorted({*before.files, *after.files}):
            if name not in after.files or name not in before.files:
                found.append((name, "missing" if name not in after.files else "new", np.inf))
                continue
            a, b = before[name], after[name]
            if a.shape != b.shape or a.dtype != b.dtype:
                found.append((name, f"{a.dtype} {a.shape} became {b.dtype} {b.shape}", np.inf))
            elif a.tobytes() != b.tobytes():
                found.append((name, "numbers", difference(a, b)))
    return found


def difference(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Greatest difference of two arrays, relative to numbers above 1; infinite where one is finite and one is not."""
    x, y = a.astype(np.float64), b.astype(np.float64)
    if not np.array_equal(np.isnan(x), np.isnan(y)):
        return float("inf")
    same = (x == y) | np.isnan(x)
    with np.errstate(invalid="ignore"):
        gap = np.where(same, 0.0, np.abs(x - y) / np.maximum(1.0, np.abs(x)))
    return float(np.nan_to_num(gap, nan=np.inf).max(initial=0.0))


def digest(path: Path) -> str:
    """One digest of all that a file holds, whatever the time it was written at."""
    total = hashlib.sha256()
    with zipfile.ZipFile(path) as archive:
        for name in sorted(archive.namelist()):
            total.update(name.encode())
            total.update(archive.read(name))
    return total.hexdigest()


def _named(prefix: str, arrays: Arrays) -> Arrays:
    return {f"{prefix}/{name}": array for name, array in arrays.items()}


def _flat(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Every array in nested dictionaries, by its path; masks of vector environments are left out."""
    for name, value in data.items():
        if str(name).startswith("_"):
            continue
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}/")
        elif isinstance(value, tuple):
            yield from _flat(dict(enumerate(value)), f"{prefix}{name}/")  # type: ignore[arg-type]
        else:
            array = np.asarray(value)
            if array.dtype != object:
                yield f"{prefix}{name}", array
