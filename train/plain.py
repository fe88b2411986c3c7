"""State as arrays and JSON: a file of NumPy's that runs nothing when it is read."""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relloc_env.extras import extra
from relloc_env.files import whole

with extra("train"):
    import torch

TREE = "tree"
"""Entry of the file that says how the arrays belong together."""


def write(path: Path, state: Any) -> None:
    """Write nested mappings, lists and tuples of arrays, tensors, numbers and texts, whole or not at all.

    Raises:
        TypeError: anything else in it.
    """
    arrays: dict[str, NDArray[Any]] = {}
    tree = np.array(json.dumps(_plain(state, arrays)))
    with whole(path) as partial, partial.open("wb") as file:
        np.savez(file, **arrays, **{TREE: tree})  # type: ignore[arg-type]


def read(path: Path) -> Any:
    """Read what `write` wrote.

    Raises:
        ValueError: a file that is damaged, or another.
    """
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = dict(file)
        return _alive(json.loads(str(arrays[TREE])), arrays)
    except Exception as error:  # damage raises anything: of zip, numpy, JSON, or for what is missing
        raise ValueError(f"{path} is damaged, or none of this version ({type(error).__name__}: {error})") from error


def _plain(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """What JSON has: numbers and texts as they are, all else as a list that begins with its kind."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, torch.Tensor | np.ndarray | np.generic):
        name = f"a{len(arrays)}"
        arrays[name] = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
        if arrays[name].dtype.hasobject:
            raise TypeError(f"Argument `state` must hold numbers, but has an array of {arrays[name].dtype}")
        kind = "tensor" if isinstance(value, torch.Tensor) else "scalar" if isinstance(value, np.generic) else "array"
        return [kind, name]
    if isinstance(value, Mapping):
        return ["mapping", [[_plain(key, arrays), _plain(each, arrays)] for key, each in value.items()]]
    if isinstance(value, list | tuple):
        return ["list" if isinstance(value, list) else "tuple", [_plain(each, arrays) for each in value]]
    raise TypeError(f"Argument `state` must hold arrays, numbers and texts, but has {type(value).__name__}")


def _alive(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """From what `_plain` gave."""
    if not isinstance(value, list):
        return value
    kind, inside = value
    if kind == "mapping":
        return {_alive(key, arrays): _alive(each, arrays) for key, each in inside}
    if kind in ("list", "tuple"):
        return {"list": list, "tuple": tuple}[kind](_alive(each, arrays) for each in inside)
    array = arrays[inside]
    if kind == "tensor":
        return torch.from_numpy(array.copy())
    return array[()] if kind == "scalar" else array
