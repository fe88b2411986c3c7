"""Compiled kernels are cached until a source of any kernel changes, and nothing about the cache is an error.

Fresh processes run a package of two kernels, one of which calls the other in another file.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import relloc_env.kernels._compile as compile_module

KERNELS = {
    "__init__.py": "",
    "kernels/__init__.py": "",
    "kernels/inner.py": """
from relloc_env.kernels._compile import inlined

@inlined
def inner(x):
    return x + 1
""",
    "outer.py": """
from relloc_env.kernels._compile import kernel
from relloc_env.kernels.inner import inner

@kernel
def outer(x):
    return 10 * inner(x)
""",
}
RUN = "from relloc_env.outer import outer; print(outer(1), sum(outer.stats.cache_hits.values()))"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    root = tmp_path / "relloc_env"
    for name, text in KERNELS.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    shutil.copy(compile_module.__file__, root / "kernels")
    return root


def run(package: Path, **variables: str) -> tuple[int, bool, str]:
    """(result, whether it was loaded from the cache, stderr) in a fresh process."""
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", compile_module.QUIET)}
    environment |= {"PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    done = subprocess.run(
        [sys.executable, "-c", RUN], cwd=package.parent, env=environment, capture_output=True, text=True, check=True
    )
    value, hits = done.stdout.split()
    return int(value), hits == "1", done.stderr


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*.nb?"))


def test_compiles_once_and_says_so_until_a_callee_changes(package: Path) -> None:
    value, cached, said = run(package)
    assert (value, cached) == (20, False)
    assert said.count("relloc_env: compiling") == said.count("\n") == 1
    kept = files(package)
    assert run(package) == (20, True, "")
    inner = package / "kernels" / "inner.py"
    inner.write_text("\n\n" + inner.read_text().replace("x + 1", "x + 2"))
    assert run(package, **{compile_module.QUIET: "1"}) == (30, False, "")
    assert files(package) == kept
    assert run(package) == (30, True, "")


def test_damaged_cache_is_compiled_anew(package: Path) -> None:
    run(package)
    for path in [*package.rglob("*.nbi"), *package.rglob("*.nbc")]:
        path.write_bytes(b"damaged")
    assert run(package)[:2] == (20, False)
    for path in package.rglob("*.nbc"):
        path.write_bytes(b"")
    assert run(package)[:2] == (20, False)
    assert run(package) == (20, True, "")


def test_cache_is_where_numba_is_told(package: Path, tmp_path: Path) -> None:
    run(package, NUMBA_CACHE_DIR=str(tmp_path / "missing" / "cache"))
    assert files(tmp_path / "missing")
    assert not files(package)
    assert run(package, NUMBA_CACHE_DIR=str(tmp_path / "missing" / "cache")) == (20, True, "")


def test_folders_that_cannot_be_written(package: Path, tmp_path: Path) -> None:
    """A file stands where each folder would be: beside the sources, then also where the user's cache is."""
    for folder in (package, package / "kernels"):
        (folder / "__pycache__").write_text("")
    home = {
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "user"),
        "NUMBA_CACHE_DIR": str(package / "outer.py"),
    }
    assert run(package, **home)[:2] == (20, False)
    assert run(package, **home) == (20, True, "")
    shutil.rmtree(tmp_path / "user")
    (tmp_path / "user").write_text("")
    value, cached, said = run(package, **home)
    assert (value, cached) == (20, False)
    assert said.startswith("relloc_env: compiling")


def test_a_kernel_is_a_part_of_those_that_call_it(package: Path) -> None:
    """Called by a kernel, it is not compiled, nor stored, on its own; called from Python, it is."""
    run(package)
    assert not any("inner" in name for name in files(package))
    value, _, _ = run(package)
    assert value == 20
    code = "from relloc_env.kernels.inner import inner; print(inner(1))"
    environment = os.environ | {"PYTHONPATH": str(package.parent)}
    called = subprocess.run(
        [sys.executable, "-c", code], cwd=package.parent, env=environment, capture_output=True, text=True, check=True
    )
    assert called.stdout.split() == ["2"]
