"""Files that are put in their places whole."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from relloc_env.files import read_json, whole, write_json, write_whole


def test_what_is_stopped_on_the_way_leaves_the_file_before_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    write_json(path, {"a": 1})

    def stopped() -> None:
        with whole(path) as partial:
            partial.write_text("{", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert path.read_text("utf-8") == '{\n "a": 1\n}\n'
    write_json(path, [])
    assert path.read_text("utf-8") == "[]\n"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_killed_writer_left_is_cleared_by_the_next_and_a_running_ones_is_not(tmp_path: Path) -> None:
    path = tmp_path / "card.json"
    killed = "import os, signal, sys; from relloc_env.files import whole\n"
    killed += "with whole(sys.argv[1]) as partial:\n    partial.touch()\n    os.kill(os.getpid(), signal.SIGKILL)"
    place = Path(__file__).parents[1]
    subprocess.run([sys.executable, "-c", killed, str(path)], cwd=place, check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".card.")
    running = tmp_path / f".card.{os.getppid()}.json"
    other = tmp_path / f".card.{left.name.split('.')[2]}.npz"
    for each in (running, other):
        each.touch()
    write_whole(path, b"{}")
    assert set(tmp_path.iterdir()) == {path, running, other}


def test_a_link_stays_and_leads_to_the_new_file(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link, path = tmp_path / "link.txt", tmp_path / "there" / "real.txt"
    path.touch()
    link.symlink_to(path)
    write_whole(link, "new")
    assert link.is_symlink()
    assert path.read_text("utf-8") == "new"


def test_what_is_no_file_is_written_to_as_it_is() -> None:
    write_whole(os.devnull, "gone")
    assert not Path(os.devnull).is_file()


@pytest.mark.parametrize("data", ["", "{", "[" * 100_000, "\x00", "\xff"])
def test_what_is_no_json_is_said_with_the_files_name(data: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.json"
    path.write_text(data, encoding="latin-1")
    with pytest.raises(ValueError, match=r"odd\.json must be JSON, but"):
        read_json(path)


PROJECT = Path(__file__).parents[1]
ROOMS = ("relloc_env", "agents", "train", "benchmarks", "docs/figures")
SOURCES = [path for room in ROOMS for path in (PROJECT / room).rglob("*.py")]
WRITERS = {"write_text", "write_bytes", "savefig", "savez", "savez_compressed", "savetxt", "write_frames", "to_csv"}
OPEN_FILES = {"partial", "buffer", "file"}
"""What a path inside `whole` is called, and what is written to there."""


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_every_file_is_put_in_place_whole(path: Path) -> None:
    """By the names of what writes: each has to be given the path that `whole` yields."""
    if path.name == "files.py":
        return
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        modes = [each.value for each in node.args if isinstance(each, ast.Constant)]
        if node.func.attr in WRITERS or (node.func.attr == "open" and any(str(mode)[:1] in "wx" for mode in modes)):
            names = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
            assert names & OPEN_FILES, f"{path.name}:{node.lineno}: {ast.unparse(node)}"
