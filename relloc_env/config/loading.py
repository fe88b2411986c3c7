"""From what a user gives to a configuration: keywords, mappings, files, scenario names; errors in plain words."""

import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from relloc_env.config.models import ConfigError, EnvConfig, hint
from relloc_env.config.parts import KINDS, CameraConfig
from relloc_env.estimators.registry import resolve
from relloc_env.quantities import quoted

M = TypeVar("M", bound=BaseModel)


def validate(model: type[M], data: Any) -> M:
    """Build a configuration, or raise `ConfigError` with one line for each thing that is wrong."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(model, data, e) for e in error.errors())) from None


_TAGS = ("disc", "box", "cascade", "inverse-depth", "map-alignment", "own")
"""Parts of pydantic's paths that say which of several configurations was tried."""


def _explain(model: type[BaseModel], data: Any, error: Any) -> str:
    """One line for one of pydantic's errors, in the project's words."""
    *place, last = [str(part) for part in error["loc"] if not str(part).startswith("function-")] or [""]
    path = [*(part for part in place if part not in _TAGS), last]
    if path[:2] in (["robot", "0"], ["camera", "0"]) and not isinstance(data.get(path[0]), list | tuple):
        del path[1]  # one was given for all
    name = ".".join(path)
    if error["type"] == "extra_forbidden":
        return f"Unknown option `{name}`{hint(path[-1], _fields_at(model, path[:-1]))}"
    if error["type"] == "missing":
        return f"Argument `{name}` is missing"
    if error["type"] in ("union_tag_not_found", "union_tag_invalid"):
        choice = f"Argument `{name}.{error['ctx']['discriminator']}`".replace("'", "")
        if error["type"] == "union_tag_not_found":
            return f"{choice} must be given, but is missing"
        return f"{choice} must be one of {error['ctx']['expected_tags']}, but is {error['ctx']['tag']!r}"
    message = str(error["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")
    if message.startswith(("Argument", "Unknown")):
        return message
    what = f"Argument `{name}`" if name else "The configuration"
    shown = error["input"]
    tail = f", but is {quoted(shown)}" if "but" not in message and not isinstance(shown, Mapping) else ""
    return f"{what} {message}{tail}"


def _fields_at(model: type[BaseModel], path: list[str]) -> tuple[str, ...]:
    """Names of the options at a place in the configuration."""
    models: list[type[BaseModel]] = [model]
    for part in path:
        if not part.isdigit():
            models = [m for parent in models for m in _models(parent, part)] or models
    return tuple(name for m in models for name in m.model_fields) + (
        ("field_of_view",) if CameraConfig in models else ()
    )


def _models(parent: type[BaseModel], field: str) -> list[type[BaseModel]]:
    """Configurations that may stand in a field."""
    if field not in parent.model_fields:
        return []
    found: list[type[BaseModel]] = []
    todo: list[Any] = [parent.model_fields[field].annotation]
    while todo:
        kind = todo.pop()
        if isinstance(kind, type) and not isinstance(kind, types.GenericAlias) and issubclass(kind, BaseModel):
            found.append(kind)
        else:
            todo.extend(get_args(kind))
    return found


def read_file(path: str | Path) -> dict[str, Any]:
    """Read a YAML or JSON file with a mapping in it."""
    path = Path(path)
    if path.suffix not in (".yaml", ".yml", ".json"):
        raise ConfigError(f"Argument `config` must be a .yaml, .yml or .json file, but is {str(path)!r}")
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"Argument `config` must be a readable file, but {str(path)!r}: {error.strerror}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: no text, or a date that is none
        raise ConfigError(f"{path} must be YAML or JSON, but: {error}") from None
    if not isinstance(data, dict):
        raise ConfigError(f"{path} must hold a mapping, but holds {type(data).__name__}")
    return data


_CHOICES = {"estimator": "kind", "camera": "preset"}
"""Entries whose change makes the others of their mapping void."""


def put(data: dict[str, Any], path: str, value: Any) -> None:
    """Put a value at `path.to.field` of nested mappings, which are copied on the way.

    The name of a camera's kind or preset, or of an estimator, stands for a mapping: entries go into it, and it goes
    under entries that are there already; a mapping that has another preset or a kind of estimator is replaced.

    Raises:
        ConfigError: something on the way is neither a mapping nor such a name.
    """
    *parents, last = path.split(".")
    for k, part in enumerate(parents):
        inside = _in_full(part, data.get(part, {}))
        if not isinstance(inside, Mapping):
            place = ".".join(parents[: k + 1])
            raise ConfigError(f"Argument `{place}` must be a mapping for `{path}` to be set, but is {inside!r}")
        data[part] = dict(inside)
        data = data[part]
    data[last] = _under(last, data.get(last), value) if isinstance(value, str) else value


def _under(key: str, old: Any, name: str) -> Any:
    """Return what stands at `key` after `name` was put there: what it stands for, under the entries that are there."""
    old = _in_full(key, old)
    if key not in _CHOICES or not isinstance(old, Mapping):
        return name
    new = _in_full(key, name)
    if key == "camera" and "kind" in new:
        return {**old, **new}
    return name if _CHOICES[key] in old else {**new, **old}


def _in_full(key: str, value: Any) -> Any:
    """Return the mapping for which a name stands at `key`, or else the value."""
    if not isinstance(value, str) or key not in _CHOICES:
        return value
    if key == "camera":
        return {"kind" if value in KINDS else "preset": value}
    try:
        config = resolve(value)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    return {"kind": config.kind, **config.model_dump(mode="json", exclude_unset=True)}


def override(data: dict[str, Any], text: str) -> None:
    """Put one `path.to.field=value`, the value as YAML, into nested mappings, which are copied on the way.

    Raises:
        ConfigError: a text of another form.
    """
    path, equals, value = text.partition("=")
    if not equals or not path:
        raise ConfigError(f"Overrides must look like `path.to.field=value`, but one is {text!r}")
    try:
        put(data, path, yaml.safe_load(value))
    except yaml.YAMLError:
        raise ConfigError(f"The value of `{path}` must be YAML, but is {value!r}") from None


def merge(base: Mapping[str, Any], extra: Mapping[str, Any]) -> dict[str, Any]:
    """Put `extra` over `base`, mapping by mapping; a mapping goes over each entry of a list of robots or cameras."""
    out = dict(base)
    for one, other in (("field_of_view", "focal_length"), ("focal_length", "field_of_view")):
        if one in extra:
            out.pop(other, None)
    for key, value in extra.items():
        out[key] = _over(key, out.get(key), value)
    return out


def _over(key: str, old: Any, value: Any) -> Any:
    """Return what stands at `key` after `value` was put over `old`."""
    if key == "camera" and isinstance(value, str) and value in KINDS:
        value = {"kind": value}
    if not isinstance(value, Mapping):
        return value
    if key == "camera" or "kind" not in value:
        old = _in_full(key, old)
    if key in ("robot", "camera") and isinstance(old, list | tuple):
        return [_over(key, entry, value) for entry in old]
    choice = _CHOICES.get(key)
    if not isinstance(old, Mapping) or (choice in value and value[choice] != old.get(choice)):
        return value
    return merge(old, value)


TASKS = {"relloc_env/ActiveDepth-v0": 1, "relloc_env/RelativePose-v0": 2}
"""Ids of environments, and how many robots each has."""


def load_config(
    config: EnvConfig | Mapping[str, Any] | str | Path | None = None, *, task: str | None = None, **options: Any
) -> EnvConfig:
    """Build a configuration of an environment.

    Args:
        config: an `EnvConfig`, a mapping, a YAML or JSON file, the name of a scenario (`relloc_env.scenarios`), or None
            for the default task. A mapping or file may name the scenario it changes as `scenario`.
        task: the id of an environment (of `TASKS`), which says how many robots there are.
        **options: put over it; a mapping changes only the entries it names.

    Raises:
        ConfigError: an unknown option (with a suggestion), a value that cannot be, or robots that the id does not have.
    """
    from relloc_env.scenarios import scenario  # scenarios are built of configurations

    if isinstance(config, EnvConfig):
        data: dict[str, Any] = {k: v for k, v in config.model_dump().items() if k in config.model_fields_set}
        if "estimator" in data and config.estimator is not None:
            stated = config.estimator.model_dump(exclude_unset=True)
            data["estimator"] = {"kind": config.estimator.kind, **stated}  # a function stays the one it is
    elif isinstance(config, str) and not config.endswith((".yaml", ".yml", ".json")):
        data = {"scenario": config}
    elif isinstance(config, str | Path):
        data = read_file(config)
    elif config is None or isinstance(config, Mapping):
        data = dict(config or {})
    else:
        raise ConfigError(f"Argument `config` must be a mapping, a file or a name, but is {type(config).__name__}")
    if options.get("points") is not None and "targets" not in options:
        data.pop("targets", None)  # other points may be of another number
    data = merge(data, options)
    name = data.pop("scenario", None)
    if name is not None:
        data = merge(scenario(name), data)
    return validate(EnvConfig, data if task is None else _for_task(data, task))


def _for_task(data: dict[str, Any], task: str) -> dict[str, Any]:
    """Return the data with the number of robots of an id, or raise where another is stated."""
    if task not in TASKS:
        raise ConfigError(f"Argument `task` must be one of {', '.join(TASKS)}, but is {task!r}")
    robots = data.get("robots", TASKS[task])
    if robots != TASKS[task]:
        other = next((f"; `{name}` has so many" for name, count in TASKS.items() if count == robots), "")
        raise ConfigError(f"Argument `robots` must be {TASKS[task]} for `{task}`, but is {robots!r}{other}")
    return {**data, "robots": robots}
