"""TorchRL's collectors (and so BenchMARL's), where it is installed: specifications hold, infos are stacked."""

from typing import Any

import gymnasium as gym
import pytest

import relloc_env

pytest.importorskip("torchrl")
pytestmark = pytest.mark.filterwarnings("ignore")  # of its own making

SHORT: dict[str, Any] = {"estimator": "cascade", "max_cycles": 5}
PAIR = "relloc_env/RelativePose-v0"


@pytest.mark.parametrize("options", [{}, {"robots": 1}, {"observation": "dict"}, {"estimator": None}])
def test_agents(options: dict[str, Any]) -> None:
    from torchrl.envs import PettingZooWrapper, check_env_specs

    env = PettingZooWrapper(relloc_env.parallel_env(**{**SHORT, **options}))
    check_env_specs(env)
    played = env.rollout(12, break_when_any_done=False)
    assert played["next", "done"].flatten().int().tolist() == [0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0]
    robots = options.get("robots", 2)
    assert played["robot_a", "info", "truth/poses"].shape == (12, 1, robots, 3)


def test_agents_by_turns() -> None:
    from torchrl.envs import PettingZooWrapper, check_env_specs

    check_env_specs(PettingZooWrapper(relloc_env.env(**SHORT), use_mask=True))


@pytest.mark.parametrize("form", ["flat", "dict"])
def test_joint(form: str) -> None:
    from torchrl.envs import GymEnv, GymWrapper, check_env_specs

    check_env_specs(GymEnv(PAIR))
    env = GymWrapper(gym.make(PAIR, observation=form, **SHORT)).auto_register_info_dict()
    check_env_specs(env)
    assert env.rollout(3)["next", "prior/pose"].shape == (3, 2, 3)


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_batch(mode: str) -> None:
    from torchrl.envs import GymWrapper

    env = GymWrapper(gym.make_vec(PAIR, num_envs=3, autoreset_mode=mode, **SHORT))
    assert env.rollout(12, break_when_any_done=False)["next", "done"].sum().item() == 6
