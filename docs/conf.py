"""The documentation site: `make docs` builds it into out/docs. Each setting that is not obvious has its reason."""

import hashlib
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])  # for the notebooks' kernels
os.environ.pop("MPLBACKEND", None)  # the notebooks' kernels show their figures on the page, unless told otherwise
os.environ["RELLOC_QUIET"] = "1"  # nobody waits for the notebooks' kernels to compile

import relloc_env  # noqa: E402 - found where this checkout is

project = "relloc_env"
author = "The relloc-env authors"
project_copyright = author
version = release = relloc_env.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "docs._extensions.docstrings",
    "docs._extensions.from_code",
    "docs._extensions.from_root",
    "docs._extensions.mathml",
    "docs._extensions.shown",
]
exclude_patterns = ["images", "_*"]
default_role = "code"  # one backtick in a docstring means what it does in Markdown
nitpicky = True
# There is no network where this is built, so no inventory of other projects: only our own names must be found.
nitpick_ignore_regex = [("py:.*", r"(?!relloc_env\.|agents\.).*")]

myst_enable_extensions = ["attrs_block", "colon_fence", "dollarmath"]
myst_heading_anchors = 4  # links to headings are GitHub's

# Executed again where the code of a notebook or of the packages has changed, or what is set above.
_sources = sorted(
    [Path(__file__)] + [path for room in ("relloc_env", "agents", "train") for path in (ROOT / room).rglob("*.py")]
)
_digest = hashlib.sha256(b"".join(path.read_bytes() for path in _sources)).hexdigest()[:16]
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / ".cache" / "notebooks" / _digest)
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # of a cell: the first may have to compile kernels, on a slow machine
nb_merge_streams = True

viewcode_follow_imported_members = False  # a function that is shown under a shorter name would be linked to nowhere
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"relloc_env {release}"
html_static_path = ["_static"]
html_css_files = ["relloc.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
suppress_warnings = ["myst.header"]  # a level of headings left out harms nobody
copybutton_prompt_text = "$ "
