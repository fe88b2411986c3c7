"""Print the lowest releases that `pyproject.toml` allows of what the core and the given extras need, for pip."""

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text("utf-8"))["project"]


def lowest(lines: list[str]) -> Iterator[str]:
    """`name==LOW` for each `name>=LOW` of the lines and of the extras that they name; markers are kept."""
    for line in lines:
        own = re.fullmatch(rf"{PROJECT['name']}\[(.+)\]", line)
        if own:
            for extra in own[1].split(","):
                yield from lowest(PROJECT["optional-dependencies"][extra])
        else:
            yield re.sub(r"^([\w.-]+)>=([\w.]+)(,[^;]*)?", r"\1==\2", line)


if __name__ == "__main__":
    extras = [f"{PROJECT['name']}[{extra}]" for extra in sys.argv[1:]]
    sys.stdout.write("\n".join(lowest([*PROJECT["dependencies"], *extras])) + "\n")
