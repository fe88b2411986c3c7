"""Compiled kernels are cached until a source of any kernel changes, and nothing about the cache is an error.

Of several processes one compiles, the others wait and load, but never for ever. With a numba of another inside, kernels
are plain ones. Fresh processes run a package of two kernels, one of which calls the other in another file.
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
    for name in ("_compile.py", "_linking.py"):
        shutil.copy(Path(compile_module.__file__).with_name(name), root / "kernels")
    return root


def start(package: Path, code: str, **variables: str) -> "subprocess.Popen[str]":
    """A fresh process."""
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", compile_module.QUIET)}
    environment |= {"PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    command, pipe = [sys.executable, "-c", code], subprocess.PIPE
    return subprocess.Popen(
        command, cwd=package.parent, env=environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )


def run(package: Path, code: str = RUN, **variables: str) -> tuple[int, bool, str]:
    """(result, whether it was loaded from the cache, stderr) in a fresh process."""
    with start(package, code, **variables) as process:
        out, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    value, hits = out.split()
    return int(value), hits == "1", said


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


HOLD = """
import time
from relloc_env.outer import outer

def compile(*_):
    print("compiling", flush=True)
    time.sleep(600)

outer._compiler.compile = compile
outer(1)
"""
IMPATIENT = "import relloc_env.kernels._linking as linking; linking._PATIENCE = {}; " + RUN


@pytest.fixture
def holder(package: Path, tmp_path: Path):
    """A process that compiles a kernel, and does not come to an end."""
    with start(package, HOLD) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "compiling\n"
        yield process
        process.kill()


def test_of_four_processes_one_compiles(package: Path, tmp_path: Path) -> None:
    """All four are ready before the first may go on."""
    wait = "import sys, relloc_env.outer; print('ready', flush=True); input(); "
    four = [start(package, wait + RUN, NUMBA_CACHE_DIR=str(tmp_path / "cache")) for _ in range(4)]
    for process in four:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in four:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    assert sorted(process.communicate(timeout=60)[0] for process in four) == ["20 0\n", *(3 * ["20 1\n"])]


def test_a_process_does_not_wait_for_ever(package: Path, holder: "subprocess.Popen[str]") -> None:
    value, cached, said = run(package, IMPATIENT.format(0.1))
    assert (value, cached) == (20, False)
    assert said.startswith("relloc_env: compiling")


def test_a_killed_process_frees_its_turn(package: Path, holder: "subprocess.Popen[str]") -> None:
    with start(package, IMPATIENT.format(600.0)) as waiting:
        assert waiting.stderr is not None
        waiting.stderr.readline()  # it has said that it waits
        with pytest.raises(subprocess.TimeoutExpired):
            waiting.wait(timeout=1.0)
        holder.kill()
        assert waiting.communicate(timeout=60)[0] == "20 0\n"


def test_a_child_of_a_process_that_compiles_can_compile(package: Path) -> None:
    """A fork waits for the thread that compiles."""
    code = """
import multiprocessing, threading, time, warnings
from relloc_env.outer import outer

warnings.simplefilter("ignore")
compile, begun = outer._compiler.compile, threading.Event()

def slowly(*signature):
    begun.set()
    time.sleep(0.5)
    return compile(*signature)

outer._compiler.compile = slowly
threading.Thread(target=outer, args=(1,)).start()
begun.wait()
child = multiprocessing.get_context("fork").Process(target=outer, args=(1.0,))
child.start()
child.join(30)
print(outer(1), child.exitcode)
child.kill()
"""
    with start(package, code) as process:
        out, said = process.communicate(timeout=60)
    assert out.split() == ["20", "0"], said


def test_data_of_other_sources_are_never_taken(package: Path) -> None:
    """A process is killed after it wrote the index, before it wrote what belongs to it."""
    run(package)
    outer = package / "outer.py"
    outer.write_text("\n" + outer.read_text().replace("10 *", "100 *"))
    code = """
import os
from numba.core.caching import IndexDataCacheFile

IndexDataCacheFile._save_data = lambda *_: os._exit(0)
from relloc_env.outer import outer
outer(1)
"""
    with start(package, code) as process:
        process.communicate(timeout=60)
    assert run(package)[:2] == (200, False)
    assert run(package)[:2] == (200, True)


BROKEN = [
    "import numba.core.codegen as c; c.JITCodeLibrary = type('', (), {})",
    "import numba.core.caching as c, numba.core.ccallback; del c.NullCache",
    "import numba.core.caching as c; c.FunctionCache = type('', (c.NullCache,), {'__init__': lambda self, _: None})",
    "import numba.core.compiler as c; c.Compiler = type('', (c.Compiler,), {'__init__': lambda self, *library: None})",
    "import numba; numba.version_info = numba.version_info._replace(short=(99, 0))",
]
"""Changes that this version of numba itself stands."""


@pytest.mark.parametrize("change", BROKEN)
def test_another_inside_of_numba_gives_plain_kernels(package: Path, change: str) -> None:
    tell = "from relloc_env.kernels._compile import _linking, is_awaited; print(_linking(), is_awaited(outer))"
    code = f"{change}; {RUN.split(';', maxsplit=1)[0]}; print(outer(1)); {tell}"
    with start(package, code) as process:
        out, said = process.communicate(timeout=60)
    assert out.split() == ["20", "None", "False"], said
