"""Pictures from Python: those of the commands, shown by a notebook, of results and of runs; the map's rows."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
from tests.nptrace.test_terminal import inputs


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawing")
    inputs(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        nt.render("ball.obj", pixels=(12, 10))
        yield folder


def run(command):
    program, *args = command.split()
    result = CliRunner().invoke(getattr(cli, program), args, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


BVH, KD = "traces/ball-bvh-12x10", "traces/ball-kdtree-12x10"


@pytest.mark.parametrize(
    ("call", "command"),
    [
        (lambda **to: nt.view(nt.open(BVH), **to), f"nptrace view {BVH}"),
        (lambda **to: nt.view([BVH, Path(KD)], heat=["accesses", "misses"], size="1K", ways=2, difference=True, **to),
         f"nptrace view {BVH} {KD} --heat accesses,misses --size 1K --ways 2 --difference"),
        (lambda **to: nt.plot(nt.open(BVH), kind="levels", size=1024, ways=[1], **to),
         f"npcache plot {BVH} --kind levels --size 1K --ways 1"),
        (lambda **to: nt.plot([BVH, KD], prefetch=["none", "traced"], **to),
         f"npcache plot {BVH} {KD} --prefetch none,traced"),
    ],
)  # fmt: skip
def test_a_picture_is_that_of_the_command(folder, call, command):
    run(f"{command} -o theirs.png")
    picture = call(output="mine.png")
    wanted = Path("theirs.png").read_bytes()
    assert Path("mine.png").read_bytes() == bytes(picture) == wanted == picture._repr_png_()
    assert repr(picture) == f"<Picture mine.png: {len(wanted):,} bytes>" and picture.path == Path("mine.png")
    before = sorted(folder.iterdir())
    shown = call()
    assert bytes(shown) == wanted and shown.path is None and repr(shown).startswith("<Picture PNG: ")
    assert sorted(folder.iterdir()) == before


def test_results_are_drawn_as_their_file_is(folder):
    results = nt.sweep([BVH, KD], size="1K..4K", ways=[1, 2])
    results.to_parquet("s.parquet")
    run("npcache plot s.parquet -o theirs.svg")
    picture = nt.plot(results, output="mine.svg")
    assert bytes(picture) == Path("theirs.svg").read_bytes() == bytes(nt.plot(["s.parquet"], output="mine.svg"))
    assert picture._repr_svg_().lstrip().startswith("<?xml") and picture._repr_png_() is None
    assert bytes(
        nt.plot([nt.sweep(BVH, size="1K..4K", ways=[1, 2]), nt.sweep(KD, size="1K..4K", ways=[1, 2])], output="t.svg")
    )
    for call, sentence in (
        (lambda: nt.plot(results, size="8K"), "leave out size, or name runs"),
        (lambda: nt.plot(results, kind="x"), "kind: 'x' is not one of"),
        (lambda: nt.plot([results, nt.time(BVH, size="1K")]), "hold different results"),
        (lambda: nt.plot(results, output="a.txt"), "must end in"), (lambda: nt.view(BVH, output="a.svg"), "must end in .png"),
        (lambda: nt.view(BVH, rays=[1, 2]), "view takes one cache and one machine"),
        (lambda: nt.view(BVH, difference=True), "compares numbers of two runs"),
        (lambda: nt.report(BVH, output="r.txt"), "must end in .html"),
        (lambda: nt.report(BVH, output="r.html", rays=[1, 2]), "a report takes one machine"),
        (lambda: nt.map("ball.obj", pixels="8x8", one_in=2), "takes 1,024 primary rays|primary rays, and 8x8"),
        (lambda: nt.map("ball.obj", out="s3://bucket/map"), "a map keeps rows beside its runs"),
    ):  # fmt: skip
        with pytest.raises(nt.NptraceError, match=sentence):
            call()


def test_a_map_has_the_rows_of_the_command_and_is_drawn(folder):
    results = nt.map("ball.obj", pixels=(8, 8), quick=True, out="map", threads=1)
    rows = json.loads(run("nptrace map ball.obj --pixels 8x8 --quick --out map --plot theirs.png --json").stdout)
    assert list(results) == [{name: value for name, value in row.items() if name != "schema_version"} for row in rows]
    assert bytes(nt.plot(results)) == Path("theirs.png").read_bytes()
    assert str(results) == run("nptrace map ball.obj --pixels 8x8 --quick --out map").stdout.rstrip("\n")


def test_a_report_is_that_of_the_command(folder):
    run(f"npcache report {BVH} --size 1K --ways 1 -o theirs.html")
    assert nt.report(nt.open(BVH), output="mine.html", size="1K", ways=1) == Path("mine.html")
    assert Path("mine.html").read_bytes() == Path("theirs.html").read_bytes()
