"""A policy as an ONNX file with a card: raw observations in, clipped actions out, the normalisation inside."""

import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import relloc_env
from agents.learned import DIGEST, INPUT, OUTPUT, digest
from relloc_env.extras import extra
from relloc_env.files import write_json, write_whole
from train.config import TrainConfig

with extra("train"):
    import onnx
    import torch
    from onnx import TensorProto, helper, numpy_helper
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.torch_layers import FlattenExtractor


OPSET = 21
_ACTIVATIONS = {torch.nn.Tanh: "Tanh", torch.nn.ReLU: "Relu", torch.nn.ELU: "Elu"}


class NoOnnxError(ValueError):
    """A policy with layers that have no place in an ONNX file of ours."""


class _Graph:
    """A chain of ONNX nodes that grows at its end."""

    def __init__(self, start: str) -> None:
        self.end = start
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: NDArray[Any]) -> str:
        """Keep a float32 array; its name."""
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def add(self, operation: str, *others: str, **attributes: Any) -> None:
        """Put one node behind the last."""
        name = f"x{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, [self.end, *others], [name], **attributes))
        self.end = name

    def clip(self, bound: float) -> None:
        """Cut at both sides."""
        self.add("Clip", self.constant(np.array(-bound)), self.constant(np.array(bound)))


def to_onnx(model: BaseAlgorithm) -> onnx.ModelProto:
    """The network that chooses actions, without what only training needs.

    Raises:
        NoOnnxError: a policy with memory, or with layers other than linear ones and simple activations.
    """
    size = int(np.prod(model.observation_space.shape or ()))
    actions = int(np.prod(model.action_space.shape or ()))
    graph = _Graph(INPUT)
    normaliser = model.get_vec_normalize_env()
    if normaliser is not None and normaliser.norm_obs:
        statistics: Any = normaliser.obs_rms
        graph.add("Sub", graph.constant(statistics.mean))
        graph.add("Mul", graph.constant(1.0 / np.sqrt(statistics.var + normaliser.epsilon)))
        graph.clip(normaliser.clip_obs)
    for layer in _layers(model.policy):
        if isinstance(layer, torch.nn.Linear):
            weight, bias = (graph.constant(part.detach().numpy()) for part in (layer.weight, layer.bias))
            graph.add("Gemm", weight, bias, transB=1)
        elif type(layer) in _ACTIVATIONS:
            graph.add(_ACTIVATIONS[type(layer)])
        else:
            raise NoOnnxError(f"A policy must be of linear layers and {', '.join(_ACTIVATIONS.values())} to be an ONNX "
                             f"file, but has {type(layer).__name__}")  # fmt: skip
    graph.clip(1.0)
    graph.nodes[-1].output[0] = OUTPUT
    made = helper.make_model(
        helper.make_graph(
            graph.nodes, "policy",
            [helper.make_tensor_value_info(INPUT, TensorProto.FLOAT, ["rows", size])],
            [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["rows", actions])],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=10,
        producer_name="relloc_env",
    )  # fmt: skip
    onnx.checker.check_model(made)
    return made


def _layers(policy: Any) -> Iterator[torch.nn.Module]:
    """The layers from an observation to the action without noise, in order."""
    if not isinstance(getattr(policy, "features_extractor", None) or policy.actor.features_extractor, FlattenExtractor):
        raise NoOnnxError("A policy must take numbers to be an ONNX file, but this one takes pictures")
    if hasattr(policy, "lstm_actor"):
        raise NoOnnxError("A policy must have no memory to be an ONNX file, but this one is recurrent")
    if hasattr(policy, "action_net"):
        yield from policy.mlp_extractor.policy_net
        yield policy.action_net
    elif hasattr(policy.actor, "latent_pi"):
        yield from policy.actor.latent_pi
        yield policy.actor.mu
        yield torch.nn.Tanh()
    else:
        yield from policy.actor.mu


def card(config: TrainConfig, model: BaseAlgorithm, **more: Any) -> dict[str, Any]:
    """What a policy's file says about itself, plain data."""
    from train.checkpoints import worlds_of

    layout = worlds_of(model).layout
    return {
        "name": config.name,
        "about": config.about,
        "version": relloc_env.__version__,
        "commit": commit(),
        "made": datetime.now(UTC).strftime("%Y-%m-%d"),
        "observation": {**layout.to_dict(), "size": layout.size},
        "action": {"size": int(np.prod(model.action_space.shape or ())), "low": -1.0, "high": 1.0},
        "environments": [each.to_dict() for each in config.played],
        "configuration": config.to_dict(),
        **more,
    }


def commit() -> str:
    """The commit of the checkout that this runs from, `+` where files differ from it; empty outside of one."""

    def git(*arguments: str) -> str:
        command = ["git", *arguments]
        folder = Path(__file__).parent
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout.strip()  # noqa: S603 - fixed words

    return git("rev-parse", "--short=12", "HEAD") + ("+" if git("status", "--porcelain", "-uno") else "")


def save(model: BaseAlgorithm, about: dict[str, Any], path: Path) -> None:
    """Write NAME.json, and NAME.onnx where there can be one, each whole or not at all.

    Raises:
        NoOnnxError: as `to_onnx`; the card is written.
    """
    try:
        network = to_onnx(model).SerializeToString()
    except NoOnnxError:
        write_json(path.with_suffix(".json"), about)
        raise
    write_json(path.with_suffix(".json"), about | {DIGEST: digest(network)})
    write_whole(path, network)
