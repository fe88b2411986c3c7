"""The native vector door: N environments in one batch, as Gymnasium's vector interface has them."""

import numbers
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from relloc_env.config import ConfigError, EnvConfig
from relloc_env.envs.door import (
    check_actions,
    check_options,
    check_render_mode,
    check_seeds,
    check_state,
    frames_per_second,
    fresh_seeds,
    open_core,
)
from relloc_env.envs.fixed import Fixed
from relloc_env.envs.information import ENTRIES, Information
from relloc_env.envs.member import Batch
from relloc_env.envs.picture import Picture
from relloc_env.envs.spaces import joint_action_space, joint_form, joint_slices, joint_space, many
from relloc_env.envs.specification import specify
from relloc_env.samples import Bool, Estimate, Float32, Rows

if TYPE_CHECKING:
    from relloc_env.envs.belief import BeliefModel

Seeds = int | Sequence[int | None] | NDArray[np.integer[Any]] | None
Which = NDArray[np.bool_] | NDArray[np.int64] | Sequence[int] | int | None
"""Environments of a batch: a mask (N,), indices (which may repeat), one index, or None for all."""


class RellocVectorEnv(Fixed, Batch):
    """N environments that step together; each is what `RellocEnv` with its seed is, to the last bit.

    Observations, actions, rewards, ends and `info` are those of `RellocEnv`, with a leading axis of N, in the form
    that Gymnasium's `SyncVectorEnv` gives them: also `final_obs` and `final_info`, and a mask `_name` beside each
    entry of `info`. Episodes are truncated at `max_cycles` inside. Options of a reset hold for later episodes too.

    Args:
        num_envs: number N of environments.
        config, estimator, options: as for `RellocEnv`.
        render_mode: None or "rgb_array".
        autoreset_mode: an `AutoresetMode` or its value: an environment that is over starts anew at the next step
            ("NextStep"), in the same one ("SameStep"), or when `reset` is given `options={"reset_mask": mask}`
            ("Disabled").
        info: which entries `info` has, of `relloc_env.envs.information.ENTRIES`; () is the fastest.
        copy: whether observations are fresh arrays; otherwise each call writes into those of the last one.
        threads: how many a large batch runs on, None for one a core; what comes out does not depend on it. An estimator
            of the user's own always runs on one.

    Raises:
        ConfigError: an unknown option, or a value that cannot be.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012 - Gymnasium's form

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | Mapping[str, Any] | str | Path | None = None,
        *,
        render_mode: str | None = None,
        estimator: Any = "default",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        info: Sequence[str] = ENTRIES,
        copy: bool = True,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__()
        self._pictures: list[Picture] = []  # Gymnasium closes what could not be made, too
        self._spec: EnvSpec | None = None
        self.core = open_core(config, num_envs, estimator, options, threads)
        self.num_envs, self._threads = num_envs, threads
        self.autoreset_mode = _check_mode(autoreset_mode)
        self.copy = copy
        self.render_mode = check_render_mode(render_mode, ("rgb_array",))
        rate = frames_per_second(self.core)
        self.metadata = {**self.metadata, "render_fps": rate, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = joint_space(self.config)
        self.single_action_space = joint_action_space(self.config)
        self.observation_space = many(self.single_observation_space, num_envs)
        self.action_space = many(self.single_action_space, num_envs)
        self._form = joint_form(self.config)
        self._information = Information(self.core, info)
        self._actions = np.zeros((num_envs, self.config.robots, self.config.action_size))
        self._started: Bool = np.zeros(num_envs, np.bool_)
        self._over: Bool = np.zeros(num_envs, np.bool_)
        self._waiting: Rows = np.zeros(0, np.int64)  # where `_over` is set
        self._ready = False  # whether all are started
        pictured = num_envs if self.render_mode else 0
        self._pictures = [Picture(self.core, self.render_mode, n) for n in range(pictured)]
        self._fix()

    @property
    def config(self) -> EnvConfig:
        """The configuration of all environments, complete."""
        return self.core.config

    @property
    def field_slices(self) -> dict[str, slice]:
        """Where each named field is in the flat observation of an environment."""
        return joint_slices(self.config)

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium made this; its `max_episode_steps` is the configuration's."""
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        self._spec = specify(value, self.config)

    def state(self) -> Float32:
        """The truth and every observation as one vector (N, S) per environment, for centralised critics.

        Raises:
            ResetNeeded: where an environment was never started.
        """
        if not self._started.all():
            raise ResetNeeded("Call `reset` before `state`: not all environments have an episode")
        return self.core.states()

    def reset(self, *, seed: Seeds = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: of environment 0, the others take the next ones; or one for each, None to go on with its streams.
            options: as for `RellocEnv.reset`, alike for all; and `reset_mask`, bool (N,): which environments start, if
                not all. A `reset_mask` alone leaves what other options have fixed as it is.

        Raises:
            ValueError: seeds or a mask that cannot be.
            ConfigError: options that cannot be.
        """
        seeds = check_seeds(seed, self.num_envs)
        rows, options = self._asked(options)
        ours = check_options(options)
        core = self.core
        core.simulation.fix(rows, ours)
        self._started[rows] = False
        self._ready = False
        seeded = np.array([n for n in rows.tolist() if seeds[n] is not None], np.int64)
        core.seed(seeded, [seeds[n] for n in seeded.tolist()])
        if self.copy:
            core.observation = core.observation.copy()
        core.reset(rows)
        self._started[rows] = True
        self._over[rows] = False
        self._note_seeds({n: seeds[n] for n in seeded.tolist()})
        self._settle()
        self._follow(rows)
        some = None if rows.size == self.num_envs else rows
        return self._form(core.observation), self._information.batch(some)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold one action [-] (N, R A) in each environment for `samples_per_action` samples.

        Raises:
            ResetNeeded: before the first `reset`; without autoreset also where an episode is over.
            ValueError: actions of another shape, or that are not finite.
        """
        if not self._ready:
            raise ResetNeeded("Call `reset` before `step`: not all environments have an episode")
        core, new = self.core, self._waiting
        if new.size and self.autoreset_mode is AutoresetMode.DISABLED:
            raise ResetNeeded(f"Call `reset` with a `reset_mask` before `step`: over are environments {new.tolist()}")
        check_actions("actions", actions, self._actions.reshape(self.num_envs, -1))
        if self.copy:
            core.observation = np.empty_like(core.observation)  # every line of it is written below
        if new.size:
            core.step(self._actions, np.flatnonzero(~self._over))
            self._restart(new)
        else:
            core.step(self._actions, core.everyone)
        rewards, terminated, truncated = core.joint_reward.copy(), core.terminated.copy(), core.truncated.copy()
        self._over = terminated | truncated
        self._waiting = np.flatnonzero(self._over)
        final: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._waiting.size:
            new = self._waiting
            final = self._final(new)
            self._restart(new)
            self._over = np.zeros(self.num_envs, np.bool_)
            self._waiting = new[:0]
        self._follow(new, moved=True)
        info = self._information.batch()
        return self._form(core.observation), rewards, terminated, truncated, final | info

    def _restart(self, rows: Rows) -> None:
        """Start the next episodes; where no start is found, `reset` is needed."""
        self._ready = False
        self.core.reset(rows)
        self._ready = True

    def _final(self, rows: Rows) -> dict[str, Any]:
        """What the environments `rows` showed at their end."""
        lines = self.core.observation[rows]
        shown = np.full(self.num_envs, None, object)
        for i, n in enumerate(rows.tolist()):
            shown[n] = self._form(lines[i])
        mask = self._over.copy()
        return {
            "final_obs": shown,
            "_final_obs": mask,
            "final_info": self._information.batch(rows),
            "_final_info": mask,
        }

    def _settle(self) -> None:
        self._waiting = np.flatnonzero(self._over)
        self._ready = bool(self._started.all())

    def _asked(self, options: Mapping[str, Any] | None) -> tuple[Rows, Mapping[str, Any] | None]:
        """Which environments a reset is for, and its other options."""
        if not isinstance(options, Mapping) or "reset_mask" not in options:
            return self.core.everyone, options
        mask = options["reset_mask"]
        if not isinstance(mask, np.ndarray) or mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            given = f"{mask.shape}, {mask.dtype}" if isinstance(mask, np.ndarray) else type(mask).__name__
            raise ValueError(
                f"Argument `options['reset_mask']` must be an array of ({self.num_envs},), bool, but is {given}"
            )
        if not mask.any():
            raise ValueError("Argument `options['reset_mask']` must be True somewhere, but is not")
        rest = {name: value for name, value in options.items() if name != "reset_mask"}
        return np.flatnonzero(mask), rest or None

    def _rows(self, which: Which) -> Rows:
        """Indices of the environments that are meant."""
        if which is None:
            return self.core.everyone
        given = np.atleast_1d(np.asarray(which))
        if given.dtype == np.bool_ and given.shape == (self.num_envs,):
            return np.flatnonzero(given)
        if given.dtype.kind in "iu" and given.ndim == 1 and np.all((given >= 0) & (given < self.num_envs)):
            return given.astype(np.int64)
        raise ValueError(
            f"Argument `which` must be a mask of ({self.num_envs},) or indices below {self.num_envs}, but is {which!r}"
        )

    def get_state(self, which: Which = None) -> dict[str, Any]:
        """Everything that some environments remember, to be put back with `set_state`; every array has them first."""
        rows = self._rows(which)
        return {"core": self.core.get_state(rows), "started": self._started[rows], "over": self._over[rows]}

    def set_state(self, state: Mapping[str, Any], which: Which = None) -> None:
        """Go on from a state of as many environments of the same configuration, bit for bit; the others stay.

        Random streams are part of it: environments that are given the same state go on alike. `reseed` parts them.

        Raises:
            ValueError: what no environment of this configuration gave, or for another number of environments.
        """
        rows = self._rows(which)
        check_state("state", state, self.get_state(np.zeros(0, np.int64)), len(rows))
        if self.copy:
            self.core.observation = self.core.observation.copy()
        self.core.set_state(state["core"], rows)
        self._started[rows], self._over[rows] = state["started"], state["over"]
        self._settle()
        self._follow(rows)

    def observations(self) -> Any:
        """What all environments show now, in fresh arrays: after `set_state` or `clone`, before the first step.

        Raises:
            ResetNeeded: where an environment was never started.
        """
        if not self._started.all():
            raise ResetNeeded("Call `reset` before `observations`: not all environments have an episode")
        return self._form(self.core.observation.copy())

    def reseed(self, seed: Seeds = None, which: Which = None) -> None:
        """Start the random streams of some environments anew, in mid-episode.

        Args:
            seed: of the first of them, the others take the next ones; or one for each; None for seeds from the
                operating system.
            which: the environments.
        """
        rows = self._rows(which)
        self.core.seed(rows, fresh_seeds(seed, len(rows)))

    def clone(self, index: int, copies: int, *, seed: Seeds = None, same_streams: bool = False) -> "RellocVectorEnv":
        """Branch one environment: a vector environment of `copies`, all in its state now.

        Args:
            index: of the environment, from 0.
            copies: how many.
            seed: of the copies' random streams, as for `reseed`; not used with `same_streams`.
            same_streams: whether the copies keep the random streams of the original instead, for exact replays.

        Raises:
            ValueError: an index that is no environment's, or a number of copies below 1.
            ConfigError: where the estimator is an object of the user's own, which cannot be built again.
        """
        for name, value, least, most in (("index", index, 0, self.num_envs - 1), ("copies", copies, 1, None)):
            integer = isinstance(value, numbers.Integral) and not isinstance(value, bool)
            if not integer or value < least or (most is not None and value > most):
                span = f"from {least} to {most}" if most is not None else f"of at least {least}"
                raise ValueError(f"Argument `{name}` must be an integer {span}, but is {value!r}")
        self.core.check_clonable()
        other = RellocVectorEnv(
            copies, self.config, render_mode=self.render_mode, autoreset_mode=self.autoreset_mode,
            info=self._information.entries, copy=self.copy, threads=self._threads,
        )  # fmt: skip
        other.set_state(self.get_state(np.full(copies, index)))
        if not same_streams:
            other.reseed(seed)
        return other

    def from_belief(self, estimate: Estimate, copies: int) -> "BeliefModel":
        """Branch what the robots believe: `copies` worlds for each environment, as an estimate has them.

        `clone` has the truth; these have robot A at the origin, the others and the points where they are believed to
        be, no walls or obstacles, and the estimate's covariances as the bound, without what ties them together.

        Args:
            estimate: of the N environments, such as `core.onboard.estimate`.
            copies: worlds of each.
        """
        from relloc_env.envs.belief import BeliefModel, believed_places

        if not isinstance(copies, numbers.Integral) or isinstance(copies, bool) or copies < 1:
            raise ValueError(f"Argument `copies` must be an integer of at least 1, but is {copies!r}")
        n, r, m = self.num_envs, self.config.robots, self.config.targets
        p = r * (r - 1)
        if not isinstance(estimate, Estimate):
            raise TypeError(f"Argument `estimate` must be an Estimate, but is {type(estimate).__name__}")
        for name, shape in (
            ("points", (n, r, m, 3)), ("points_covariance", (n, r, m, 3, 3)), ("known", (n, r, m)),
            ("pose", (n, p, 3)), ("pose_covariance", (n, p, 3, 3)),
        ):  # fmt: skip
            part = getattr(estimate, name)
            if part.shape != shape or not np.isfinite(part).all():
                raise ValueError(
                    f"Argument `estimate.{name}` must be finite, of {shape}, but is of {part.shape}"
                    + ("" if part.shape != shape else " with values that are not")
                )
        heights = np.array([self.config.camera_of(r).mount_height for r in range(self.config.robots)])
        model = BeliefModel(self.config, self.num_envs, int(copies), self._threads)
        model.start(*believed_places(estimate, heights), self.core.everyone)
        model.inform(estimate)
        return model

    def _follow(self, new: Rows, *, moved: bool = False) -> None:
        """Note where robots went, for pictures: an episode of `new` starts; the others have moved or not."""
        if self._pictures:
            starts = set(new.tolist())
            for n, picture in enumerate(self._pictures):
                if n in starts or moved:
                    picture.follow(new=n in starts)

    def render(self) -> tuple[Any, ...] | None:
        """The pictures of now, one RGB array (H, W, 3) per environment; None without a `render_mode`."""
        return tuple(picture.render() for picture in self._pictures) if self._pictures else None

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002 - Gymnasium's form
        """Let go of what pictures need."""
        for picture in self._pictures:
            picture.close()


def _check_mode(mode: object) -> AutoresetMode:
    """Return an autoreset mode, or raise where there is none of that name."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        names = ", ".join(repr(each.value) for each in AutoresetMode)
        raise ConfigError(f"Argument `autoreset_mode` must be one of {names}, but is {mode!r}") from None
