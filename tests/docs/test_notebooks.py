"""Notebooks of the documentation keep their pictures, whatever the shell says of matplotlib."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = """---
jupytext: {{text_representation: {{extension: .md, format_name: myst}}}}
kernelspec: {{display_name: Python 3, name: python3}}
---
# A page
```{{code-cell}} python
{code}
```
"""
CONF = """
import runpy

globals().update(runpy.run_path({conf!r}))
exclude_patterns, nb_execution_mode, extensions = [], "force", ["myst_nb", "docs._extensions.shown"]
html_static_path = []
"""
DRAWS = "%config InlineBackend.figure_formats = ['svg']\nimport matplotlib.pyplot as plt\nplt.plot([0, 1]);"
HIDES = "import matplotlib\nmatplotlib.use('agg')\n" + DRAWS


def build(folder: Path, code: str) -> tuple[str, str]:
    """(the page, what was said) of a site with one notebook, built with the settings of ours."""
    (folder / "notebooks").mkdir(parents=True)
    (folder / "notebooks" / "page.md").write_text(PAGE.format(code=code))
    (folder / "index.md").write_text("# Index\n```{toctree}\nnotebooks/page\n```\n")
    (folder / "conf.py").write_text(CONF.format(conf=str(ROOT / "docs" / "conf.py")))
    command = [sys.executable, "-m", "sphinx", "--quiet", str(folder), str(folder / "out")]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return (folder / "out" / "notebooks" / "page.html").read_text("utf-8"), run.stderr


def test_pictures_are_there_and_told_where_they_are_not(tmp_path: Path) -> None:
    page, said = build(tmp_path / "draws", DRAWS)
    assert "<img" in page, said
    assert "shows no picture" not in said
    page, said = build(tmp_path / "hides", HIDES)
    assert "this notebook draws, but shows no picture" in said
