"""The directive `from-code`: tables that are read off the code when the site is built, so that they cannot drift.

    ```{from-code} observation relloc_env/RelativePose-v0
    (made from the code: see the built site, `make docs`)
    ```

Its argument is the name of a function in `TABLES`, then what that one takes. The line inside is for those who read the
source, or on a site that shows Markdown without directives.
"""

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import ExtensionMetadata

from docs._extensions.tables import TABLES


class FromCode(SphinxDirective):
    """Markdown that a function of `tables` returns, in place of the directive."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Write the table and parse it, as if it stood in the page."""
        name, *arguments = self.arguments[0].split()
        if name not in TABLES:
            raise self.error(f"must name one of {', '.join(TABLES)}, but is {name!r}")
        return self.parse_text_to_nodes(TABLES[name](*arguments), allow_section_headings=True)


def setup(app: Sphinx) -> ExtensionMetadata:
    """Make the directive known."""
    app.add_directive("from-code", FromCode)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
