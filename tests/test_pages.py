"""The pages hold what they promise: links lead somewhere, blocks of code run, worked examples are the program's."""

import importlib
import inspect
import os
import re
import subprocess
import sys

import pytest

import cli
from cachesim.clock.parameters import PRESETS
from cachesim.policies import described
from tests.pages import PAGES, ROOT, RUN, SHOWN, Session, bad_links, parse_page, read_page

NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
#: Pages with figures of small examples, which need no scene: cog can check them anywhere.
WORKED = [name for name in NAMES if "import worked" in (ROOT / name).read_text(encoding="utf-8")]


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_somewhere(name):
    assert bad_links(ROOT / name) == []


@pytest.mark.parametrize("name", NAMES)
def test_every_block_runs_or_says_why_not(name):
    for block in read_page(ROOT / name).blocks:
        where = f"{name}:{block.line}"
        assert block.language in (*RUN, *SHOWN), f"{where}: a block of {block.language or 'no language'}"
        assert block.language != "console" or block.is_made, f"{where}: what a command prints must be written by cog"
        assert not (block.reason and block.language not in RUN), f"{where}: such a block never runs and needs no reason"


@pytest.mark.parametrize("name", [name for name in NAMES if any(b.language in RUN for b in read_page(ROOT / name).blocks)])
def test_blocks_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NPTRACE_SCENES", raising=False)
    session = Session(tmp_path)
    for block in read_page(ROOT / name).blocks:
        if block.language in RUN and not block.reason:
            session.run(block)


def test_worked_examples_are_what_the_program_prints():
    assert "docs/metrics.md" in WORKED
    environment = {name: value for name, value in os.environ.items() if name != "NPTRACE_SCENES"}
    done = subprocess.run(
        [sys.executable, "-m", "cogapp", "--check", "--diff", *WORKED],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_reader_of_pages():
    text = """# One: a *heading*

See [this](#one-a-heading), [that](other.md#x "title") and ![a picture](a.png).

## Two

<!-- not run: it downloads -->
```sh
echo 1
```

    indented

<!-- [[[cog
figures.f(cog)
]]] -->
```console
$ made
```
<!-- [[[end]]] -->

## Two

<img src="b.png">
"""
    page = parse_page(text)
    assert page.anchors == {"one-a-heading", "two", "two-1"}
    assert [link for link, _ in page.links] == ["#one-a-heading", "other.md#x", "a.png", "b.png"]
    assert [(b.language, b.reason, b.is_made) for b in page.blocks] == [
        ("sh", "it downloads", False), ("", "", False), ("console", "", True),
    ]  # fmt: skip


def test_links_that_lead_nowhere_are_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.pages.ROOT", tmp_path)
    (tmp_path / "other.md").write_text("# There\n")
    page = tmp_path / "page.md"
    page.write_text(
        "# Here\n[a](#here) [b](#gone) [c](other.md#there) [d](other.md#here) [e](none.md) [f](../x.md) ![g](no.png)\n"
    )
    assert bad_links(page) == [
        "page.md:2: page.md has no heading #gone", "page.md:2: other.md has no heading #here",
        "page.md:2: there is no none.md", "page.md:2: there is no ../x.md", "page.md:2: there is no no.png",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text", ["nptrace render nothing.obj", "nptrace info | false", "SELECT 1 WHERE 1 = 2", "assert 1 == 2"]
)
def test_a_block_that_fails_is_noticed(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    language = "sql" if "SELECT" in text else "python" if "assert" in text else "sh"
    (block,) = parse_page(f"```{language}\n{text}\n```\n").blocks
    with pytest.raises(AssertionError):
        Session(tmp_path).run(block)


@pytest.fixture(scope="module")
def site():
    """The settings of the site, and what it says of the program."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs")
        yield importlib.import_module("conf"), importlib.import_module("reference")


def test_the_reference_has_every_option_and_every_list(site):
    text = site[1].commands()
    for program in (cli.nptrace, cli.npcache):
        for name in program.commands:
            section = text.partition(f"\n## {program.name} {name}\n")[2].partition("\n## ")[0]
            command = program.commands[name]
            options = [option for each in command.params for option in each.opts if option.startswith("-")]
            assert len(options) > 3
            assert [option for option in options if option not in section] == [], f"{program.name} {name}"
    for each in described().values():
        assert f"`{each.form}`" in text
    for machine in PRESETS:
        assert f"- `{machine}`: " in text


def test_the_reference_has_every_public_name(site):
    text = site[1].public_names()
    for package in site[1].PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            assert re.search(rf"auto\w+:: {package}\.{name}$|^- `{name}`", text, re.MULTILINE)
            assert inspect.getdoc(getattr(module, name)) or name == "__version__", f"{package}.{name} has no docstring"


def test_every_page_is_in_the_menu_of_the_site(site):
    listed = [site[0].root_doc, *(page for pages in site[0].MENU.values() for page in pages)]
    assert sorted(f"{page}.md" for page in listed) == NAMES
