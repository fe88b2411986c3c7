"""Pages whose text is a file at the root of the repository, or a part of it: what a page is replaced by on the site.

On GitHub the page itself is read, which links to the file.
"""

import re
from pathlib import Path
from typing import NamedTuple

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

ROOT = Path(__file__).resolve().parents[2]


class Part(NamedTuple):
    """A part of a file: from one heading on, up to another one."""

    file: str
    start: str = ""
    stop: str = ""


PAGES = {
    "changelog": Part("CHANGELOG.md"),
    "contributing": Part("CONTRIBUTING.md", stop="\n## Dependencies"),
    "security": Part("SECURITY.md"),
    "dependencies": Part("CONTRIBUTING.md", start="\n## Dependencies"),
}


def _link(match: re.Match[str]) -> str:
    """Link of a file at the root, as seen from docs/."""
    target = match[1]
    pages = {part.file: name for name, part in reversed(PAGES.items())}
    if "://" in target or target.startswith("#"):
        return match[0]
    if target in pages:
        return f"]({pages[target]}.md)"
    return f"]({target.removeprefix('docs/')})" if target.startswith("docs/") else f"](../{target})"


def _take_in(app: Sphinx, page: str, source: list[str]) -> None:
    if page in PAGES:
        app.env.note_dependency(str(ROOT / PAGES[page].file))
        source[0] = text_of(page)


def text_of(page: str) -> str:
    """Text of a page, with links as seen from docs/."""
    part = PAGES[page]
    text = (ROOT / part.file).read_text("utf-8")
    if part.start:
        text = part.start.lstrip("\n").replace("##", "#") + text.split(part.start, 1)[1]
    if part.stop:
        text = text.split(part.stop, 1)[0]
    return re.sub(r"\]\(([^)\s]+)\)", _link, text)


def setup(app: Sphinx) -> ExtensionMetadata:
    """Connect to the reading of each page."""
    app.connect("source-read", _take_in)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
