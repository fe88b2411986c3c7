"""Wrappers: estimator state around a bare environment; episodes written as logs (`RecordLog`)."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from relloc_env.config import ConfigError, validate
from relloc_env.envs.centralised import RellocEnv
from relloc_env.envs.information import Information
from relloc_env.envs.observation import observe, slices
from relloc_env.envs.onboard import Onboard
from relloc_env.envs.spaces import joint_slices, joint_space
from relloc_env.estimators.checks import check_finite, check_finite_prior
from relloc_env.estimators.own import is_estimator
from relloc_env.kernels.lanes import width_of
from relloc_env.recording import RecordLog
from relloc_env.samples import Estimate, Float32, Prior, copy_sample, empty_samples

__all__ = ["EstimateObservation", "RecordLog"]

_ROW = np.zeros(1, np.int64)


class EstimateObservation(gym.Wrapper[Any, Any, Any, Any]):
    """Run an estimator on what a bare environment shows, and show what the composed environment would.

    The bare environment (`estimator=None`, flat) shows the block of samples of each action. This wrapper feeds it to
    any estimator and gives the observation that the environment with that estimator inside gives, to the last bit.

    Args:
        env: a bare environment of this package.
        estimator: a name, a configuration, a class or function that makes one or its place
            (`relloc_env.estimators.OwnConfig`), or an object that follows `relloc_env.estimators.Estimator`.

    Raises:
        ConfigError: an environment that is not bare and flat, or an unknown estimator.
    """

    def __init__(self, env: gym.Env[Any, Any], estimator: Any = "map-alignment") -> None:
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, RellocEnv) or not inner.core.bare or inner.config.observation != "flat":
            raise ConfigError("Argument `env` must be a flat environment of relloc_env with `estimator=None`")
        own = estimator if is_estimator(estimator) else None
        # An estimator of the user's own is observed like any other: the built-in name only sets the layout.
        chosen = "cascade" if own is not None else estimator
        self._config = validate(
            type(inner.config), {**inner.config.model_dump(exclude_unset=True), "estimator": chosen}
        )
        self._onboard = Onboard(self._config, 1, own)
        self._told = Information(inner.core, ("prior",))  # also where `info` of the environment is without
        self._bare, self._full = slices(inner.config), slices(self._config)
        self._common = [name for name in self._full if name in self._bare and name != "message_points"]
        n, k, r, m = 1, self._config.samples_per_action, self._config.robots, self._config.targets
        pairs = len(self._onboard.pairs)
        self._samples, self._first = empty_samples(n, k, r, m, pairs), empty_samples(n, 1, r, m, pairs)
        self.observation_space = joint_space(self._config)
        self._lines: Float32 = np.zeros((1, r, self._full[next(reversed(self._full))].stop), np.float32)
        self._limits = np.array([self._config.max_cycles, self._config.sample_period])

    @property
    def estimate(self) -> Estimate:
        """What the estimator believes; arrays with a leading axis of one environment."""
        return self._onboard.estimate

    @property
    def field_slices(self) -> dict[str, slice]:
        """Where each named field is in the observation."""
        return joint_slices(self._config)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Float32, dict[str, Any]]:
        """Start an episode, and the estimator from what the robots are told (`prior/...` of `info`)."""
        observation, info = self.env.reset(seed=seed, options=dict(options) if options is not None else None)
        told = self._told.one(0)
        self._read(observation)
        copy_sample(self._samples, -1, self._first, 0, _ROW)
        self._first.period[:] = 0.0
        prior = Prior(
            told["prior/depth"][None], told["prior/pose"][None], float(told["prior/depth_sd"]), told["prior/pose_sd"]
        )
        check_finite_prior(prior, _ROW)
        self._onboard.reset(prior, self._first, _ROW)
        return self._show(observation, started=True), info

    def step(self, action: Any) -> tuple[Float32, float, bool, bool, dict[str, Any]]:
        """Act, and let the estimator take in the samples of the action."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._read(observation)
        self._onboard.update(self._samples, _ROW)
        return self._show(observation, started=False), float(reward), terminated, truncated, info

    def _read(self, observation: Float32) -> None:
        """Turn a bare observation back into samples."""
        samples, config = self._samples, self._config
        lines = observation.reshape(config.robots, -1)
        k, m, window = config.samples_per_action, config.targets, config.message_window
        samples.period[:] = config.sample_period
        ages = np.uint64(1) << np.arange(window, dtype=np.uint64)
        for r, line in enumerate(lines):
            samples.image[0, :, r] = line[self._bare["image"]].reshape(k, m, 2)
            samples.seen[0, :, r] = line[self._bare["seen"]].reshape(k, m) > 0.5
            samples.odometry[0, :, r] = line[self._bare["velocity"]].reshape(k, 3)
            own = np.flatnonzero(self._onboard.pairs[:, 0] == r)
            if own.size:
                arrived = line[self._bare["arrived"]].reshape(k, own.size, window) > 0.5
                samples.arrived[0][:, own] = (arrived * ages).sum(axis=2, dtype=np.uint64)
        check_finite(samples, _ROW)  # other wrappers may have changed what the environment shows

    def _show(self, observation: Float32, *, started: bool) -> Float32:
        """The composed observation: the bare one's fields as they are, and the estimator's."""
        robots = self._config.robots
        estimate = self._onboard.estimate
        shown = (
            self._lines, *self._samples, estimate.pose, estimate.pose_covariance, *self._onboard.messages,
            np.zeros(robots, np.bool_), np.zeros(robots, np.int64), np.zeros(2 * robots),
            np.array([0 if started else 1]), self._onboard.gains, self._onboard.pairs,
            self._limits, _ROW, False, width_of(1),
        )  # fmt: skip
        observe(*shown)
        bare = observation.reshape(robots, -1)
        for name in self._common:
            self._lines[0, :, self._full[name]] = bare[:, self._bare[name]]
        line: Float32 = self._lines[0].flatten()
        return line
