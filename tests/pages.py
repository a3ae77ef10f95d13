"""The Markdown pages -> their links, their anchors and their blocks of code; and a session that runs the blocks of a page.

Every block says its language. Those of ``RUN`` run, in the order of the page, in one folder. A block that cannot run has a
comment before it, ``<!-- not run: the reason -->``. What commands print is a ``console`` block, which cog writes.
"""

import io
import os
import re
import shlex
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

import duckdb
from click.testing import CliRunner
from markdown_it import MarkdownIt

import cli

ROOT = Path(cli.__file__).resolve().parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), ROOT / "traces" / "README.md"])

#: Languages of blocks that run.
RUN = ("sh", "sql", "python")
#: Those of blocks that show something: a drawing or a text; what a command prints, inside a block of cog's.
SHOWN = ("text", "console")

_REASON = re.compile(r"<!-- not run: (.+?) -->", re.DOTALL)
_SHELL = re.compile(r"[|<>&;$()*`~]")
_PROGRAMS = {"nptrace": cli.nptrace, "npcache": cli.npcache}


class Block(NamedTuple):
    """A block of code: its language, its text, where it is, why it does not run ('' if it does)."""

    language: str
    text: str
    line: int
    reason: str
    is_made: bool  # by cog


class Page(NamedTuple):
    """What a page has."""

    links: list[tuple[str, int]]  # with the line of each
    anchors: set[str]
    blocks: list[Block]


def read_page(path: Path) -> Page:
    """Return the links, anchors and blocks of a page."""
    return parse_page(path.read_text(encoding="utf-8"))


def parse_page(text: str) -> Page:
    """Return what a text in Markdown has."""
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    page, taken, before, is_made = Page([], set(), []), {}, "", False
    for i, token in enumerate(tokens):
        line = token.map[0] + 1 if token.map else 0
        if token.type == "html_block":
            is_made = (is_made or "[[[cog" in token.content) and "[[[end]]]" not in token.content
            before = token.content
            page.links.extend((link, line) for link in re.findall(r'(?:src|href)="([^"]+)"', token.content))
            continue
        if token.type in ("fence", "code_block"):
            reason = _REASON.search(before)
            language = token.info.strip() if token.type == "fence" else ""
            page.blocks.append(Block(language, token.content, line, reason[1] if reason else "", is_made))
        elif token.type == "heading_open":
            slug = _slug(tokens[i + 1].content)
            taken[slug] = taken.get(slug, -1) + 1
            page.anchors.add(f"{slug}-{taken[slug]}" if taken[slug] else slug)
        elif token.type == "inline":
            for child in token.children or []:
                link = child.attrGet("href") or child.attrGet("src")
                if link:
                    page.links.append((str(link), line))
        before = ""
    return page


def _slug(heading: str) -> str:
    """Return the anchor that GitHub and MyST make of a heading."""
    return re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()).replace(" ", "-")


def bad_links(path: Path) -> list[str]:
    """Return a sentence for each relative link of a page that leads nowhere."""
    found = []
    for link, line in read_page(path).links:
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = unquote(link).partition("#")
        target = (path.parent / file).resolve() if file else path
        if not target.exists() or not target.is_relative_to(ROOT):
            found.append(f"{path.name}:{line}: there is no {link}")
        elif anchor and anchor not in read_page(target).anchors:
            found.append(f"{path.name}:{line}: {target.name} has no heading #{anchor}")
    return found


class Session:
    """Runs blocks one after the other: files stay in ``folder``, names of Python in ``names``."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.names = folder, {"__name__": "page"}

    def run(self, block: Block) -> None:
        """Run a block; AssertionError or the block's own error if it fails."""
        getattr(self, f"_{block.language}")(block.text)

    def _sh(self, text: str) -> None:
        if "<<" in text:
            self._bash(text)
            return
        for line in text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words and words[0] in _PROGRAMS and not _SHELL.search(" ".join(words)):
                done = CliRunner().invoke(_PROGRAMS[words[0]], words[1:], catch_exceptions=False)
                assert done.exit_code == 0, f"{line}\n{done.output}"
            elif words:
                self._bash(line)

    def _bash(self, text: str) -> None:
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text], cwd=self.folder, env={**os.environ, "PATH": path},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, f"{text}\n{done.stdout}{done.stderr}"

    def _sql(self, text: str) -> None:
        assert duckdb.sql(text).fetchall(), f"no rows of\n{text}"

    def _python(self, text: str) -> None:
        with redirect_stdout(io.StringIO()):
            exec(compile(text, "<block>", "exec"), self.names)
