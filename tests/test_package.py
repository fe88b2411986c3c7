"""The project around the code: what it imports, declares, pins, ships and documents."""

import ast
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import relloc_env

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def normal(name: str) -> str:
    """Return a distribution's name as package indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def declared() -> set[str]:
    lines = [*PROJECT["dependencies"], *(d for extra in PROJECT["optional-dependencies"].values() for d in extra)]
    return {normal(re.split(r"[\[<>=!~; ]", line)[0]) for line in lines} - {normal(PROJECT["name"])}


def test_kernels_import_numpy_numba_math_and_other_kernels_only() -> None:
    allowed = {"numpy", "numba", "math", "typing", "collections"}  # the last two for types of records alone
    for path in sorted((ROOT / "relloc_env" / "kernels").glob("[!_]*.py")):  # `_compile` deals with files
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            outside = [n for n in names if n.split(".")[0] not in allowed and not n.startswith("relloc_env.kernels")]
            assert outside == [], f"{path.name} imports {outside}"


def test_import_loads_neither_compiled_kernels_nor_optional_packages() -> None:
    heavy = {
        "numba",
        "torch",
        "stable_baselines3",
        "pygame",
        "matplotlib",
        "cv2",
        "pandas",
        "pyarrow",
        "imageio_ffmpeg",
        "PIL",
        "scipy",
    }
    code = "import sys, relloc_env; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert "relloc_env" in run.stdout.split()
    assert heavy & set(run.stdout.split()) == set()


def test_every_dependency_is_pinned_and_its_choice_explained() -> None:
    pinned = {normal(line.partition("==")[0]) for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines()}
    table = "\n".join(re.findall(r"^\| *([^|]+)\|", (ROOT / "CONTRIBUTING.md").read_text("utf-8"), re.MULTILINE))
    explained = {normal(word) for word in re.findall(r"[\w.-]+", table)}
    assert declared() - pinned == set()
    assert declared() - explained == set()


def test_pins_are_plain_releases() -> None:
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    odd = [line for line in lines if not re.fullmatch(r"#.*|[A-Za-z0-9._-]+==[0-9][0-9a-z.]*", line)]
    assert odd == []


def test_version_is_the_same_everywhere() -> None:
    citation = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert citation is not None
    assert citation.group(1) == PROJECT["version"] == relloc_env.__version__


def test_wheel_ships_the_package_alone(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    info = f"relloc_env-{PROJECT['version']}.dist-info"
    assert {name.split("/")[0] for name in names} == {"relloc_env", info}
    assert "relloc_env/py.typed" in names
    assert f"{info}/licenses/LICENSE" in names
    sources = {p.relative_to(ROOT).as_posix() for p in (ROOT / "relloc_env").rglob("*.py")}
    assert sources <= set(names)


def make(*arguments: str) -> str:
    """Return what `make` prints, unaffected by a `make` that these tests may run under."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    run = subprocess.run(["make", *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return run.stdout


def test_make_help_lists_every_task() -> None:
    tasks = re.findall(r"^\.PHONY: (.+)$", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)[0].split()
    assert [line.split()[1] for line in make("help").splitlines()] == tasks


def test_make_does_nothing_again_once_set_up() -> None:
    stamp = ROOT / ".venv" / ".dev"
    inputs = [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    if not stamp.exists() or any(p.stat().st_mtime > stamp.stat().st_mtime for p in inputs):
        pytest.skip("the present set-up was not made by `make`, or is out of date")
    assert "pip" not in make("--dry-run", "setup", "lint")
