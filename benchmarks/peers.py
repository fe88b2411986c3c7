"""Other environments, each set up the fastest way it offers and driven with random actions made in advance.

A set-up takes the number of environments and returns a drive: called, it steps all of them some times and returns how
often. Episodes last `HORIZON` steps wherever that can be chosen, so that nobody resets more often than the others. Two
agents each.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from relloc_env.extras import extra

HORIZON = 400
"""Steps of an episode."""
AGENTS = 2

Drive = Callable[[], int]
"""Steps all environments, returns how many times."""


def block(num_envs: int) -> int:
    """Steps that one call of a drive takes: enough to make the call's own time small."""
    return 64 if num_envs <= 512 else 8


def mpe2(num_envs: int) -> Drive:
    """MPE's simple spread, the PettingZoo environment in NumPy; one environment at a time is all there is."""
    with extra("peers"):
        from mpe2 import simple_spread_v3

    if num_envs != 1:
        raise ValueError(f"mpe2 has one environment at a time, not {num_envs}")
    env = simple_spread_v3.parallel_env(N=AGENTS, max_cycles=HORIZON)
    choices = np.random.default_rng(0).integers(0, 5, (block(1), AGENTS)).tolist()
    env.reset(seed=0)
    bank = [dict(zip(env.agents, row, strict=True)) for row in choices]

    def drive() -> int:
        for actions in bank:
            env.step(actions)
            if not env.agents:
                env.reset()
        return len(bank)

    return drive


def _vmas(scenario: str, num_envs: int) -> Drive:
    """VMAS, PyTorch on the processor. It resets no environment by itself: all of them at once, when time is up."""
    with extra("peers"):
        import torch
        from vmas import make_env

    env = make_env(scenario, num_envs, device="cpu", continuous_actions=True, seed=0, n_agents=AGENTS)
    drawn = 2.0 * torch.rand((block(num_envs), AGENTS, num_envs, 2), generator=torch.Generator().manual_seed(0)) - 1.0
    bank = [list(actions) for actions in drawn]
    env.reset()
    elapsed = 0

    def drive() -> int:
        nonlocal elapsed
        with torch.no_grad():
            for actions in bank:
                env.step(actions)
                elapsed += 1
                if elapsed == HORIZON:
                    env.reset()
                    elapsed = 0
        return len(bank)

    return drive


def vmas_navigation(num_envs: int) -> Drive:
    """VMAS's navigation: goals, collisions, a lidar on each agent."""
    return _vmas("navigation", num_envs)


def vmas_spread(num_envs: int) -> Drive:
    """VMAS's copy of MPE's simple spread."""
    return _vmas("simple_spread", num_envs)


def jaxmarl_spread(num_envs: int) -> Drive:
    """JaxMARL's MPE simple spread: alone step by step, as a policy outside of JAX would; a batch in one scan.

    The scan carries the observations, rewards and ends of the last step, so that XLA has to compute them in each.
    """
    with extra("peers"):
        import jax
        import jaxmarl

    env = jaxmarl.make("MPE_simple_spread_v3", num_agents=AGENTS, num_landmarks=AGENTS, max_steps=HORIZON)
    key, draw, start = jax.random.split(jax.random.key(0), 3)
    many, steps = num_envs > 1, block(num_envs)
    shape = (steps, num_envs) if many else (steps,)
    drawn = jax.random.randint(draw, (AGENTS, *shape), 0, 5)
    bank = dict(zip(env.agents, drawn, strict=True))

    def step(carry: Any, actions: Any) -> Any:
        key, state, *_ = carry
        key, now = jax.random.split(key)
        if many:
            found = jax.vmap(env.step)(jax.random.split(now, num_envs), state, actions)
        else:
            found = env.step(now, state, actions)
        observation, state, reward, done, _ = found
        return (key, state, observation, reward, done)

    observation, state = jax.vmap(env.reset)(jax.random.split(start, num_envs)) if many else env.reset(start)
    zero = np.zeros(shape[1:], np.float32)
    reward = dict.fromkeys(env.agents, jax.numpy.asarray(zero))
    done = dict.fromkeys([*env.agents, "__all__"], jax.numpy.asarray(zero > 0))
    carry = (key, state, observation, reward, done)
    single = jax.jit(step)
    whole = jax.jit(lambda carry: jax.lax.scan(lambda c, a: (step(c, a), None), carry, bank)[0])
    rows = [{agent: value[k] for agent, value in bank.items()} for k in range(steps)] if not many else []

    def drive() -> int:
        nonlocal carry
        if many:
            carry = jax.block_until_ready(whole(carry))
        for actions in rows:
            carry = jax.block_until_ready(single(carry, actions))
        return steps

    return drive


def cartpole(num_envs: int) -> Drive:
    """Gymnasium's own vector environment of CartPole, in NumPy: no robots, no contacts, no sensors."""
    import gymnasium as gym

    env = gym.make_vec("CartPole-v1", num_envs, vectorization_mode="vector_entry_point")
    bank = np.random.default_rng(0).integers(0, 2, (block(num_envs), num_envs))
    env.reset(seed=0)

    def drive() -> int:
        for actions in bank:
            env.step(actions)
        return len(bank)

    return drive
