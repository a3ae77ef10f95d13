"""Faults from outside: killed at any moment, a full disk, two writers at once, no memory. Complete runs or none."""

import os
import random
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

import cli
from nptrace_base.atomic import whole_file
from rtrace.scenes.shapes import soup
from traces.format import FILES, RunError
from traces.reader import find_runs, open_run

ROOT = Path(cli.__file__).resolve().parent


@pytest.fixture
def folder(tmp_path):
    lines = ["v {} {} {}".format(*map(float, corner)) for corner in soup(3000, seed=1).reshape(-1, 3)]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(3000)]
    (tmp_path / "soup.obj").write_text("\n".join(lines))
    return tmp_path


#: Python 3.11 keeps the half of a compiled file that a limit of sizes leaves, and cannot import it later.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}


def start(folder, *args, limit=None, program="nptrace"):
    command = [sys.executable, "-c", f"import cli; cli.{program}()", *map(str, args)]
    return subprocess.Popen(
        command, cwd=folder, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, preexec_fn=limit,
    )  # fmt: skip


def render(folder, size, **options):
    return start(folder, "render", "soup.obj", "--accel", "bvh", "--pixels", size, "--name", "soup", "--overwrite", **options)


def finish(process):
    """Wait for a process and return (exit status, stderr)."""
    _, stderr = process.communicate()
    return process.returncode, stderr


def read_all(run):
    return sum(len(node) for node, _ in run.batches()) + len(run.columns("rays")["t"]) + len(run.columns("nodes")["level"])


@pytest.mark.slow
def test_killed_at_any_moment_a_run_is_whole_or_the_one_before(folder):
    assert finish(render(folder, "64x64"))[0] == 0
    before = (folder / "traces" / "soup-bvh" / "accesses.parquet").read_bytes()
    began = time.perf_counter()
    process = render(folder, "200x200")
    process.communicate()
    whole = time.perf_counter() - began
    after = (folder / "traces" / "soup-bvh" / "accesses.parquet").read_bytes()
    chance = random.Random(4)
    for _ in range(12):
        process = render(folder, chance.choice(["64x64", "200x200"]))
        time.sleep(chance.uniform(0.3, 1.1) * whole)
        process.kill()
        process.communicate()
        (path,) = find_runs(folder / "traces")
        assert read_all(open_run(path)) > 0
        assert (path / "accesses.parquet").read_bytes() in (before, after)
    process = render(folder, "64x64")
    process.communicate()
    assert process.returncode == 0
    assert os.listdir(folder / "traces") == ["soup-bvh"]  # what the killed ones left is swept
    assert (folder / "traces" / "soup-bvh" / "accesses.parquet").read_bytes() == before


def test_a_disk_that_fills_up_gives_a_message_and_leaves_nothing(folder):
    process = render(folder, "400x400", limit=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)))
    _, stderr = process.communicate()
    assert process.returncode == 2
    assert "cannot write" in stderr
    assert "nothing was kept" in stderr
    assert "Traceback" not in stderr
    assert os.listdir(folder / "traces") == []


@pytest.mark.slow
def test_two_renders_into_one_run_leave_one_whole_run(folder):
    assert finish(render(folder, "64x64"))[0] == 0
    for _ in range(3):
        processes = [render(folder, "100x100") for _ in range(3)]
        for process in processes:
            _, stderr = process.communicate()
            assert process.returncode == 0, stderr
        assert os.listdir(folder / "traces") == ["soup-bvh"]
        run = open_run(folder / "traces" / "soup-bvh")
        assert run.footer.width == 100
        assert read_all(run) > 0


def test_a_killed_replay_leaves_no_output(folder):
    assert finish(render(folder, "300x300"))[0] == 0
    names = sorted(os.listdir(folder))
    for wait in (0.2, 0.5, 0.8):
        process = start(folder, "replay", "--size", "8K", "--3c", "--json", program="npcache")
        time.sleep(wait)
        process.kill()
        process.communicate()
        assert sorted(os.listdir(folder)) == names
        assert sorted(os.listdir(folder / "traces" / "soup-bvh")) == sorted(FILES)


def test_too_little_memory_is_one_sentence_and_leaves_nothing(folder):
    """60,000 x 30,000 pixels need 7 GB for their order alone; with 4 GB of address space there is a message, not a crash."""
    process = render(folder, "60000x30000", limit=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)))
    _, stderr = process.communicate()
    assert process.returncode == 2
    assert "Traceback" not in stderr
    assert "memory" in stderr.lower() or "allocate" in stderr.lower()
    assert not (folder / "traces").exists() or os.listdir(folder / "traces") == []


# Commands that write one file, and what they print to it when nothing disturbs them.
WRITERS = {
    "sweep.parquet": ("npcache", ["sweep", "--size", "1K..64K", "--ways", "1..64,full", "--line", "32,64", "-o"]),
    "soup.din": ("nptrace", ["export", "traces/soup-bvh", "-o"]),
}


def files_in(folder):
    return sorted(p.name for p in folder.iterdir() if p.is_file() and p.suffix != ".obj")


@pytest.mark.slow
def test_killed_at_any_moment_an_output_file_is_whole_or_the_one_before(folder):
    """A killed writer leaves at most a hidden temporary file, and the next writer of that file takes it away."""
    assert finish(render(folder, "160x160"))[0] == 0
    chance = random.Random(7)
    for name, (program, command) in WRITERS.items():
        (folder / name).write_text("before")
        began = time.perf_counter()
        status, stderr = finish(start(folder, *command, name, program=program))
        whole = time.perf_counter() - began
        assert status == 0, stderr
        after = (folder / name).read_bytes()
        assert files_in(folder) == [name]
        seen = set()
        for _ in range(5):
            (folder / name).write_text("before")
            process = start(folder, *command, name, program=program)
            time.sleep(chance.uniform(0.5, 1.05) * whole)
            process.kill()
            process.communicate()
            assert (folder / name).read_bytes() in (b"before", after)
            seen |= set(files_in(folder)) - {name}
        assert all(left.startswith(".") and ".tmp" in left for left in seen)
        assert finish(start(folder, *command, name, program=program))[0] == 0
        assert files_in(folder) == [name]
        (folder / name).unlink()


def test_a_writer_killed_while_it_writes_leaves_what_the_next_one_sweeps(folder):
    code = (
        "import os, signal, pathlib; from nptrace_base.atomic import whole_file\n"
        "with whole_file(pathlib.Path('out [1].csv')) as part: part.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    (left,) = files_in(folder)
    assert left.startswith(".out [1].") and left.endswith(".tmp.csv")
    with whole_file(folder / "out [1].csv") as part:
        part.write_text("whole")
    assert files_in(folder) == ["out [1].csv"]


@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_fills_up_under_an_output_file_gives_a_message(folder, name):
    assert finish(render(folder, "64x64"))[0] == 0
    (folder / name).write_text("before")
    program, command = WRITERS[name]
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, 5_000))
    status, stderr = finish(start(folder, *command, name, program=program, limit=limit))
    assert status == 2
    assert f"cannot write {name}: " in stderr and "File too large" in stderr
    *notes, error = stderr.splitlines()  # a kernel that has to be compiled cannot be kept either
    assert error.startswith("Error: ") and all("kernels" in note or "compiling" in note for note in notes)
    assert (folder / name).read_text() == "before"
    assert files_in(folder) == [name]


@pytest.mark.parametrize("name", FILES)
def test_a_flipped_bit_in_the_middle_of_any_file_is_reported(folder, name):
    """Half-way into a file are its data. Columns that a replay does not read are refused when they are read."""
    assert finish(render(folder, "64x64"))[0] == 0
    file = folder / "traces" / "soup-bvh" / name
    data = bytearray(file.read_bytes())
    for offset in (len(data) // 3, len(data) // 2):
        broken = data.copy()
        broken[offset] ^= 16
        file.write_bytes(broken)
        if name in ("rays.parquet", "nodes.parquet"):
            with pytest.raises(RunError, match=f"{name} is damaged"):
                open_run(folder / "traces" / "soup-bvh").columns(file.stem)
            continue
        result = CliRunner().invoke(cli.npcache, ["replay", "--traces", str(folder / "traces")])
        assert result.exit_code == 2
        assert result.stdout == ""
        assert f"{name} is damaged" in result.stderr and "render it again" in result.stderr
        assert len(result.stderr.splitlines()) == 1
    file.write_bytes(data)
    assert CliRunner().invoke(cli.npcache, ["replay", "--traces", str(folder / "traces")]).exit_code == 0


def test_a_cut_footer_is_reported(folder):
    assert finish(render(folder, "64x64"))[0] == 0
    for name in ("accesses.parquet", "rays.parquet", "nodes.parquet"):
        file = folder / "traces" / "soup-bvh" / name
        data = file.read_bytes()
        for keep in (0, 3, len(data) // 2, len(data) - 9, len(data) - 1):
            file.write_bytes(data[:keep])
            result = CliRunner().invoke(cli.npcache, ["replay", "--traces", str(folder / "traces")])
            assert (result.exit_code, result.stdout) == (2, "")
            assert f"{name} is damaged" in result.stderr and len(result.stderr.splitlines()) == 1
        file.write_bytes(data)


DROPPED = """
import os, sys
from pathlib import Path
from nptrace_base.errors import NptraceError
from traces.format import SPLIT, RunError
from traces.writer import RunWriter
from tests.reference.traces import make_footer
from nptrace_base.atomic import whole_file
if os.geteuid() == 0:
    os.setgid(65534)
    os.setuid(65534)
try:
    with RunWriter(Path("locked/run"), make_footer(), SPLIT):
        pass
except RunError as e:
    print(e)
try:
    with whole_file(Path("locked/out.csv")) as part:
        part.write_text("x")
except NptraceError as e:
    print(e)
"""


def test_a_read_only_folder_is_reported_and_left_as_it_was(tmp_path):
    """Without the rights of root, which folders do not bind."""
    (tmp_path / "locked").mkdir()
    (tmp_path / "locked" / "run").mkdir()
    for path in (tmp_path / "locked" / "run", tmp_path / "locked"):
        path.chmod(0o555)
    for parent in (tmp_path, *tmp_path.parents):  # a temporary folder of pytest is its owner's only
        if parent.stat().st_uid == os.geteuid() and parent != Path("/") and not parent.stat().st_mode & 1:
            parent.chmod(parent.stat().st_mode | 0o011)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", DROPPED], cwd=tmp_path, env=environment, capture_output=True, text=True)
    (tmp_path / "locked").chmod(0o755)
    assert done.stdout.splitlines() == [
        "cannot write locked/run: Permission denied; choose another --out",
        "cannot write locked/out.csv: Permission denied; name another file",
    ], done.stderr
    assert os.listdir(tmp_path / "locked") == ["run"]


def test_a_read_only_folder_is_one_sentence_of_every_command(folder, monkeypatch):
    """The same at the file layer, through the commands."""
    assert finish(render(folder, "64x64"))[0] == 0
    monkeypatch.chdir(folder)
    before = sorted(os.listdir(folder))

    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    monkeypatch.setattr(Path, "write_text", refuse)
    monkeypatch.setattr(Path, "replace", refuse)
    commands = [
        (cli.nptrace, ["render", "soup.obj", "--accel", "bvh", "--out", "new"], "cannot write new/soup-bvh"),
        (cli.npcache, ["sweep", "--size", "1K", "--ways", "1", "-o", "x.csv"], "cannot write x.csv"),
        (cli.npcache, ["sweep", "--size", "1K", "--ways", "1", "-o", "x.parquet"], "cannot write x.parquet"),
        (cli.nptrace, ["export", "traces/soup-bvh"], "cannot write soup-bvh.din"),
    ]
    for group, args, words in commands:
        result = CliRunner().invoke(group, args)
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        *notes, error = result.stderr.splitlines()
        assert f"{words}: Permission denied" in error
        assert all("float32 vertices" in note for note in notes) and len(notes) <= 1  # render's word on its precision
        assert sorted(os.listdir(folder)) == before


def test_a_replay_without_memory_is_one_sentence(folder):
    """A direct-mapped cache of 2^30 lines keeps 8 GB of tags."""
    assert finish(render(folder, "64x64"))[0] == 0
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    status, stderr = finish(start(folder, "replay", "--size", "32G", program="npcache", limit=limit))
    assert status == 2
    assert len(stderr.splitlines()) == 1 and "allocate" in stderr
