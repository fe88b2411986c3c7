"""Options of a configuration in words: types with their ranges, defaults, and what is written under each."""

import types
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from sphinx.pycode import ModuleAnalyzer

_SIGNS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}


def meaning(model: type, name: str) -> str:
    """What is written under a field in the source, or nothing."""
    for owner in model.__mro__:
        if (owner.__qualname__, name) in _written(owner.__module__):
            return " ".join(_written(owner.__module__)[owner.__qualname__, name]).strip()
    return ""


@cache
def _written(module: str) -> dict[tuple[str, str], list[str]]:
    return {} if module == "builtins" else ModuleAnalyzer.for_module(module).find_attr_docs()


def models(start: type[BaseModel]) -> list[type[BaseModel]]:
    """A model and those it is made of, in the order in which they are met."""
    found = [start]
    for model in found:
        for field in model.model_fields.values():
            found += [inner for inner in _inside(field.annotation) if inner not in found]
    return found


def _inside(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _inside(part)]


def describe(annotation: Any, limits: Sequence[Any] = ()) -> str:
    """A type in words, with its range."""
    ranges = " and ".join(filter(None, map(_limit, limits)))
    return f"{_plain(annotation)} {ranges}".strip()


def _limit(limit: Any) -> str:
    if isinstance(limit, FieldInfo):
        return " and ".join(filter(None, map(_limit, limit.metadata)))
    bounds = (f"{sign} {getattr(limit, name):g}" for name, sign in _SIGNS.items() if hasattr(limit, name))
    return " and ".join(bounds)


def _plain(annotation: Any) -> str:
    origin, inside = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return describe(inside[0], inside[1:])
    if origin in (Union, types.UnionType):
        return " or ".join(map(_plain, inside))
    if origin is Literal:
        return " or ".join(f"`{value!r}`" for value in inside)
    if origin is tuple:
        if inside[-1] is Ellipsis:
            return f"list of {_plain(inside[0])}"
        return "(" + ", ".join(map(_plain, inside)) + ")"
    if origin is dict:
        return f"mapping of {_plain(inside[0])} to {_plain(inside[1])}"
    if annotation is types.NoneType:
        return "None"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"[{annotation.__name__}](/configuration.md#{annotation.__name__.lower()})"
    return getattr(annotation, "__name__", str(annotation))


def default(field: FieldInfo) -> str:
    """A default as it would be written."""
    if field.is_required():
        return "to be given"
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        return ""
    if isinstance(value, tuple) and len(value) == 1 and isinstance(value[0], BaseModel):
        value = value[0]
    if isinstance(value, BaseModel):
        preset = getattr(value, "preset", None)
        return f"`{preset!r}`" if preset else "its own"
    return f"`{value!r}`"
