"""The targets of outputs: through links, into FIFOs, devices and open files, with existing permissions, or a sentence."""

import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from nptrace_base.atomic import whole_file
from nptrace_base.errors import NptraceError
from tests.reference.traces import make_footer
from traces.reader import open_run
from traces.writer import RunWriter

ROOT = Path(cli.__file__).resolve().parent
BALL = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
RENDER = ["render", "one.obj", "--name", "one", "--accel", "bvh", "--pixels", "8x8"]
EXPORT = ["export", "traces/one-bvh", "-o"]
SWEEP = ["sweep", "--size", "1K", "--ways", "1", "-o"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.obj").write_text(BALL)
    run(cli.nptrace, *RENDER)
    return tmp_path


def run(group, *args, code=0):
    result = CliRunner().invoke(group, args)
    assert result.exit_code == code, result.output
    return result


def program(name, *args, **options):
    command = [sys.executable, "-c", f"import cli; cli.{name}()", *args]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, stderr=subprocess.PIPE, check=True, **options)


def hidden(folder):
    return [p for p in folder.rglob(".*")]


# Every command that writes a file, and how it begins. Each is tried on each kind of target.
WRITERS = {
    "export": (cli.nptrace, EXPORT, b"0 0\n"),
    "sweep": (cli.npcache, SWEEP, b"run,path,scene"),
    "plot": (cli.npcache, [*SWEEP[:-1], "--plot"], b"\x89PNG"),
    "table1": (cli.npcache, ["table1", "--format", "csv", "-o"], b"run,path,scene"),
    "runs plotted": (cli.npcache, ["plot", "traces/one-bvh", "-o"], b"\x89PNG"),
    "view": (cli.nptrace, ["view", "traces/one-bvh", "-o"], b"\x89PNG"),
    "report": (cli.npcache, ["report", "traces/one-bvh", "-o"], b"<!doctype html>"),
}
ENDING = {"plot": ".png", "sweep": ".csv", "runs plotted": ".png", "view": ".png", "report": ".html"}


@pytest.fixture(params=WRITERS)
def writer(request, folder):
    if request.param == "table1":
        (folder / "traces" / "one-bvh").rename(folder / "other")
        run(cli.nptrace, "render", "bunny", "--name", "bunny", "--accel", "bvh", "--pixels", "8x8", "--offline")
    group, args, start = WRITERS[request.param]
    return lambda out, code=0: run(group, *args, str(out), code=code), start, ENDING.get(request.param, "")


def test_a_fifo_is_written_into(writer, folder):
    write, start, _ = writer
    os.mkfifo("pipe")
    read = []
    reader = threading.Thread(target=lambda: read.append(Path("pipe").read_bytes()), daemon=True)
    reader.start()
    write("pipe")
    reader.join(10)
    assert read[0].startswith(start)
    assert stat.S_ISFIFO(os.stat("pipe").st_mode)
    assert hidden(folder) == []


def test_a_link_is_followed_to_a_file_that_keeps_its_permissions(writer, folder):
    write, start, ending = writer
    (folder / "far").mkdir()
    target = folder / "far" / f"target{ending}"
    target.write_text("before")
    target.chmod(0o640)
    link = folder / f"link{ending}"
    (folder / "second").symlink_to(target)
    link.symlink_to("second")
    write(link)
    assert link.is_symlink() and (folder / "second").is_symlink()
    assert target.read_bytes().startswith(start)
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    target.unlink()
    write(link)  # a link to what is not there yet
    assert target.read_bytes().startswith(start)
    assert hidden(folder) == []


def test_standard_output_is_written_to(writer):
    write, start, _ = writer
    assert write("-").stdout_bytes.startswith(start)


def test_a_new_file_has_the_permissions_of_the_umask(writer, folder):
    write, _, ending = writer
    before = os.umask(0o027)
    try:
        write(f"new{ending}")
    finally:
        os.umask(before)
    assert stat.S_IMODE(os.stat(f"new{ending}").st_mode) == 0o640


def test_a_folder_a_missing_folder_and_a_loop_are_one_sentence(writer, folder):
    write, _, ending = writer
    (folder / f"d{ending}").mkdir()
    (folder / f"loop{ending}").symlink_to(f"loop{ending}")
    for out, reason in ((f"d{ending}", "it is a folder"), (f"no/x{ending}", "there is no folder no")):
        result = write(out, code=2)
        assert result.stderr == f"Error: cannot write {out}: {reason}; name another file\n" and result.stdout == ""
    assert write(f"loop{ending}", code=2).stderr.startswith(f"Error: cannot write loop{ending}: ")
    assert hidden(folder) == []


def device(name, minor):
    """Make a copy of /dev/null (3) or /dev/full (7): root must not test on the real one, which a fault would replace."""
    if os.geteuid() == 0:
        os.mknod(name, 0o666 | stat.S_IFCHR, os.makedev(1, minor))
    else:
        os.symlink({3: "/dev/null", 7: "/dev/full"}[minor], name)


def test_a_device_is_written_into(writer):
    write, _, _ = writer
    device("null", 3)
    os.symlink("null", "link")
    for name in ("null", "link"):
        write(name)
        assert stat.S_ISCHR(os.stat("null").st_mode) and os.path.islink("link")


def test_an_open_file_is_written_into_where_it_stands(folder):
    """As /dev/stdout is: what is in it already stays, and it stays the same file."""
    with open("log", "w+b") as log:
        log.write(b"head\n")
        log.flush()
        number = os.stat("log").st_ino
        program("nptrace", *EXPORT, "/dev/fd/1", stdout=log)
        assert Path("log").read_bytes().startswith(b"head\n0 0\n")
        assert os.stat("log").st_ino == number
    os.symlink("/proc/self/fd/1", "out")  # what /dev/stdout is
    with open("log", "ab") as log:
        program("nptrace", *EXPORT, "out", stdout=log)
    once = run(cli.nptrace, *EXPORT, "-").stdout_bytes
    assert Path("log").read_bytes() == b"head\n" + 2 * once
    assert os.path.islink("out")
    done = program("nptrace", *EXPORT, "/dev/fd/1", stdout=subprocess.PIPE)
    assert done.stdout == once


def test_a_read_only_file_is_not_replaced(tmp_path):
    """Without the rights of root, whom nothing binds."""
    tmp_path.chmod(0o777)
    for parent in tmp_path.parents:
        if parent.stat().st_uid == os.geteuid() and parent != Path("/") and not parent.stat().st_mode & 1:
            parent.chmod(parent.stat().st_mode | 0o011)
    (tmp_path / "kept").write_text("before")
    (tmp_path / "kept").chmod(0o444)
    code = """
import os, sys
from pathlib import Path
from nptrace_base.errors import NptraceError
from nptrace_base.atomic import whole_file
if os.geteuid() == 0:
    os.setgid(65534)
    os.setuid(65534)
try:
    with whole_file(Path("kept")) as part:
        part.write_text("after")
except NptraceError as e:
    print(e)
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "cannot write kept: Permission denied; name another file\n", done.stderr
    assert (tmp_path / "kept").read_text() == "before"


def test_what_fails_half_way_leaves_a_fifo_a_link_and_a_file_as_they_were(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("before")
    os.symlink("file", "link")
    for name in ("file", "link"):
        with pytest.raises(ZeroDivisionError), whole_file(Path(name)) as part:
            part.write_text("half")
            raise ZeroDivisionError
    assert Path("file").read_text() == "before" and os.path.islink("link")
    assert sorted(os.listdir()) == ["file", "link"]


def test_an_error_about_another_file_is_not_taken_for_one_of_the_output(tmp_path):
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "out"):
        Path("/no/such/input").read_bytes()
    with pytest.raises(NptraceError, match="cannot write"), whole_file(tmp_path / "out"):
        raise OSError(28, "No space left on device")


def test_a_full_device_is_one_sentence(folder):
    device("full", 7)
    result = run(cli.nptrace, *EXPORT, "full", code=2)
    assert result.stderr == "Error: cannot write full: No space left on device; name another file\n"
    assert stat.S_ISCHR(os.stat("full").st_mode)


def test_a_run_that_is_a_link_is_written_where_it_leads(folder):
    (folder / "big").mkdir()
    (folder / "traces" / "one-bvh").rename(folder / "big" / "one-bvh")
    link = folder / "traces" / "one-bvh"
    link.symlink_to(folder / "big" / "one-bvh")
    (folder / "held").hardlink_to(folder / "big" / "one-bvh" / "rays.parquet")  # so that no other file gets its number
    for _ in range(2):
        run(cli.nptrace, *RENDER)
        assert link.is_symlink()
        assert open_run(link).n_accesses > 0
        assert hidden(folder) == []
    assert (folder / "big" / "one-bvh" / "rays.parquet").stat().st_ino != (folder / "held").stat().st_ino  # made anew
    run(cli.nptrace, *RENDER, "--batch", "0", "--overwrite")
    assert open_run(folder / "big" / "one-bvh").footer.batch == 0


def test_a_run_linked_to_a_disk_that_is_away_is_one_sentence(folder):
    (folder / "traces" / "one-bvh").rename(folder / "gone")
    (folder / "traces" / "one-bvh").symlink_to(folder / "disk" / "one-bvh")
    result = run(cli.nptrace, *RENDER, code=2)
    assert f"traces/one-bvh is a link to {folder}/disk/one-bvh, whose folder is missing" in result.stderr
    assert not (folder / "disk").exists()


def test_links_that_were_left_are_swept_and_what_they_lead_to_stays(folder):
    """Earlier versions left such links, which no later render took away."""
    (folder / "precious").mkdir()
    (folder / "precious" / "file").write_text("")
    for ending in ("tmp", "old"):
        link = folder / "traces" / f".one-bvh.999999999-12345678.{ending}"
        link.symlink_to(folder / "precious")
        os.utime(link, (0, 0), follow_symlinks=False)
    run(cli.nptrace, *RENDER)
    assert os.listdir(folder / "traces") == ["one-bvh"]
    assert (folder / "precious" / "file").exists()


def test_a_run_keeps_the_permissions_of_the_one_before(folder):
    (folder / "traces" / "one-bvh").chmod(0o750)
    run(cli.nptrace, *RENDER)
    assert stat.S_IMODE((folder / "traces" / "one-bvh").stat().st_mode) == 0o750


def test_names_that_are_not_utf8_are_written(folder):
    odd = os.fsdecode(b"t\xe9")
    done = program("nptrace", *RENDER, "--out", odd, stdout=subprocess.PIPE)
    assert rb" t\xe9/one-bvh " in done.stdout
    assert sorted(os.listdir(f"{odd}/one-bvh")) == sorted(os.listdir("traces/one-bvh"))
    assert Path(odd, "one-bvh", "rays.parquet").read_bytes() == Path("traces/one-bvh/rays.parquet").read_bytes()
    for ending in (".csv", ".parquet"):
        run(cli.npcache, *SWEEP, odd + ending)
        assert Path(odd + ending).stat().st_size > 0


def test_an_output_that_cannot_be_written_is_known_before_any_work(folder, monkeypatch):
    import cachesim.sweep as sweeping

    monkeypatch.setattr(sweeping, "sweep", None)
    for args in (["-o", "no/x.csv"], ["--plot", "no/x.png"], ["--plot", "x.txt"]):
        assert "cannot write" in run(cli.npcache, *SWEEP[:-1], *args, code=2).stderr


def test_two_writers_of_a_run_directory_leave_no_third(tmp_path):
    """What is at a run's place and no run stays."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "letter.txt").write_text("")
    with pytest.raises(NptraceError, match="is not a run"), RunWriter(tmp_path / "run", make_footer(), []):
        pass
    assert os.listdir(tmp_path) == ["run"]
