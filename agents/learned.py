"""Trained policies: those that ship, by name; ONNX files with a card; and files of Stable-Baselines3.

An ONNX file is run by onnxruntime: no torch, and no code but its own few operations. A `.zip` of Stable-Baselines3 is
pickled Python, which runs whatever is in it (SECURITY.md).
"""

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from agents.layout import Layout
from agents.policy import Task
from relloc_env.config import hint
from relloc_env.estimators import PRESETS
from relloc_env.extras import extra
from relloc_env.files import read_json
from relloc_env.quoting import quote, word
from relloc_env.samples import Bool, Float, Float32

PREFIX = "learned:"
"""Begins the name of a learned agent: `learned:NAME`, `learned:path/to/policy.onnx` or `.zip`."""
POLICIES = Path(__file__).parent / "policies"
"""Folder of the policies that ship."""
NORMALISATION = "normalisation.pkl"
"""Statistics of `VecNormalize` that are taken up where they lie beside a policy of Stable-Baselines3."""
DIGEST = "sha256"
"""Entry of a card: that of its ONNX file."""
INPUT, OUTPUT = "observation", "action"
"""Names in an ONNX file."""

Decide = Callable[[Float32, Bool], Float]
"""From observations in a layout (rows, size), and which rows begin an episode (rows,), to actions (rows, size)."""


class Acting:
    """What a trained network does without exploring.

    Args:
        task: what the robots know of themselves.
        layout: of the observations that the network takes.
        decide: the network.
        what: name of the policy, for errors.

    Raises:
        ValueError: a task that the policy was not made for.
    """

    def __init__(self, task: Task, layout: Layout, decide: Decide, what: str = "The policy") -> None:
        self._task, self._layout, self._decide = task, layout, decide
        self._fit = layout.fit(task, what)
        self._fresh = True

    def reset(self, n: int, seed: int) -> None:  # noqa: ARG002 (every policy has them)
        """Forget, at the next observation, what is remembered of the episodes before."""
        self._fresh = True

    def act(self, observations: Float32) -> Float:
        """Ask the network."""
        n, robots = observations.shape[:2]
        count = n if self._layout.joint else n * robots
        rows = self._fit(observations).reshape(count, -1)
        starts = np.full(n, self._fresh)
        if "progress" in self._task.slices:
            starts |= self._task.time(observations) == 0.0
        self._fresh = False
        new = np.repeat(starts, count // n)
        actions: Float = np.asarray(self._decide(rows, new), np.float64).reshape(n, robots, -1)
        return actions[..., : self._task.config.action_size]  # those of points that are not there come last


def shipped() -> tuple[str, ...]:
    """Names of the policies that ship."""
    return tuple(sorted(each.stem for each in POLICIES.glob("*.onnx")))


def place(name: str) -> Path:
    """The file that `NAME`, or a path, leads to.

    Raises:
        ValueError: no such file.
    """
    path = Path(name)
    if path.suffix in (".onnx", ".zip"):
        if not path.is_file():
            raise ValueError(f"Argument `agents` must lead to a saved policy, but there is no file {name!r}")
        return path
    known = shipped()
    if name not in known:
        raise ValueError(
            f"Unknown policy `{word(name)}`{hint(name, known)}; known: {', '.join(known)}; "
            "or a path to an .onnx or .zip file"
        )
    return POLICIES / f"{name}.onnx"


def files(name: str) -> list[Path]:
    """Every file that a policy is read from."""
    path = place(name)
    return [path, path.with_suffix(".json"), *([path.with_name(NORMALISATION)] if path.suffix == ".zip" else [])]


def learned(task: Task, name: str) -> Acting:
    """Build the policy of a name or path; see `PREFIX`."""
    path = place(name)
    return _onnx(task, path) if path.suffix == ".onnx" else _zip(task, path)


def digest(network: bytes) -> str:
    """What a card says of its file."""
    return hashlib.sha256(network).hexdigest()


def read_card(path: Path) -> dict[str, Any]:
    """The card beside a policy's file: how it was trained, what it takes, how it did.

    Raises:
        ValueError: no such file, or one that is no card.
    """
    card = path.with_suffix(".json")
    try:
        data: dict[str, Any] = read_json(card)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} must have its card beside it, {card.name}, but: {error}") from None
    if not isinstance(data, dict) or "observation" not in data:
        raise ValueError(f"{card} must say what the policy takes (`observation`), but does not")
    return data


def _environment(name: str) -> dict[str, Any] | None:
    """The environment that a policy was trained for; None for a file of Stable-Baselines3 that has no card."""
    path = place(name)
    if path.suffix == ".zip" and not _has_card(path):
        return None
    try:
        return dict(read_card(path)["environments"][0])
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"{path.with_suffix('.json')} must say what the policy was trained in: {error}") from None


def _has_card(path: Path) -> bool:
    return path.with_suffix(".json").is_file()


def _laid_out(path: Path) -> Layout:
    """The layout that a card tells."""
    try:
        return Layout.from_dict(read_card(path)["observation"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"{path.with_suffix('.json')} must be a card of this version, but: {error}") from None


def options(name: str) -> dict[str, Any]:
    """Options of the environment without which a policy cannot act in it: what its actions set, and what it sees."""
    environment = _environment(name) or {}
    sets = ("action", "gains") if environment.get("action", "motion") != "motion" else ()
    sees = ("observation", "image_size") if environment.get("observation", "flat") != "flat" else ()
    return {key: environment[key] for key in (*sets, *sees)}


def trained_with(name: str) -> tuple[int, str]:
    """Number of robots and name of the estimator that a policy was trained with; the defaults where it has no card."""
    environment = _environment(name)
    if environment is None:
        return 2, "map-alignment"
    try:
        robots, stated = int(environment["robots"]), dict(environment["estimator"])
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"The card of {name} must say what the policy was trained with, but: {error!r}") from None
    kind = "cascade-critical" if stated.get("damping") == "critical" else stated.get("kind")
    return robots, str(kind) if kind in list(PRESETS) else "map-alignment"  # of the user's own it may be, or anything


def _onnx(task: Task, path: Path) -> Acting:
    with extra("agents"):
        import onnxruntime

    layout = _laid_out(path)
    network = path.read_bytes()
    stated, found = read_card(path).get(DIGEST), digest(network)
    if stated != found:
        raise ValueError(
            f"{path} is not the file that its card {path.with_suffix('.json').name} belongs to: the card's `{DIGEST}` "
            f"is {quote(stated)}, the file's {found!r}. Both are written by: python -m train export RUN"
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(network, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001 - onnxruntime's own classes derive from nothing more special
        raise ValueError(f"{path} must be an ONNX file, but: {error}") from None
    given = session.get_inputs()[0].shape[-1]
    if given != layout.size:
        raise ValueError(f"{path} must take {layout.size} numbers as its card says, but takes {given}")

    def decide(rows: Float32, _: Bool) -> Float:
        actions: Float = session.run([OUTPUT], {INPUT: rows})[0]
        return actions

    return Acting(task, layout, decide, f"The policy {path.stem!r}")


def _zip(task: Task, path: Path) -> Acting:
    warnings.warn(
        f"{path} is loaded with pickle, which runs whatever code is in it: load files of people you trust alone",
        stacklevel=2,
    )
    policy = _policy(path)
    mean, scale, clip = _statistics(path.with_name(NORMALISATION))
    seen = policy.observation_space
    given = int(np.prod(seen.shape))
    layout = _laid_out(path) if _has_card(path) else Layout.of(task, joint=given != task.size)
    if given != layout.size:
        raise ValueError(
            f"Argument `agents` must lead to a policy of {layout.row} numbers for a robot or "
            f"{layout.row * layout.robots} for all, but {str(path)!r} takes {given}"
        )
    memory: Any = None

    def decide(rows: Float32, new: Bool) -> Float:
        nonlocal memory
        rows = np.clip((rows - mean) / scale, -clip, clip).astype(seen.dtype).reshape(-1, *seen.shape)
        actions, memory = policy.predict(rows, memory, new, deterministic=True)
        return np.asarray(actions, np.float64)

    return Acting(task, layout, decide, f"The policy {str(path)!r}")


def _policy(path: Path) -> Any:
    """The policy network in a file of any of Stable-Baselines3's algorithms for continuous actions."""
    with extra("train"):
        import stable_baselines3 as sb3
        from stable_baselines3.common.save_util import load_from_zip_file

    data, _, _ = load_from_zip_file(path, device="cpu")
    module = data["policy_class"].__module__ if data else ""
    if module.startswith("sb3_contrib"):
        with extra("train"):
            from sb3_contrib import RecurrentPPO

        policy: Any = RecurrentPPO.load(path, device="cpu").policy
    else:
        name = {"sac": "SAC", "td3": "TD3"}.get(module.split(".")[1] if "." in module else "", "PPO")
        policy = getattr(sb3, name).load(path, device="cpu").policy
    policy.set_training_mode(False)
    return policy


def _statistics(path: Path) -> tuple[Any, Any, float]:
    """Mean, scale and clipping of observations; those that change nothing where there is no file."""
    if not path.is_file():
        return 0.0, 1.0, np.inf
    import pickle

    with path.open("rb") as file:
        normaliser = pickle.load(file)  # noqa: S301 - said in the docs, and by the warning above
    if not normaliser.norm_obs:
        return 0.0, 1.0, np.inf
    seen = normaliser.obs_rms
    return seen.mean, np.sqrt(seen.var + normaliser.epsilon), float(normaliser.clip_obs)
