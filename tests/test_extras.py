"""Optional packages: every import of one names the extra that brings it, and that extra does."""

import ast
import os
import re
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from relloc_env.extras import MissingExtraError, extra

ROOT = Path(__file__).parents[1]
FOLDERS = ("relloc_env", "agents", "train", "benchmarks")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
DISTRIBUTIONS = {
    "PIL": "pillow", "cv2": "opencv-python-headless", "jax": "jaxmarl", "llvmlite": "numba", "markupsafe": "jinja2",
    "pydantic_core": "pydantic", "pygame": "pygame-ce", "rerun": "rerun-sdk", "yaml": "pyyaml",
}  # fmt: skip
"""What brings a package, where that has another name; `torch` comes with vmas too."""


def _brought_by(name: str) -> set[str]:
    """Distributions that an extra brings, those of extras in it too."""
    found = set()
    for line in PROJECT["optional-dependencies"][name]:
        inner = re.fullmatch(r"relloc-env\[(.*)\]", line)
        if inner is None:
            found.add(re.split(r"[<>=!~; \[]", line)[0])
        else:
            found |= set().union(*map(_brought_by, inner[1].split(",")))
    return found | ({"torch"} if "vmas" in found else set())


CORE = {re.split(r"[<>=!~; \[]", line)[0] for line in PROJECT["dependencies"]}


def _imports(tree: ast.AST, extras: str | None = None) -> Iterator[tuple[str, str | None]]:
    """Packages that code imports when it runs, and the extra that is named around each."""
    for node in ast.iter_child_nodes(tree):
        named = extras
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if isinstance(node, ast.With):
            for item in node.items:
                call = item.context_expr
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "extra":
                    named = ast.literal_eval(call.args[0])
        if isinstance(node, ast.Import):
            yield from ((alias.name.partition(".")[0], named) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0], named
        yield from _imports(node, named)


def _optional() -> dict[tuple[str, str | None], list[str]]:
    """Files by the optional package that they import and the extra that they name for it."""
    found: dict[tuple[str, str | None], list[str]] = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for package, named in _imports(ast.parse(path.read_text("utf-8"))):
                known = package in sys.stdlib_module_names or package in FOLDERS
                if not known and DISTRIBUTIONS.get(package, package).replace("_", "-") not in CORE:
                    found.setdefault((package, named), []).append(path.relative_to(ROOT).as_posix())
    return found


OPTIONAL = _optional()


@pytest.mark.parametrize(("package", "named"), OPTIONAL)
def test_imports_of_optional_packages_name_an_extra_that_brings_them(package: str, named: str | None) -> None:
    assert named is not None, f"{package} is imported outside of `with extra(...)` in {OPTIONAL[package, named]}"
    assert DISTRIBUTIONS.get(package, package).replace("_", "-") in _brought_by(named)


def test_the_search_finds_what_is_known_to_be_optional() -> None:
    wanted = {
        "pygame",
        "matplotlib",
        "PIL",
        "imageio_ffmpeg",
        "cv2",
        "rerun",
        "onnxruntime",
        "scipy",
        "jinja2",
        "torch",
    }
    wanted |= {"optuna", "gtsam", "mpe2", "stable_baselines3", "sb3_contrib", "onnx", "vmas", "jaxmarl"}
    assert wanted <= {package for package, _ in OPTIONAL}


BLOCK = """
import importlib, sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == PACKAGE:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
import numpy as np
from relloc_env.extras import MissingExtraError

def told(call):
    try:
        call()
    except MissingExtraError as error:
        assert isinstance(error, ModuleNotFoundError)
        assert error.name.partition(".")[0] == PACKAGE
        print(error)
    else:
        print("nothing is missing")
"""
USES = {
    "pygame": """
        from relloc_env.envs.centralised import RellocEnv
        for mode in ("rgb_array", "human"):
            def use():
                env = RellocEnv(estimator="cascade", render_mode=mode)
                env.reset(seed=0)
                env.render()
            told(use)
        from relloc_env.play import Session, play
        told(lambda: play(Session(estimator="cascade")))
    """,
    "PIL": """
        from relloc_env.rendering import save_animation
        told(lambda: save_animation([np.zeros((8, 8, 3), np.uint8)], "never.gif"))
    """,
    "imageio_ffmpeg": """
        from relloc_env.rendering import save_animation
        told(lambda: save_animation([np.zeros((8, 8, 3), np.uint8)], "never.mp4"))
    """,
    "cv2": """
        import relloc_env
        told(lambda: relloc_env.parallel_env(camera="image"))
        told(lambda: relloc_env.parallel_env(camera="image", marker={"kind": "tag"}))
    """,
    "rerun": """
        from relloc_env.rendering.rerun_file import RerunFile
        told(lambda: RerunFile("never.rrd"))
    """,
    "onnxruntime": """
        from agents.policy import Task
        from agents.registry import agent
        from relloc_env.envs.centralised import RellocEnv
        told(lambda: agent("learned:relative-pose")(Task.of(RellocEnv(estimator="map-alignment"))))
    """,
    "gtsam": "told(lambda: importlib.import_module('benchmarks.map_graph'))",
    "mpe2": "from benchmarks.peers import mpe2; told(lambda: mpe2(1))",
    "optuna": "told(lambda: importlib.import_module('train.tune'))",
    "torch": "told(lambda: importlib.import_module('train.run'))",
    "stable_baselines3": """
        told(lambda: importlib.import_module("relloc_env.envs.sb3"))
        told(lambda: importlib.import_module("relloc_env.envs.varied"))
        told(lambda: importlib.import_module("train.run"))
    """,
    "scipy": "told(lambda: importlib.import_module('agents.report'))",
    "jinja2": "told(lambda: importlib.import_module('agents.report'))",
    "matplotlib": """
        told(lambda: importlib.import_module("agents.report"))
        told(lambda: importlib.import_module("agents.demo"))
        told(lambda: importlib.import_module("relloc_env.paper.figures"))
    """,
}
"""What meets a missing package, in a fresh interpreter."""


@pytest.mark.parametrize("package", USES)
def test_who_lacks_a_package_is_told_what_to_install(package: str) -> None:
    code = BLOCK.replace("PACKAGE", repr(package)) + textwrap.dedent(USES[package])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT,
        env={**os.environ, "SDL_VIDEODRIVER": "dummy"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == USES[package].count("told(") + ("for mode" in USES[package])
    for line in lines:
        found = re.fullmatch(
            r"The package `(\w+)` is missing: pip install 'relloc-env\[(\w+)\]', or in a checkout "
            r"pip install -e '\.\[(\w+)\]'",
            line,
        )
        assert found is not None, line
        assert found[1] == package
        assert found[2] == found[3]
        assert DISTRIBUTIONS.get(package, package).replace("_", "-") in _brought_by(found[2])


@pytest.mark.parametrize("code", ["import relloc_env.nothing", "from train import nothing", "import agents.absent"])
def test_other_errors_are_left_alone(code: str) -> None:
    with pytest.raises(ImportError) as caught, extra("render"):
        exec(code)
    assert not isinstance(caught.value, MissingExtraError)
