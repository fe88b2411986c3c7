"""A notebook that draws and shows no picture is a warning, and so fails the build."""

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.typing import ExtensionMetadata


def _look(_: Sphinx, doctree: nodes.document, page: str) -> None:
    draws = any("plt." in cell.astext() for cell in doctree.findall(nodes.literal_block))
    if page.startswith("notebooks/") and draws and not any(doctree.findall(nodes.image)):
        logging.getLogger(__name__).warning("this notebook draws, but shows no picture", location=page)


def setup(app: Sphinx) -> ExtensionMetadata:
    """Look at each page once its outputs are there."""
    app.connect("doctree-resolved", _look)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
