"""The environments of a batch one by one: what `call`, `get_attr` and `set_attr` of a vector environment work on."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from relloc_env.config import EnvConfig
from relloc_env.envs.core import Core
from relloc_env.envs.door import state_space
from relloc_env.envs.fixed import FixedError
from relloc_env.envs.picture import Picture
from relloc_env.samples import Bool, Float32

if TYPE_CHECKING:
    from relloc_env.envs.vector import RellocVectorEnv


ALIKE = {
    "observation_space": "single_observation_space",
    "action_space": "single_action_space",
    **{name: name for name in ("config", "spec", "metadata", "render_mode", "field_slices")},
}
"""What every environment of a batch has alike, and the batch's name for it."""


class Batch(VectorEnv[Any, Any, Any]):
    """Gymnasium's access to each of N environments, as its `SyncVectorEnv` gives it."""

    core: Core
    _started: Bool
    _pictures: list[Picture]

    def __init__(self) -> None:
        self._members: dict[int, Member] = {}
        self._seeds: dict[int, int | None] = {}
        self._generators: dict[int, tuple[np.random.Generator, int]] = {}

    def member(self, index: int) -> "Member":
        """Environment `index` as an object, the same at each call."""
        if index not in self._members:
            self._members[index] = Member(cast("RellocVectorEnv", self), range(self.num_envs)[index])
        return self._members[index]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of each environment (`relloc_env.envs.member.Member`), or take an attribute.

        Returns:
            N results.
        """
        found = [getattr(self.member(n), name) for n in range(self.num_envs)]
        return tuple(each(*args, **kwargs) if callable(each) else each for each in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each environment: a list or tuple has one for each, anything else is for all.

        Raises:
            ValueError: another number of values than of environments.
            FixedError: what the environment has by its options.
        """
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"Argument `values` must have {self.num_envs} values, but has {len(each)}")
        for n, value in enumerate(each):
            setattr(self.member(n), name, value)

    @property  # type: ignore[override]
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """Of each environment, for wrappers to draw from; environments themselves draw from streams of their own."""
        return tuple(self.generator(n)[0] for n in range(self.num_envs))

    @np_random.setter
    def np_random(self, value: object) -> None:  # noqa: ARG002 - Gymnasium's form
        raise AttributeError("Attribute `np_random` cannot be set: `reset` with a seed starts it anew")

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Of each environment: the seed of its last `reset` that had one."""
        return tuple(self.generator(n)[1] for n in range(self.num_envs))

    def generator(self, index: int) -> tuple[np.random.Generator, int]:
        """`np_random` of environment `index`, and its seed."""
        if index not in self._generators:
            self._generators[index] = seeding.np_random(self._seeds.get(index))
        return self._generators[index]

    def _note_seeds(self, seeds: Mapping[int, int | None]) -> None:
        """Start `np_random` of some environments anew."""
        self._seeds.update(seeds)
        for n in seeds:
            self._generators.pop(n, None)

    def state_of(self, index: int) -> Float32:
        """The line of `state()` of environment `index`.

        Raises:
            ResetNeeded: before its first `reset`.
        """
        if not self._started[index]:
            raise ResetNeeded("Call `reset` before `state`: there is no episode yet")
        return self.core.state(index)

    def picture_of(self, index: int) -> NDArray[np.uint8] | None:
        """The picture of environment `index`, an RGB array (H, W, 3); None without a `render_mode`."""
        return self._pictures[index].render() if self._pictures else None


class Member:
    """One environment of a batch, with what `RellocEnv` has but `reset` and `step`: the batch moves as one.

    Attributes of the caller's own may be set.

    Attributes:
        index: of the environment.
    """

    _env: "RellocVectorEnv"
    index: int

    def __init__(self, env: "RellocVectorEnv", index: int) -> None:
        vars(self).update(_env=env, index=index)

    def __getattr__(self, name: str) -> Any:
        """Return what is alike for all: the attributes `ALIKE` of the batch."""
        if name in ALIKE:  # never `_env`: a copy asks for it before it has one
            return getattr(self._env, ALIKE[name])
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute of the caller's own.

        Raises:
            FixedError: what the environment has by its options.
        """
        built = name in EnvConfig.model_fields or name in ("index", "max_episode_steps")
        if built or name in ALIKE or name in vars(Member):
            raise FixedError(self._env.refusal(name), name=name, obj=self)
        super().__setattr__(name, value)

    @property
    def unwrapped(self) -> "Member":
        """Itself."""
        return self

    @property
    def state_space(self) -> spaces.Box:
        """Space of `state()`."""
        return state_space(self._env.core)

    @property
    def np_random(self) -> np.random.Generator:
        """As `Batch.np_random`."""
        return self._env.generator(self.index)[0]

    @property
    def np_random_seed(self) -> int:
        """As `Batch.np_random_seed`."""
        return self._env.generator(self.index)[1]

    def state(self) -> Float32:
        """The truth and every observation as one vector, for centralised critics; needs an episode."""
        return self._env.state_of(self.index)

    def get_state(self) -> dict[str, Any]:
        """Everything the environment remembers, to be put back with `set_state`."""
        return self._env.get_state(self.index)

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go on from a state that `get_state` of an environment of the same configuration gave, bit for bit."""
        self._env.set_state(state, self.index)

    def render(self) -> Any:
        """The picture of now, an RGB array (H, W, 3); None without a `render_mode`."""
        return self._env.picture_of(self.index)
