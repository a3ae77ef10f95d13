"""Every command with runs in an object store: a local S3 server, whose requests are counted."""

import json
import logging
import os
import pickle
import re
import shlex
from concurrent.futures import ThreadPoolExecutor

import pyarrow.fs
import pytest
from click.testing import CliRunner

import cli
import nptrace as nt
import rtrace.part_render as part_render
import rtrace.render as rendering
from cachesim import parts
from nptrace_base.places import filesystem_of, place

KEY, SECRET = "AKIAOFTHETEST", "s3cretOfTheTest"


@pytest.fixture(scope="module")
def server():
    """The address of an empty store."""
    from moto.server import ThreadedMotoServer

    running = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


def store():
    return pyarrow.fs.S3FileSystem(
        endpoint_override=os.environ["AWS_ENDPOINT_URL"], region="us-east-1", allow_bucket_creation=True
    )


@pytest.fixture
def requests(server, monkeypatch):
    """What the store is asked; it has the bucket ``runs``, and the environment has its address and keys."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", server)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", KEY)
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    monkeypatch.delenv("AWS_PROFILE", raising=False)
    filesystem_of.cache_clear()
    store().create_dir("runs")
    asked = []

    class Log(logging.Handler):
        def emit(self, record):
            # Answers with a part of a file are in colour.
            if found := re.search(r'"(?:\x1b\[[0-9;]*m)*(?P<what>[A-Z]+) /(?P<path>\S*) HTTP', record.getMessage()):
                asked.append((found["what"], found["path"]))

    log = logging.getLogger("werkzeug")
    monkeypatch.setattr(log, "handlers", [Log()])
    monkeypatch.setattr(log, "propagate", False)
    log.setLevel(logging.INFO)
    yield asked
    store().delete_dir_contents("runs")
    filesystem_of.cache_clear()


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(rendering, "CHUNK", 64)
    usual = part_render.render_parts.__kwdefaults__
    monkeypatch.setattr(part_render.render_parts, "__kwdefaults__", usual | {"part": 128})


def run(command):
    program, *args = shlex.split(command)
    result = CliRunner().invoke(getattr(cli, program), args, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result


def stored():
    found = store().get_file_info(pyarrow.fs.FileSelector("runs", recursive=True))
    return {each.path: each.size for each in found if each.is_file}


def plain(text):
    """Return the rows of JSON without the place of their run."""
    return [{name: value for name, value in row.items() if name != "path"} for row in json.loads(text)]


RENDER = "nptrace render blob --accel bvh --pixels 24x20 --order hilbert --json --out"


@pytest.mark.slow
def test_every_command_reads_and_writes_there(requests, small_parts, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    local = json.loads(run(f"{RENDER} here").stdout)[0]
    far = json.loads(run(f"{RENDER} s3://runs/a").stdout)[0]
    assert far["path"] == f"s3://runs/a/{far['run']}"
    assert {**local, "path": "", "n_bytes": 0} == {**far, "path": "", "n_bytes": 0}
    assert far["n_bytes"] == sum(stored().values())
    names = [name.rpartition("/")[2].partition("-")[0] for name in stored()]
    assert sorted(names) == ["accesses"] * 4 + ["image", "manifest.json", "nodes"] + ["rays"] * 4
    for command in (
        "npcache replay RUN --size 1K --ways 1,2 --prefetch none,stack --3c --json",
        "npcache replay RUN --size 1K --by pixel --json",
        "npcache replay --traces FOLDER --size 1K --json",
        "npcache sweep RUN --size 1K..2K --json",
        "npcache time RUN --size 1K --json",
        "npcache compare FOLDER --size 1K --prefetch push --no-baselines --json",
    ):
        found = [
            plain(run(command.replace("RUN", of["path"]).replace("FOLDER", folder)).stdout)
            for of, folder in ((local, "here"), (far, "s3://runs/a"))
        ]
        assert found[0] == found[1], command
    info = json.loads(run(f"nptrace info {far['path']} --json").stdout)[0]
    assert (info["n_bytes"], info["path"]) == (far["n_bytes"], far["path"])
    assert info["n_events"] == local["n_accesses"] + local["n_prefetches"]
    for command, name in (("nptrace export", "x.din"), ("nptrace view", "x.png")):
        for of in (local, far):
            run(f"{command} {of['path']} -o {of['path'][:2]}-{name}")  # he(re) or s3
        assert (tmp_path / f"he-{name}").read_bytes() == (tmp_path / f"s3-{name}").read_bytes()
    for command in ("nptrace view RUN --heat misses -o x.png", "npcache plot RUN -o y.png", "npcache report RUN -o x.html"):
        run(command.replace("RUN", far["path"]))


def test_table1_finds_its_runs_there(requests):
    run("nptrace render bunny --accel bvh --pixels 8x8 --offline --name bunny --out s3://runs/paper")
    assert {row["scene"] for row in json.loads(run("npcache table1 --traces s3://runs/paper --json").stdout)} == {"bunny"}


def test_a_part_is_read_in_two_requests(requests, small_parts):
    path = nt.render("blob", accel="bvh", pixels="24x20", out="s3://runs/a").path
    requests.clear()
    nt.replay(str(path), size="1K")
    for what in ("HEAD", "GET"):  # its size, its bytes
        asked = [name for each, name in requests if each == what and "accesses-" in name]
        assert len(set(asked)) == len(asked) == 4
    assert not any("/rays-" in name or "image-" in name for _, name in requests)  # what is not needed
    assert len(requests) <= 2 * 4 + 10


def test_a_part_of_a_worker_is_read_in_three_requests_for_bytes_at_most(requests, small_parts, monkeypatch):
    run = nt.render("blob", accel="bvh", pixels="24x20", out="s3://runs/a")
    wanted = nt.replay(run, size="1K").to_csv()
    monkeypatch.setattr(parts, "PART", run.n_accesses // 6)
    requests.clear()
    with ThreadPoolExecutor(1) as workers:  # a worker of another process makes the same ones
        assert nt.replay(str(run.path), size="1K", workers=workers).to_csv() == wanted
    n_tasks = run.n_accesses // (run.n_accesses // 6)
    assert n_tasks >= 6 and sum(what == "GET" for what, _ in requests) <= 3 * n_tasks


def test_workers_write_into_the_store(requests, tmp_path):
    """Processes of their own, which have the keys from the environment."""
    far = nt.render("blob", accel="bvh", pixels="20x20", out="s3://runs/a", workers=2)
    here = nt.render("blob", accel="bvh", pixels="20x20", out=tmp_path)
    for table in ("rays", "nodes", "accesses"):
        for name, values in far.columns(table).items():
            assert (values == here.columns(table)[name]).all(), name
    assert far.image() == here.image()


def test_a_run_of_other_content_is_kept_there_too(requests):
    run(f"{RENDER} s3://runs/a --name x")
    before = stored()
    again = CliRunner().invoke(cli.nptrace, [*shlex.split(RENDER)[1:], "s3://runs/a", "--name", "x", "--batch", "3"])
    assert again.exit_code == 2 and "s3://runs/a/x-bvh holds another run (of another batch)" in again.stderr
    assert stored() == before
    run(f"{RENDER} s3://runs/a --name x --batch 3 --overwrite")
    assert nt.open("s3://runs/a/x-bvh").footer.batch == 3
    assert len(stored()) == len(before)


def test_an_exception_while_writing_publishes_nothing(requests):
    """A stream that an exception ends is published all the same, with what it holds."""

    def pieces():
        yield b"half"
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        place("s3://runs/a/manifest.json").publish(pieces())
    assert stored() == {}
    written = [path.partition("?")[0] for what, path in requests if what in ("PUT", "POST")]
    assert "runs/a/manifest.json" not in written
    assert any(path.endswith(".upload") for path in written)  # it was, under another name


def test_no_key_is_in_a_file_or_a_message(requests, tmp_path):
    """Nor in what workers are sent."""
    run(f"{RENDER} s3://runs/a --name x")
    for name in stored():
        content = store().open_input_stream(name).readall()
        assert KEY.encode() not in content and SECRET.encode() not in content
    sent = pickle.dumps(nt.open("s3://runs/a/x-bvh").path)
    assert SECRET.encode() not in sent and KEY.encode() not in sent
    for command in (
        "npcache replay s3://runs/none",
        "npcache replay --traces s3://none/x",
        "nptrace render blob --out s3://none",
    ):
        result = CliRunner().invoke(getattr(cli, command.split()[0]), command.split()[1:])
        assert result.exit_code == 2 and result.stderr.splitlines()[-1].startswith("Error: ")
        assert KEY not in result.output and SECRET not in result.output


@pytest.mark.parametrize(
    "command",
    ["nptrace render blob --out URI", "npcache replay URI", "npcache sweep URI", "npcache time URI", "npcache compare URI",
     "npcache table1 URI", "nptrace info URI", "nptrace view URI", "nptrace export URI", "npcache plot URI -o x.png",
     "npcache report URI -o x.html", "npcache replay --traces URI"],
)  # fmt: skip
def test_a_secret_on_the_command_line_is_refused_everywhere(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    program, *args = shlex.split(command.replace("URI", "s3://me:hunter2@runs/a"))
    result = CliRunner().invoke(getattr(cli, program), args)
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].startswith("Error: s3://runs/a was given with a user or a password before its @;")
    assert "hunter2" not in result.output
