"""Sizes of the project's code: `make house` prints them. A report, not a gate."""

import ast
import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
PACKAGES = ("relloc_env", "agents", "train", "benchmarks")
LONG_FILE, LONG_FUNCTION, MANY_ARGUMENTS = 300, 60, 8
"""Aims: lines of a file, lines of a function, arguments of a kernel."""
WORDS = {
    "door": r"\bdoors?\b",
    "bare": r"\bbare\b",
    "told": r"\btold\b",
    "sight, eyes": r"\b(?:sights?|eyes)\b",
    "place": r"\bplaces?\b",
    "for good": r"\bfor good\b",
    "way, ways": r"\bways?\b",
    "honest": r"\bhonest(?:y|ly)?\b",
    "spoilt": r"\bspoil(?:t|ed)\b",
}
"""Words for which the field has others and how they are found."""


class Function(NamedTuple):
    """A function as it stands in a file."""

    where: str
    lines: int
    arguments: int
    is_kernel: bool


def sources() -> dict[str, str]:
    """Text of every Python file of the packages, by its path in the project."""
    found = (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")))
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in found}


def functions(files: dict[str, str]) -> Iterator[Function]:
    """Every function of these files, methods and inner ones too."""
    for name, text in files.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                marks = {mark.id for mark in node.decorator_list if isinstance(mark, ast.Name)}
                arguments = len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs)
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                yield Function(f"{name}:{node.name}", lines, arguments, bool(marks & {"kernel", "inlined"}))


def rooms(files: dict[str, str]) -> Counter[str]:
    """Lines of every room: a folder of relloc_env, or a package."""
    found: Counter[str] = Counter()
    for name, text in files.items():
        parts = Path(name).parts
        room = "/".join(parts[:2]) if parts[0] == "relloc_env" and len(parts) > 2 else parts[0]
        found[room] += len(text.splitlines())
    return found


def exceptions() -> list[str]:
    """Imports that the contracts of import-linter pass over, but for those of optional packages."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    ignored = (each for contract in contracts for each in contract.get("ignore_imports", ()))
    return [each for each in ignored if each.partition(" -> ")[2].startswith("relloc_env")]


def circles() -> list[str]:
    """Rooms that the contracts let import each other: those in one layer, parted by a colon."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    return [layer for contract in contracts for layer in contract.get("layers", ()) if ":" in layer]


def words() -> Counter[str]:
    """How often code and documentation use the words that have a better one."""
    texts = [*sources().values(), *(path.read_text(encoding="utf-8") for path in pages())]
    return Counter(
        {word: sum(len(re.findall(form, text, re.IGNORECASE)) for text in texts) for word, form in WORDS.items()}
    )


def pages() -> list[Path]:
    """README, and the pages of the documentation."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def tables() -> Iterator[Table]:
    """What is printed."""
    files = sources()
    found = list(functions(files))
    kernels = [each for each in found if each.is_kernel]
    lengths = {name: len(text.splitlines()) for name, text in files.items()}
    yield _table("Lines of each room", rooms(files).most_common())
    long_files = [(name, n) for name, n in Counter(lengths).most_common() if n > LONG_FILE]
    yield _table(f"{len(long_files)} files above {LONG_FILE} lines", long_files)
    long_functions = sorted(((f.where, f.lines) for f in found if f.lines > LONG_FUNCTION), key=lambda row: -row[1])
    yield _table(f"{len(long_functions)} functions above {LONG_FUNCTION} lines", long_functions)
    wide = sorted(((f.where, f.arguments) for f in kernels if f.arguments > MANY_ARGUMENTS), key=lambda row: -row[1])
    yield _table(f"{len(wide)} of {len(kernels)} kernels with more than {MANY_ARGUMENTS} arguments", wide)
    yield _table("Rooms that may import each other, exceptions", [(each, 1) for each in [*circles(), *exceptions()]])
    yield _table("Words that have a better one, uses", words().most_common())


def _table(title: str, rows: list[tuple[str, int]]) -> Table:
    table = Table(title=title, title_justify="left", show_header=False, box=None)
    table.add_column(no_wrap=True)
    table.add_column(justify="right")
    for name, number in rows:
        table.add_row(name, f"{number:,}")
    return table


def main() -> None:
    """Print all of it."""
    console = Console()
    for table in tables():
        console.print(table)
        console.print()


if __name__ == "__main__":
    main()
