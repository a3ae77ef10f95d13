"""nptrace view: the picture enlarged, and heat maps in the colours of the numbers that npcache replay --by pixel prints."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import cli
from cachesim.heat import KINDS as OF_HEAT
from cachesim.report.heat_figure import Scale, scale_of
from nptrace.commands.view import KINDS
from rtrace.scenes.shapes import icosphere
from tests.nptrace.test_nptrace import write_obj
from tests.reference.traces import make_trace, write

CACHE = ["--size", "1K", "--assoc", "2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two runs of 20 x 12 pixels, of both trees, and one of another size."""
    folder = tmp_path_factory.mktemp("view")
    write_obj(folder / "ball.obj", icosphere(3))
    for pixels in ("20x12", "8x8"):
        args = ["render", str(folder / "ball.obj"), "--pixels", pixels, "--out", str(folder / "traces")]
        assert CliRunner().invoke(cli.nptrace, args).exit_code == 0
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


KD, BVH, SMALL = (f"traces/ball-{name}" for name in ("kdtree-20x12", "bvh-20x12", "bvh-8x8"))


def view(*args, code=0):
    result = CliRunner().invoke(cli.nptrace, ["view", *args])
    assert result.exit_code == code, result.output
    return result


def dots(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def counted(run, name, *options):
    """Return a count of each pixel, as npcache replay --by pixel prints it."""
    result = CliRunner().invoke(cli.npcache, ["replay", run, *CACHE, "--by", "pixel", "--json", *options])
    found = np.zeros((12, 20), int)
    for row in json.loads(result.stdout):
        found[row["y"], row["x"]] = row[name]
    return found


def test_the_picture_is_enlarged_dot_by_dot():
    view(BVH, "--enlarge", "3", "-o", "x.png")
    np.testing.assert_array_equal(dots("x.png"), dots(f"{BVH}/image.png").repeat(3, 0).repeat(3, 1))
    view(BVH, "-o", "x.png")
    assert dots("x.png").shape == (25 * 12, 25 * 20, 3)


def test_without_o_the_file_has_the_name_of_the_run_and_none_is_replaced(folder):
    view(BVH)
    view(BVH, "--heat", "accesses")
    assert (folder / "ball-bvh-20x12.png").exists() and (folder / "ball-bvh-20x12-accesses.png").exists()
    result = view(BVH, code=2)
    assert "ball-bvh-20x12.png exists; write -o ball-bvh-20x12.png to replace it" in result.stderr


def colours(values, scale):
    matplotlib = pytest.importorskip("matplotlib")
    shares = (values - scale.least) / (scale.most - scale.least)
    return np.round(255 * matplotlib.colormaps[scale.colours](np.clip(shares, 0, 1))[..., :3]).astype(int)


def panels_in(image, maps, n):
    """Check that each map is in the image, in this order, each pixel as n x n dots of its colour; return their places."""
    found = []
    for wanted in maps:
        large = wanted.repeat(n, 0).repeat(n, 1)
        height, width = large.shape[:2]
        places = [
            (y, x)
            for y in range(image.shape[0] - height + 1)
            for x in range(image.shape[1] - width + 1)
            if (np.abs(image[y, x] - large[0, 0]) <= 1).all()
            and (np.abs(image[y : y + height, x : x + width] - large) <= 1).all()
        ]
        assert places, "no part of the figure has these colours"
        found.append(places[0])
    return found


@pytest.mark.parametrize(
    ("kind", "name"), [("misses", "demand_misses"), ("misses-without", "demand_misses_without"), ("useful", "useful")]
)
def test_both_trees_have_the_colours_of_their_counts_on_one_scale(kind, name):
    view(KD, BVH, "--heat", kind, *CACHE, "--enlarge", "4", "-o", "x.png")
    values = [counted(run, name) for run in (KD, BVH)]
    scale = scale_of("", values)
    places = panels_in(dots("x.png").astype(int), [colours(each, scale) for each in values], 4)
    assert places[0][0] == places[1][0] and places[0][1] < places[1][1]


def test_the_difference_is_of_the_first_run_from_each_other():
    view(KD, BVH, "--heat", "misses", "--difference", *CACHE, "--enlarge", "4", "-o", "x.png")
    first, second = (counted(run, "demand_misses") for run in (KD, BVH))
    change = scale_of("", [second - first], is_signed=True)
    assert change.least == -change.most
    panels_in(dots("x.png").astype(int), [colours(first, scale_of("", [first])), colours(second - first, change)], 4)


def test_what_is_saved_and_what_a_cache_itself_requests():
    view(BVH, "--heat", "saved,prefetches", *CACHE, "--prefetch", "next-line:miss", "--enlarge", "12", "-o", "x.png")
    names = ("demand_misses", "demand_misses_without", "prefetch_accesses")
    misses, without, requests = (counted(BVH, name, "--prefetch", "next-line:miss") for name in names)
    scales = scale_of("", [without - misses], is_signed=True), scale_of("", [requests])
    panels_in(dots("x.png").astype(int), [colours(without - misses, scales[0]), colours(requests, scales[1])], 12)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_drawn_in_every_format(kind, folder):
    for ending, start in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        if ending == ".png" or kind == "accesses":
            cache = [] if kind in ("picture", "accesses", "prefetches") else CACHE
            view(KD, BVH, "--heat", kind, *cache, "-o", f"x{ending}")
            assert (folder / f"x{ending}").read_bytes().startswith(start)


def test_the_kinds_of_the_command_are_those_of_the_maps():
    assert ("picture", *OF_HEAT) == KINDS


def test_few_far_numbers_do_not_darken_the_rest():
    values = np.full((40, 40), 10)
    assert scale_of("m", [values]) == Scale("m", 0.0, 10.0)
    values[0, 0] = 500
    assert scale_of("m", [values]) == Scale("m; the end: 10 to 500", 0.0, 10.0, is_cut=True)
    assert scale_of("m", [np.zeros((2, 2), int)]) == Scale("m", 0.0, 1.0)


def test_a_missing_matplotlib_is_known_before_any_work(monkeypatch):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr("cachesim.report.pictures.importlib", type("Imports", (), {"import_module": staticmethod(absent)}))
    monkeypatch.setattr("cachesim.heat.HeatMaps.values", lambda *args: pytest.fail("work was done"))
    assert view(BVH, "--heat", "misses", "-o", "y.png", code=2).stderr.startswith("Error: a plot needs matplotlib")
    view(BVH, "-o", "y.png")  # the picture alone needs none


def test_a_run_without_a_picture_is_one_sentence(tmp_path):
    write(make_trace("bvh", 1, n_rays=3), tmp_path / "run")
    result = view(str(tmp_path / "run"), "-o", "x.png", code=2)
    assert "image.png is not a picture (cannot identify image file" in result.stderr


def test_pictures_of_two_sizes_have_no_difference():
    result = view(BVH, SMALL, "--heat", "misses", "--difference", "-o", "x.png", code=2)
    assert f"{BVH} has 20x12 pixels, {SMALL} 8x8; render one of them again with --pixels" in result.stderr
    view(BVH, SMALL, "--heat", "misses", "-o", "x.png")  # side by side they are
