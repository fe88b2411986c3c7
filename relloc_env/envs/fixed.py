"""Environments stay as they were made: what is set on one later takes effect, or is refused."""

import inspect
from typing import Any, ClassVar

from relloc_env.config import ConfigError, EnvConfig
from relloc_env.simulation import OPTIONS


class FixedError(AttributeError, ConfigError):
    """An attribute of an environment that cannot be set."""


class Fixed:
    """Refuses, once `_fix` was called, to have options or parts of an environment set: nothing would look at them.

    Attributes of other names may be set as on any object.
    """

    _fixed: frozenset[str] = frozenset()
    MAY_BE_SET: ClassVar[frozenset[str]] = frozenset({"agents", "copy", "metadata", "reset_infos", "spec", "timesteps"})
    """Public attributes that are looked at wherever they matter."""

    def _fix(self) -> None:
        """Take what there is now for what the environment was made with."""
        kind = type(self)
        parts = {name for name in dir(kind) if _is_read_only(getattr(kind, name, None))}
        parts |= {name for name in vars(self) if not name.startswith("_")}
        self._fixed = frozenset(parts | set(EnvConfig.model_fields)) - self.MAY_BE_SET

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute, if that can have an effect.

        Raises:
            FixedError: an option, or a part that other parts were made for.
        """
        if name in self._fixed:
            raise FixedError(self.refusal(name), name=name, obj=self)
        super().__setattr__(name, value)

    def refusal(self, name: str) -> str:
        """Say why an attribute cannot be set, and what to do instead."""
        what = f"`{name}` of an environment is fixed when it is made, and cannot be set"
        options = name in EnvConfig.model_fields
        if name in OPTIONS:
            return f"{what}: give it to `reset`, `options={{{name!r}: ...}}`"
        if not options and name not in inspect.signature(type(self).__init__).parameters:
            return what
        varied = "; options that change while one trains: `stages` of `relloc_env.envs.varied.VariedVecEnv`"
        return f"{what}: make another with `{name}=...`{varied if options else ''}"


def _is_read_only(thing: object) -> bool:
    return isinstance(thing, property) and thing.fset is None
