"""The search for good sequences of actions, in worlds that can be tried out: the cross-entropy method.

Steering laws are tried first, then changes to the best sequence. R. Rubinstein, "The cross-entropy method for
combinatorial and continuous optimization", Methodology and Computing in Applied Probability 1, 1999; with each plan
started from the one before (model-predictive control).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from agents.laws import Laws
from relloc_env.config import EnvConfig
from relloc_env.envs.belief import BeliefModel
from relloc_env.samples import Float, Rows


@dataclass(frozen=True)
class SearchOptions:
    """How plans are made."""

    horizon: float = 6.0
    """[s] how far a plan looks."""
    knots: int = 5
    """in a plan, at least 2: changes to its actions are interpolated between them."""
    samples: int = 48
    """plans that are tried at a time."""
    iterations: int = 3
    """times that plans are drawn: first laws, then changes to the best of them."""
    every: float = 1.0
    """[s] between two plans."""
    mean_weight: float = 0.3
    """[-] weight in the objective of J's mean over the horizon; the rest is that of J at its end."""
    blocked_weight: float = 0.5
    """[nats] cost of a whole horizon in which the shield holds the robots."""


ELITE = 0.12
"""Share of the changes around which the next ones are drawn."""
SPREAD = (0.5, 0.1)
"""[-] first and least standard deviation of a knot."""
START = 0.8
"""[-] speed of the first plan."""


def interpolation(steps: int, knots: int) -> Float:
    """(steps, knots) shares of the knots in the action of each step; knots are spread evenly."""
    at = np.linspace(0.0, knots - 1.0, steps)
    low = np.minimum(at.astype(np.int64), knots - 2)
    basis = np.zeros((steps, knots))
    basis[np.arange(steps), low] = 1.0 - (at - low)
    basis[np.arange(steps), low + 1] = at - low
    return basis


class Search:
    """Plans for N environments at once, each tried in copies of its own world.

    Args:
        config: of the real environments.
        num_envs: number N of environments.
        seed: of what is drawn.
        options: see there.
        walls: whether walls and obstacles are known, and positions the real ones.
        threads: as for `RellocVectorEnv`.
    """

    def __init__(
        self,
        config: EnvConfig,
        num_envs: int,
        seed: int,
        options: SearchOptions,
        *,
        walls: bool = False,
        threads: int | None = 1,
    ) -> None:
        period = config.samples_per_action * config.sample_period
        self.options = options
        self.steps = max(1, round(options.horizon / period))
        self.every = max(1, round(options.every / period))
        self.now = BeliefModel(config, num_envs, 1, threads, walls=walls)
        self.tried = BeliefModel(config, num_envs, options.samples, threads, walls=walls)
        self._basis = interpolation(self.steps, options.knots)
        self._stream = np.random.default_rng(seed)
        self.plan: Float = np.zeros((num_envs, self.steps, config.robots, 2))
        """Actions of the plans, [-] (N, steps, R, 2)."""
        self._config = config

    def start(self, poses: Float, points: Float, rows: Rows) -> None:
        """Begin the episodes `rows`; see `BeliefModel.start`."""
        self.now.start(poses, points, rows)
        self.plan[rows] = 0.0
        self.plan[rows, ..., 0] = START

    def actions(self, done: Rows) -> Float:
        """Improve all plans, of which `done` (N,) steps have gone by; return their actions (N, steps, R, 2)."""
        options, count = self.options, len(self.plan)
        base, best_value = self._begun(done)
        mean = np.zeros((count, options.knots, *base.shape[2:]))
        spread, best = np.full(mean.shape, SPREAD[0]), mean
        few = max(2, round(ELITE * options.samples))
        for _ in range(options.iterations - 1):
            drawn = self._stream.standard_normal((count, options.samples, *mean.shape[1:]))
            changes = mean[:, None] + spread[:, None] * drawn
            changes[:, 0] = best
            value = self.value(base, changes)
            order = np.argsort(-value, axis=1)
            elite = np.take_along_axis(changes, order[:, :few, None, None, None], axis=1)
            mean, spread = elite.mean(axis=1), np.maximum(elite.std(axis=1), SPREAD[1])
            top = np.take_along_axis(value, order[:, :1], axis=1)[:, 0]
            best = np.where((top > best_value)[:, None, None, None], elite[:, 0], best)
            best_value = np.maximum(top, best_value)
        self.plan = np.clip(base + np.einsum("tk,nkrd->ntrd", self._basis, best), -1.0, 1.0)
        return self.plan

    def _begun(self, done: Rows) -> tuple[Float, Float]:
        """The best of the plans of before, moved on, and of laws: actions (N, steps, R, 2), and its value (N,)."""
        rows, samples = np.arange(len(self.plan)), self.options.samples
        before = self.plan[rows[:, None], np.minimum(np.arange(self.steps) + done[:, None], self.steps - 1)]
        laws = Laws(self._config, (len(rows), samples), self.steps, self._stream)
        kept: list[Float] = []

        def choose(k: int) -> Float:
            kept.append(laws.actions(k, self.tried.poses, self.tried.points))
            kept[k][:, 0] = before[:, k]
            return kept[k]

        value = self._played(choose)
        best = value.argmax(axis=1)
        return np.stack([actions[rows, best] for actions in kept], axis=1), value[rows, best]

    def value(self, base: Float, changes: Float) -> Float:
        """Objective (N, S) of actions (N, steps, R, 2) with changes (N, S, knots, R, 2)."""

        def choose(k: int) -> Float:
            actions: Float = base[:, None, k] + np.einsum("k,nskrd->nsrd", self._basis[k], changes)
            return np.clip(actions, -1.0, 1.0, out=actions)

        return self._played(choose)

    def _played(self, choose: Callable[[int], Float]) -> Float:
        """Objective (N, S) of what is chosen at each step, (N, S, R, 2)."""
        self.tried.branch(self.now)
        total, held = np.zeros((2, len(self.plan), self.options.samples))
        for k in range(self.steps):
            self.tried.step(choose(k))
            total += self.tried.information
            held += self.tried.blocked
        weight = self.options.mean_weight
        gained = weight * total / self.steps + (1.0 - weight) * self.tried.information
        return gained - self.options.blocked_weight * held / self.steps
