"""A second process that compiles: what it does, and when there is one."""

import json
import subprocess
from typing import Any

import pytest

from relloc_env.config import load_config
from relloc_env.envs import ahead
from relloc_env.envs.core import Core


class _Started:
    """Stands in for the other process."""

    found: list["_Started"]

    def __init__(self, command: list[str], env: dict[str, str], **_: Any) -> None:
        self.command, self.env, self.waited = command, env, False
        _Started.found.append(self)

    def wait(self, timeout: float) -> None:
        self.waited = timeout > 0.0

    def kill(self) -> None:
        pass


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[_Started]:
    """The processes that were started, where nothing was compiled before."""
    _Started.found = []
    monkeypatch.setattr(subprocess, "Popen", _Started)
    monkeypatch.setattr(ahead, "is_awaited", lambda _: True)
    monkeypatch.setattr(ahead, "cores", lambda: 2)
    monkeypatch.delenv(ahead.ALONE, raising=False)
    ahead._begun.cache_clear()
    return _Started.found


@pytest.mark.parametrize("estimator", ["cascade", "inverse-depth", "map-alignment", None])
def test_the_other_process_compiles_what_this_one_leaves(estimator: str | None) -> None:
    """Neither half may need an environment that was reset."""
    config = load_config({"estimator": estimator, "reward": {"excitation": 1.0}})
    ahead.help_out(json.dumps(config.to_dict()))
    Core(config).compile_the_rest()


def test_there_is_one_for_a_process_and_it_is_waited_for(started: list[_Started]) -> None:
    Core(load_config({"estimator": "cascade"}))
    Core(load_config({"estimator": "cascade"}))
    (other,) = started
    assert other.waited
    assert other.env[ahead.ALONE] == "1"  # it starts no other
    assert '"cascade"' in other.command[-1]


def test_there_is_none_where_that_is_not_wanted_or_no_help(
    started: list[_Started], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setenv(ahead.ALONE, "1")
        Core(load_config({"estimator": "cascade"}))
    with monkeypatch.context() as patch:
        patch.setattr(ahead, "cores", lambda: 1)
        Core(load_config({"estimator": "cascade"}))
    with monkeypatch.context() as patch:
        patch.setattr(ahead, "is_awaited", lambda _: False)
        Core(load_config({"estimator": "cascade"}))
    own = Core(load_config({"estimator": "cascade"}), 1).onboard.estimator
    started.clear()
    ahead._begun.cache_clear()
    Core(load_config({"estimator": "cascade"}), 1, own)
    assert not started
