"""Every file, module, command and name of ours that the documentation names is there."""

import functools
import importlib
import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
import typer

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted({*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - {ROOT / "CHANGELOG.md"})  # it names what is gone
ROOMS = ("relloc_env", "agents", "train", "benchmarks")
FOLDERS = (*ROOMS, "docs", "tests", ".ci")
SUFFIXES = "py|md|toml|txt|yaml|yml|json|csv|npz|npy|onnx|cff|css|png|svg|mp4|webp|gif|rrd|html|pt|zip|pkl|dat|sqlite"
FILE = re.compile(rf"[\w*{{}},./-]*[\w*}}]\.(?:{SUFFIXES})")
DOTTED = re.compile(rf"(?:{'|'.join(ROOMS)})(?:\.\w+)+")
COMMAND = re.compile(rf"python -m ({'|'.join(ROOMS)})(?: +([a-z][\w-]*))?")
ELSEWHERE = {"my_agent.py", "file.py", "policy.json", "SUITE--AGENT--ESTIMATOR.npz", "out/docs/index.html"}
"""Files that readers are to think of as their own, names with parts to fill in, and what Sphinx writes."""


def spans(text: str) -> list[str]:
    """What stands between backticks in running text."""
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE)
    return [re.sub(r"\s+", " ", span) for span in re.findall(r"(?<!`)`([^`]+)`(?!`)", prose)]


@functools.cache
def sources() -> str:
    return "\n".join(path.read_text("utf-8") for room in ROOMS for path in (ROOT / room).rglob("*.py"))


@functools.cache
def basenames() -> frozenset[str]:
    return frozenset(path.name for folder in FOLDERS for path in (ROOT / folder).rglob("*")) | {
        path.name for path in ROOT.iterdir()
    }


def is_there(name: str, page: Path) -> bool:
    """Whether a file is in the project, or one that the code speaks of: what it writes or reads."""
    first, *rest = name.split("/")
    if rest and first in FOLDERS:
        return any(ROOT.glob(name))
    last = (rest or [first])[-1].partition("*")[0]
    return (page.parent / name).exists() or last in basenames() or last in sources()


@functools.cache
def commands(room: str) -> frozenset[str]:
    """Commands of `python -m ROOM`."""
    app = importlib.import_module(f"{room}.__main__").app
    return frozenset(getattr(typer.main.get_command(app), "commands", ()))


def named(dotted: str) -> Any:
    """What a dotted name leads to."""
    parts = dotted.split(".")
    for k in range(len(parts), 0, -1):
        module = ".".join(parts[:k])
        try:
            found = importlib.util.find_spec(module)
        except ModuleNotFoundError:
            found = None
        if found is not None:
            return functools.reduce(attribute, parts[k:], importlib.import_module(module))
    raise AttributeError(dotted)


def attribute(owner: Any, name: str) -> Any:
    """An attribute, or a field of a class that has it with each object alone."""
    if name in getattr(owner, "__annotations__", ()) or name in getattr(owner, "model_fields", ()):
        return None
    return getattr(owner, name)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text("utf-8")
    gone = []
    for span in spans(text):
        if FILE.fullmatch(span) and span not in ELSEWHERE and not is_there(span, page):
            gone.append(span)
        elif dotted := re.match(rf"{DOTTED.pattern}(?=$|[(:\s])", span):
            try:
                named(dotted[0])
            except AttributeError:
                gone.append(span)
    gone += [
        match[0]
        for match in COMMAND.finditer(re.sub(r"\s+", " ", text))
        if match[2] is not None and commands(match[1]) and match[2] not in commands(match[1])
    ]
    assert gone == []


def test_what_is_not_there_is_found() -> None:
    page = ROOT / "README.md"
    assert not is_there("relloc_env/envs/ahead.py", page)
    assert not is_there("nowhere.json", page)
    with pytest.raises(AttributeError):
        named("relloc_env.envs.nothing")
    with pytest.raises(AttributeError):
        named("relloc_env.config.EnvConfig.nothing")
    assert "fly" not in commands("agents")
