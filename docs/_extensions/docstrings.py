"""Docstrings as autodoc takes them: the headings of environments, and absolute values, which are no substitutions."""

import re
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata


def _mend(app: Sphinx, kind: str, name: str, thing: object, options: Any, lines: list[str]) -> None:  # noqa: ARG001
    lines[:] = [mended for line in lines for mended in _lines(line)]


def _lines(line: str) -> list[str]:
    if line.startswith("## "):
        return [f".. rubric:: {line[3:]}", ""]
    return [re.sub(r"\|(\w+)\|", r"\\|\1\\|", line)]


def setup(app: Sphinx) -> ExtensionMetadata:
    """Connect before napoleon, whose priority is 500."""
    app.connect("autodoc-process-docstring", _mend, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
