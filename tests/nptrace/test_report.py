"""npcache report: the page holds the numbers that the commands print, loads nothing, and works in a browser."""

import base64
import importlib
import json
import re
import shlex
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from click.testing import CliRunner

import cli
from cachesim.report.page import COLUMNS, MOST_CELLS, blocks, shade
from tests.browser import Browser, installed

pytest.importorskip("vl_convert")

RUNS = ["traces/bunny-standin-kdtree-24x16", "traces/bunny-standin-bvh-24x16", "traces/blob-bvh"]
OPTIONS = ["--size", "1K,2K", "--ways", "1,2", "--miss", "90"]


def run(*args, code=0):
    result = CliRunner().invoke(cli.npcache, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A page about a scene of Table I as both trees, and another scene."""
    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("NPTRACE_SCENES", raising=False)
        for scene, *options in (["bunny"], ["blob", "--name", "blob", "--accel", "bvh"]):
            args = ["render", scene, *options, "--pixels", "24x16", "--offline"]
            result = CliRunner().invoke(cli.nptrace, args)
            assert result.exit_code == 0, result.output
        run("report", *RUNS, *OPTIONS, "-o", "page.html")
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


class Page(HTMLParser):
    """What is in a page: its JSON, its tables by id, and the addresses that it refers to."""

    def __init__(self, text):
        super().__init__()
        self.data, self.tables, self.addresses, self.styles, self.commands = None, {}, [], "", []
        self._inside = self._rows = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        of = dict(attrs)
        self.addresses += [of[name] for name in ("src", "href", "srcset", "action", "data", "poster") if name in of]
        self._inside = "data" if of.get("id") == "data" else tag
        if tag == "table":
            self._rows = self.tables[of["id"].removeprefix("table-")] = []
        if tag == "tr":
            self._rows.append([])
        if tag == "td":
            self._rows[-1].append(of["data-order"])
        self.styles += of.get("style", "")

    def handle_endtag(self, tag):
        self._inside = None

    def handle_data(self, text):
        if self._inside == "data":
            self.data = json.loads(text)
        elif self._inside == "style":
            self.styles += text
        elif self._inside == "code":
            self.commands.append(text)


@pytest.fixture(scope="module")
def page(folder):
    return Page((folder / "page.html").read_text(encoding="utf-8"))


def test_the_numbers_are_those_of_the_commands_that_the_page_names(page):
    printed = [shlex.split(command) for command in page.commands if command.endswith(" --json")]
    names = ["table1", "replay", "sweep", "levels", "compare"]
    assert len(printed) == len(names)
    for name, words in zip(names, printed, strict=True):
        rows = json.loads(run(*words[1:]).stdout)
        assert rows and page.data["results"][name] == rows, name


def test_the_tables_have_the_numbers_of_the_results(page):
    for name, columns in COLUMNS.items():
        lines = page.tables[name][1:]
        assert len(lines) == len(page.data["results"][name]) > 0
        for line, row in zip(lines, page.data["results"][name], strict=True):
            assert line[-len(columns) :] == ["" if row[key] is None else str(row[key]) for _, key, _ in columns]
    for line, row in zip(page.tables["table1"][1:], page.data["results"]["table1"], strict=True):
        assert line[3:6] == [str(row[key]) for key in ("demand_miss_rate_without", "paper_miss_rate", "paper_ratio")]


def test_the_command_of_the_page_makes_it_again(folder, page):
    words = shlex.split(page.commands[-1])
    assert words[:2] == ["npcache", "report"]
    run(*words[1:-1], "again.html")
    assert (folder / "again.html").read_bytes() == (folder / "page.html").read_bytes()


def test_the_heat_maps_have_the_counts_of_the_pixels(page):
    for n, run_ in enumerate(RUNS):
        rows = json.loads(run("replay", run_, "--by", "pixel", "--size", "1K", "--ways", "1", "--json").stdout)
        for heat, name in zip(page.data["heat"], ("demand_accesses", "demand_misses"), strict=True):
            found = np.frombuffer(zlib.decompress(base64.b64decode(heat["maps"][n]["data"])), "<u4")
            assert found.tolist() == [row[name] for row in rows]
            assert (heat["maps"][n]["width"], heat["maps"][n]["height"], heat["maps"][n]["side"]) == (24, 16, 1)


def test_a_large_map_is_shown_in_sums_of_squares():
    values = np.arange(3 * 600).reshape(3, 600)
    cells, side = blocks(values)
    assert side == 3 and cells.shape == (1, 200) and max(cells.shape) <= MOST_CELLS
    assert cells[0, 0] == values[:, :3].sum() and cells.sum() == values.sum()


def test_shades():
    assert [shade(each) for each in (0.04, 0.05, 0.2, 0.4, -0.04, -0.1, -0.3, -0.9)] == [
        "", "more1", "more2", "more3", "", "less1", "less2", "less3"
    ]  # fmt: skip


def test_the_distances_are_shares_and_end_in_a_curve_with_its_knees(page):
    for label in {row["label"] for row in page.data["distances"]}:
        shares = sum(row["share"] for row in page.data["distances"] if row["label"] == label)
        rates = [row["rate"] for row in page.data["curve"] if row["label"] == label]
        assert rates == sorted(rates, reverse=True)
        assert shares + rates[-1] == pytest.approx(1)  # what is left are first accesses
    assert any(row["is_knee"] for row in page.data["curve"])


def test_nothing_is_loaded(folder, page):
    assert all(address.startswith(("data:image/png;base64,", "data:,")) for address in page.addresses)
    assert "url(" not in page.styles and "@import" not in page.styles
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in text and "connect-src" not in text


def test_the_library_has_its_licence(folder, page):
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert "University of Washington Interactive Data Lab" in text and "Redistribution and use in source and binary" in text


def test_four_scenes_of_two_trees_stay_below_5_mb(folder, page):
    """By the numbers of 128 x 128 pixels, whose maps and pictures take far less than four bytes a pixel each."""
    text = (folder / "page.html").read_text(encoding="utf-8")
    library = max(re.findall(r"<script>(.*?)</script>", text, re.DOTALL), key=len)
    rest = len(text) - len(library)
    assert len(library) < 1_000_000
    assert len(library) + 8 * (rest / len(RUNS) + 3 * 4 * 128 * 128) < 5_000_000


def test_names_that_are_html_are_text(folder, monkeypatch):
    odd = folder / "odd <b>&"
    odd.mkdir(exist_ok=True)
    (folder / RUNS[2]).rename(odd / "x<i>")
    try:
        run("report", odd / "x<i>", "-o", "odd.html")
    finally:
        (odd / "x<i>").rename(folder / RUNS[2])
    text = (folder / "odd.html").read_text(encoding="utf-8")
    assert "x&lt;i&gt;" in text and "x<i>" not in text
    assert Page(text).data["runs"][0]["run"] == "x<i>"


def test_standard_output_and_the_last_line(folder):
    result = run("report", RUNS[2], "--size", "1K", "-o", "-")
    assert result.stdout.startswith("<!doctype html>") and result.stdout.endswith("</html>\n")
    assert re.search(r"^-: 1 run, 1\.\d MB in [\d.]+ s$", result.stderr, re.MULTILINE)
    assert "Table I" not in result.stdout


def test_missing_packages_are_known_before_any_work(folder, monkeypatch):
    def absent(name, *args):
        if name == "jinja2":
            return importlib
        raise ImportError(name)

    before = sorted(folder.rglob("*"))
    monkeypatch.setattr("nptrace.studies.replayed", None)
    monkeypatch.setattr("cachesim.report.pictures.importlib", type("Imports", (), {"import_module": staticmethod(absent)}))
    said = run("report", *RUNS, "-o", "x.html", code=2).stderr
    assert said.startswith(
        "Error: a report needs vl-convert-python, which is not installed; run: pip install vl-convert-python"
    )
    assert "uv tool install --with vl-convert-python nptrace" in said and "pipx inject nptrace vl-convert-python" in said
    assert sorted(folder.rglob("*")) == before


@pytest.fixture(scope="module")
def browser(folder):
    if installed() is None:
        pytest.skip("no Chromium is installed, so the page cannot be opened; apt-get install chromium")
    with Browser() as opened:
        opened.open(folder / "page.html")
        yield opened


def shown(browser, selector):
    return browser.evaluate(f"[...document.querySelectorAll('{selector}')].filter((each) => each.checkVisibility()).length")


def test_the_page_draws_all_and_complains_of_nothing(browser, page):
    n = browser.evaluate("[...document.querySelectorAll('[data-chart]')].filter((each) => each.querySelector('svg')).length")
    assert n == len(page.data["charts"]) == 6
    totals = browser.evaluate("[...document.querySelectorAll('.heat')].map((each) => Number(each.dataset.total))")
    accesses = [row["demand_accesses"] for row in page.data["results"]["replay"][:: len(page.data["results"]["replay"]) // 3]]
    assert totals[::2] == accesses
    assert browser.troubles == [] and browser.outside() == []


def test_the_switch_shows_one_tree_and_one_scene(browser, page):
    def choose(name, value):
        browser.evaluate(f"document.querySelector('input[name={name}][value=\"{value}\"]').click()")

    before = browser.evaluate("document.querySelector('#chart-levels').innerHTML.length")
    choose("tree", "bvh")
    browser.wait("document.documentElement.dataset.drawn === '/bvh'")
    assert shown(browser, "article") == 2
    n_rows = sum(row["tree"] == "bvh" for row in page.data["results"]["replay"])
    assert shown(browser, "#table-replay tbody tr") == n_rows < len(page.data["results"]["replay"])
    assert browser.evaluate("document.querySelector('#chart-levels').innerHTML.length") < before
    choose("scene", "bunny")
    browser.wait("document.documentElement.dataset.drawn === 'bunny/bvh'")
    assert shown(browser, "article") == 1 and shown(browser, ".nothing") == 0
    choose("scene", "blob")
    choose("tree", "kdtree")
    browser.wait("document.documentElement.dataset.drawn === 'blob/kdtree'")
    assert shown(browser, "article") == 0 and shown(browser, ".nothing") == 1
    choose("scene", "")
    choose("tree", "")
    browser.wait("document.documentElement.dataset.drawn === '/'")
    assert shown(browser, "article") == 3 and shown(browser, "[data-chart] svg") == len(page.data["charts"])
    assert browser.troubles == []


def test_a_table_sorts_both_ways(browser):
    column = 3
    read = f"[...document.querySelectorAll('#table-replay tbody tr')].map((row) => Number(row.cells[{column}].dataset.order))"
    click = f"document.querySelectorAll('#table-replay th button')[{column}].click()"
    before = browser.evaluate(read)
    browser.evaluate(click)
    assert browser.evaluate(read) == sorted(before, reverse=True) != before
    browser.evaluate(click)
    assert browser.evaluate(read) == sorted(before)
    assert browser.evaluate(f"document.querySelectorAll('#table-replay th')[{column}].ariaSort") == "ascending"


def test_a_key_moves_over_a_map_and_says_the_number(browser, page):
    browser.evaluate("document.querySelector('.heat').focus()")
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight", windowsVirtualKeyCode=39)
    packed = page.data["heat"][0]["maps"][0]["data"]
    value = np.frombuffer(zlib.decompress(base64.b64decode(packed)), "<u4").reshape(16, 24)[8, 13]
    assert browser.evaluate("document.querySelector('.value').textContent") == f"pixel 13, 8: {value} accesses"


def test_everything_that_is_not_text_has_one_and_every_control_a_name(browser):
    assert browser.evaluate(
        "[...document.querySelectorAll('img, canvas.heat, [data-chart]')]"
        ".every((each) => (each.alt || each.ariaLabel || '').length > 10)"
    )
    assert browser.evaluate("[...document.querySelectorAll('input')].every((each) => each.labels.length === 1)")
    assert browser.evaluate("[...document.querySelectorAll('button')].every((each) => each.textContent.trim())")


def test_dark_is_dark_and_light_is_light(browser):
    def brightness(selector, name):
        text = browser.evaluate(f"getComputedStyle(document.querySelector('{selector}')).{name}")
        return sum(map(int, re.findall(r"\d+", text)[:3])) / 3

    for scheme, is_dark in (("dark", True), ("light", False)):
        browser.scheme(scheme)
        colour = "#e7e9ec" if is_dark else "#1c1e21"
        browser.wait(f"document.querySelector('#chart-curves svg text')?.getAttribute('fill') === '{colour}'")
        assert (brightness("body", "backgroundColor") < 60) == is_dark
        assert (brightness("body", "color") > 180) == is_dark
    assert browser.troubles == []
