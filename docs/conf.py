"""Sphinx: the Markdown pages, the commands and the public names -> a site (``make site``)."""

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

import reference  # noqa: E402

project = "nptrace"
html_title = "nptrace"
root_doc = "README"
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/*.md", "traces/README.md"]
exclude_patterns = [".venv*", "build", "tests", "traces/*/**"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4  # links to headings as on GitHub
autodoc_typehints = "none"  # they are in the docstrings
smartquotes = False  # two hyphens begin an option
html_theme = "furo"  # fonts of the system: the pages need no network
html_copy_source = False
html_additional_pages = {"index": "index.html"}  # leads to README.html
templates_path = ["templates"]

#: The site's menu. A page that is in none of its lists makes the build fail.
MENU = {
    "Begin": ["docs/first-steps", "docs/your-scene", "docs/reading-a-run", "docs/storage", "docs/scale", "docs/python"],
    "Look up": ["docs/metrics", "docs/model", "docs/commands", "docs/api", "traces/README", "docs/glossary"],
    "Results": ["docs/table1", "docs/study", "docs/does-it-pay", "docs/speed-error", "docs/performance"],
    "Trust": ["docs/correctness", "docs/limits"],
    "Change it": ["docs/extending", "CONTRIBUTING", "docs/architecture", "CHANGELOG"],
}


def add_what_is_made(app: Any, page: str, source: list[str]) -> None:
    """Append the menu to the first page, and to the pages of references what the program says of itself."""
    if page == root_doc:
        for title, pages in MENU.items():
            source[0] += "\n```{toctree}\n:hidden:\n:caption: " + title + "\n\n" + "\n".join(pages) + "\n```\n"
    elif page == "docs/commands":
        source[0] += reference.commands()
    elif page == "docs/api":
        source[0] += reference.public_names()


def made_pages(*unused: Any) -> list[str]:
    """Return the pages that are read each time, for what they show changes without them."""
    return [root_doc, "docs/commands", "docs/api"]


def colons_of_properties(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Keep napoleon from taking what stands before a colon for the type."""
    if what == "property" and lines:
        lines[0] = lines[0].replace(": ", " – ")


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", add_what_is_made)
    app.connect("autodoc-process-docstring", colons_of_properties, priority=400)  # before napoleon
    app.connect("env-get-outdated", made_pages)
