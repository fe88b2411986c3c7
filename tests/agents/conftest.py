"""Suites that are over in a second, and the agent that the docs show."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from agents.benchmark import benchmark
from agents.jobs import Asked
from relloc_env import scenarios

ROOT = Path(__file__).resolve().parents[2]
TINY = {
    "tiny": scenarios.Suite("tiny", "twelve actions", ({"max_cycles": 12},)),
    "split": scenarios.Suite("split", "two and three points", tuple({"max_cycles": 6, "targets": m} for m in (2, 3))),
}
EPISODES = 8


@contextmanager
def tiny() -> Iterator[None]:
    """Suites `tiny` and `split` beside the others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenarios, "SUITES", {**scenarios.SUITES, **TINY})
        yield


@pytest.fixture
def tiny_suites() -> Iterator[None]:
    """See `tiny`."""
    with tiny():
        yield


@pytest.fixture(scope="session")
def shown_agent(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Where the example of docs/agents.md is: `path/to/my_agent.py:MyAgent`."""
    text = (ROOT / "docs/agents.md").read_text("utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    (code,) = [block for block in blocks if "class MyAgent" in block]
    path = tmp_path_factory.mktemp("own") / "my_agent.py"
    path.write_text(code, "utf-8")
    return f"{path}:MyAgent"


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory, shown_agent: str) -> Callable[[str], Path]:
    """Folders of results of a tiny benchmark, by id."""
    made: dict[str, Path] = {}

    def folder(env: str) -> Path:
        if env not in made:
            made[env] = tmp_path_factory.mktemp("results")
            asked = Asked(
                f"relloc_env/{env}", ("tiny", "split"), ("straight", "circle", "edge", shown_agent),
                ("cascade", "cascade-critical"), EPISODES, "validation",
            )  # fmt: skip
            with tiny():
                benchmark(asked, made[env], cores=1)
        return made[env]

    return folder
