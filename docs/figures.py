"""The functions that cog runs for the pages: real output of commands, and tables from the files under docs/data/."""

import csv
import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "docs" / "data"
TREES = {"kdtree": "kd-tree", "bvh": "BVH"}
FOLDER = Path(tempfile.gettempdir()) / f"nptrace-readme-{os.getpid()}"


def have_scenes() -> bool:
    """Whether the real scenes are installed; without them the recorded output stays as it is."""
    folder = os.environ.get("NPTRACE_SCENES")
    return folder is not None and (Path(folder) / "bunny.ply").exists()


def show(cog, *commands: str) -> None:
    """Write each command and its standard output, as a terminal session in a fenced block."""
    if not have_scenes():
        print("docs: the real scenes are not installed (NPTRACE_SCENES); recorded output kept", file=sys.stderr)
        cog.out(cog.previous)
        return
    FOLDER.mkdir(exist_ok=True)
    lines = ["```console"]
    for command in commands:
        words = shlex.split(command)
        words[0] = str(Path(sys.executable).parent / words[0])
        done = subprocess.run(words, cwd=FOLDER, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{command}: {done.stderr}")
        lines += [f"$ {command}", *(line.rstrip() for line in done.stdout.strip("\n").splitlines())]
    cog.outl("\n".join([*lines, "```"]))


def table1(cog) -> None:
    """Write Table I from table1.csv, ours beside the paper's, one row per cache."""
    with open(DATA / "table1.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    cog.outl("| | | miss A % | paper | miss B % | paper | B/A % | paper | KB B/A % | paper | *demand* A % | *demand* B/A % |")
    cog.outl("| --- | --- |" + " ---: |" * 10)
    for tree, scene in dict.fromkeys((row["tree"], row["scene"]) for row in rows):
        for row in rows:
            if (row["tree"], row["scene"]) != (tree, scene):
                continue
            names = ("demand_miss_rate_without", "paper_miss_rate", "paper_ratio", "traffic_ratio")
            cells = [100 * float(row[f"{name}{of}"]) for name in names for of in ("", "_paper")]
            cells += [100 * float(row["demand_miss_rate_without"]), 100 * float(row["demand_ratio"])]
            cache = f"{int(row['size_bytes']) // 1024}K({row['ways']})"
            cog.outl(f"| {TREES[tree]} {scene.capitalize()} | {cache} | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |")


def headline(cog) -> None:
    """Write the range of B/A over the rows of each tree, from table1.csv: the paper's miss rate, and what it hides."""
    with open(DATA / "table1.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = {
        "printed by the paper": "paper_ratio_paper", "the same, ours": "paper_ratio", "demand misses": "demand_ratio",
        "bytes from memory": "traffic_ratio",
    }  # fmt: skip
    cog.outl("| with prefetching / without, in % | " + " | ".join(columns) + " |")
    cog.outl("| --- |" + " ---: |" * len(columns))
    for tree, title in TREES.items():
        cells = []
        for name in columns.values():
            values = [100 * float(row[name]) for row in rows if row["tree"] == tree]
            cells.append(f"{min(values):.0f} to {max(values):.0f}")
        cog.outl(f"| {title} | " + " | ".join(cells) + " |")


def finding(cog) -> None:
    """Write what the study finds, in a few sentences, from table1.csv and the clock's figures of docs/does-it-pay.md."""
    import pay

    with open(DATA / "table1.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

    def percent(name: str, *trees: str) -> str:
        values = [100 * float(row[name]) for row in rows if row["tree"] in (trees or TREES)]
        return f"{min(values):.0f} to {max(values):.0f} %"

    def most(tree: str) -> str:
        return f"{pay.most_without_unit(tree):.2f}x"

    printed, bytes_ = percent("paper_ratio_paper"), percent("traffic_ratio")
    demand = {tree: percent("demand_ratio", tree) for tree in TREES}
    cog.outl(
        f"The paper prints that its prefetch unit lowers the miss rate to {printed} of what it is without prefetching, but it "
        f"counts prefetches as accesses. In our runs, the misses for which a ray waits fall to {demand['kdtree']} (kd-tree) "
        f"and {demand['bvh']} (BVH), and the bytes from memory are {bytes_}. In cycles, with one ray in flight, the unit "
        f"gives a speed-up of {pay.unit_gives('kdtree')} (kd-tree) and {pay.unit_gives('bvh')} (BVH). Without any unit, with "
        f"16 MSHRs and at most 1.1 times the bytes, the fastest line and layout of each scene give up to {most('kdtree')} "
        f"(kd-tree) and {most('bvh')} (BVH); the best single pair for all scenes gives {pay.one_for_all('kdtree')} and "
        f"{pay.one_for_all('bvh')}."
    )


def hard_cases(cog) -> None:
    """Write the results of ``nptrace check --hard --json``, one line per case: the worst of its structures."""
    rows = json.loads((DATA / "hard_cases.json").read_text(encoding="utf-8"))
    cog.outl("| case | structures | rays | lost | invented | wrong | differ | ambiguous | t error | bound |")
    cog.outl("| --- |" + " ---: |" * 9)
    for case in dict.fromkeys(row["case"] for row in rows):
        of = [row for row in rows if row["case"] == case]
        sums = " | ".join(str(max(row[name] for row in of)) for name in ("lost", "invented", "wrong", "unlike", "ambiguous"))
        error = max(row["t_error"] for row in of)
        bound = "-" if of[0]["bound"] is None else f"{of[0]['bound']:g}"
        cog.outl(f"| {case} | {len(of)} | {of[0]['n_rays']:,} | {sums} | {error:.2g} | {bound} |")


def embree(cog) -> None:
    """Write the results of ``nptrace check --json``, a line per kind of rays and comparison: the worst of all."""
    rows = json.loads((DATA / "embree.json").read_text(encoding="utf-8"))
    cog.outl("| rays | compared | comparisons | rays in all | largest | limit |")
    cog.outl("| --- | --- |" + " ---: |" * 4)
    for rays, what in dict.fromkeys((row["rays"], row["what"]) for row in rows):
        of = [row for row in rows if (row["rays"], row["what"]) == (rays, what)]
        worst = max(of, key=lambda row: row["value"])
        n_rays = sum(row["n_rays"] for row in of)
        cog.outl(f"| {rays} | {what} | {len(of)} | {n_rays:,} | {worst['value']:.3g} | {worst['limit']:.3g} |")


def checks(cog) -> None:
    """Write the counts of ``python -m tests.checks``: all tests, a line per file and below it one per check."""
    sys.path.insert(0, str(ROOT))
    from tests.checks import what_files_check

    rows = {row["check"]: row for row in json.loads((DATA / "checks.json").read_text(encoding="utf-8"))}
    n_tests, n_cases = (sum(row[name] for row in rows.values()) for name in ("tests", "cases"))
    failed, skipped, expected = (
        sum(row[name] for row in rows.values()) for name in ("failed", "skipped", "expected failures")
    )
    cog.outl(f"{len(rows)} checks, {n_tests:,} tests, {n_cases:,} cases: {failed} failed, {skipped} skipped, "
             f"{expected} known to fail.\n")  # fmt: skip
    cog.outl("| check | tests | cases | largest error | result |")
    cog.outl("| --- | ---: | ---: | ---: | --- |")
    for file, what in what_files_check().items():
        of = [row for name, row in rows.items() if name.split("::")[0] == file]
        if not of:
            continue
        cog.outl(f"| **{file}**: {_cell(what)} | **{sum(row['tests'] for row in of):,}** | "
                 f"**{sum(row['cases'] for row in of):,}** | | |")  # fmt: skip
        for row in of:
            name = row["check"].split("::test_")[1].replace("_", " ")
            error = "" if row["largest error"] is None else f"{row['largest error']:.2g}"
            cog.outl(f"| {_cell(name)} | {row['tests']:,} | {row['cases']:,} | {error} | {_result(row)} |")


def _result(row) -> str:
    parts = [f"{row[name]} {name}" for name in ("failed", "skipped", "expected failures") if row[name]]
    return ", ".join(parts) or "passed"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("``", "`")


def open_list(cog) -> None:
    """Write which tests and hard cases cover each entry of the open list."""
    sys.path.insert(0, str(ROOT))
    from tests.open_list import OPEN_LIST

    cog.outl("| | hard case | covered by |")
    cog.outl("| --- | --- | --- |")
    for entry in OPEN_LIST:
        cog.outl(f"| {entry.name} | {entry.what} | {', '.join(entry.covered_by) or '**nothing yet**'} |".replace("::", ": "))


def mesh_readers(cog) -> None:
    """Write how many files of the mesh corpus each reader read right, format by format."""
    rows = rows_of("mesh_readers.csv")
    formats = list(dict.fromkeys(row["format"] for row in rows))
    cog.outl("| reader | " + " | ".join(f"{name}, of {_files(rows, name)}" for name in formats) + " |")
    cog.outl("| --- |" + " ---: |" * len(formats))
    for reader, version in dict.fromkeys((row["reader"], row["version"]) for row in rows):
        right = {row["format"]: row["right"] for row in rows if row["reader"] == reader}
        cog.outl(f"| {reader} {version} | " + " | ".join(right.get(name, "") for name in formats) + " |")


def _files(rows: list[dict[str, str]], form: str) -> str:
    return next(row["files"] for row in rows if row["format"] == form)


def fuzz(cog) -> None:
    """Write how many inputs ``make fuzz`` tried."""
    data = json.loads((DATA / "fuzz.json").read_text(encoding="utf-8"))
    total = sum(row["tried"] for row in data["rows"])
    cog.outl(f"{total:,} inputs were tried, and each was accepted or refused as it should be.\n")
    cog.outl("| inputs | tried | accepted | refused |")
    cog.outl("| --- |" + " ---: |" * 3)
    for row in data["rows"]:
        cog.outl(f"| {row['inputs']} | {row['tried']:,} | {row['accepted']:,} | {row['refused']:,} |")


def dinero(cog) -> None:
    """Write how many random replays DineroIV's program and ours printed alike."""
    found = json.loads((DATA / "dinero.json").read_text(encoding="utf-8"))
    alike = found["cases"] - found["different"]
    cog.outl(
        f"Of {found['cases']:,} random cases with {found['demand_accesses']:,} demand accesses, {alike:,} printed the same "
        "block, to the last byte."
    )


def mutations(cog) -> None:
    """Write the test that noticed each mutation."""
    with open(DATA / "mutations.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    sys.path.insert(0, str(ROOT))
    from tests.mutations import MUTATIONS

    survived = sum(not row["noticed by"] for row in rows)
    cog.outl(f"{len(rows)} of the {len(MUTATIONS)} mutations on the list were tried, {survived} survived.\n")
    cog.outl("| mutation | file | noticed by |")
    cog.outl("| --- | --- | --- |")
    for row in rows:
        test = row["noticed by"].split("[")[0].replace(".py::", ": ")
        what = row["mutation"].replace("|", "\\|")
        cog.outl(f"| {what} | {row['file']} | {test or '**survived**'} |")


def rows_of(name: str) -> list[dict[str, str]]:
    """Return the rows of a file under docs/data, none if it is not there."""
    path = DATA / name
    if not path.exists():
        return []
    with open(path, encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _median(values: list[float]) -> float:
    ordered = sorted(values)
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def _two(value: float) -> str:
    """Return two digits of a number, without an exponent if it is large."""
    return f"{float(f'{value:.2g}'):g}"


#: Columns of Table I in speed_error.csv, and their headings on the page.
COLUMNS = {
    "demand_miss_rate_without": "miss A", "demand_miss_rate": "demand B", "paper_miss_rate": "paper B",
    "paper_ratio": "paper B/A", "demand_ratio": "demand B/A", "traffic_ratio": "traffic B/A", "bytes_from_memory": "KB B",
    "accesses_per_ray": "accesses / ray",
}  # fmt: skip


def speed_error(cog) -> None:
    """Write speed-up and errors of every short cut: medians over scenes and trees, and the largest error."""
    rows = rows_of("speed_error.csv")
    cog.outl("| method | | speed-up | " + " | ".join(COLUMNS.values()) + " |")
    cog.outl("| --- | --- |" + " ---: |" * (1 + len(COLUMNS)))
    for key in dict.fromkeys((row["method"], row["parameter"]) for row in rows):
        of = [row for row in rows if (row["method"], row["parameter"]) == key]
        if key[0] == "hashed lines" or of[0]["column"] == "build":
            continue
        speed = _median(list({(row["scene"], row["tree"]): float(row["speedup"]) for row in of}.values()))
        cells = []
        for column in COLUMNS:
            own = [row for row in of if row["column"] == column]
            if not own:
                cells.append("")
                continue
            middle, worst = _median([float(r["median_error"]) for r in own]), max(float(r["worst_error"]) for r in own)
            cells.append(f"{_two(middle)} / {_two(worst)}" if worst else "0")
        cog.outl(f"| {key[0]} | {key[1]} | {speed:.2g} | " + " | ".join(cells) + " |")


def speed_error_about(cog) -> None:
    """Write the measured runs, and the conclusion in one sentence."""
    rows, held = rows_of("speed_error.csv"), [row for row in rows_of("calibration.csv") if row["caches"] == "Table I"]
    runs = {(row["scene"], row["tree"]) for row in rows}
    cog.outl(f"{len(runs)} runs (scenes x trees): {', '.join(sorted({scene for scene, _ in runs}))}.")
    large = [row for row in held if row["size"] == "2048x2048" and row["median_share"] and row["target"] == "2%,0.05pp"]
    if large:
        share = 100 * _median([float(row["median_share"]) for row in large])
        scenes = ", ".join(sorted({row["scene"] for row in large}))
        cog.outl(
            "\n**In one sentence**: filter first, which introduces no error; then `--target-error 2%,0.05pp` at 2048x2048 "
            f"needs {share:.0f} % of the rays (median over {len(large)} runs: {scenes}), and every figure it prints has its "
            "half-width."
        )


def set_sampling(cog) -> None:
    """Write the gain in replay and the errors of set sampling."""
    rows = [row for row in rows_of("speed_error.csv") if row["method"].startswith("set sampling")]
    cog.outl("| caches | sets | speed-up over filtered | over unfiltered | miss A, median error % | largest % |")
    cog.outl("| --- | --- |" + " ---: |" * 4)

    def column(of, name, field):
        return [float(row[field]) for row in of if row["column"] == name]

    shares = {}
    for method, part in dict.fromkeys((row["method"], row["parameter"]) for row in rows):
        of, label = [row for row in rows if (row["method"], row["parameter"]) == (method, part)], method.split(", ")[1]
        of_a = [column(of, "demand_miss_rate_without", field) for field in ("replay_speedup", "median_error", "worst_error")]
        gain = _median(of_a[0])
        plain = gain * _median(column(of, "unfiltered_over_filtered", "median_error"))
        cog.outl(f"| {label} | {part} | {gain:.2g} | {plain:.2g} | {_two(_median(of_a[1]))} | {_two(max(of_a[2]))} |")
        shares[label] = _median(column(of, "misses_in_hottest_tenth", "median_error"))
    words = " and ".join(f"{share:.0f} % ({label})" for label, share in shares.items())
    cog.outl(f"\nIn the median run, a tenth of the sets has {words} of a cache's misses without prefetching.")


def hashed_lines(cog) -> None:
    """Write the gain and the errors, in points, of hashed lines."""
    rows = [row for row in rows_of("speed_error.csv") if row["method"] == "hashed lines"]
    cog.outl("| lines followed | speed-up of stack distances | median error, points | largest |")
    cog.outl("| --- | ---: | ---: | ---: |")
    for part in dict.fromkeys(row["parameter"] for row in rows):
        of = [row for row in rows if row["parameter"] == part]
        gain = _median([float(row["replay_speedup"]) for row in of])
        middle, worst = _median([float(row["median_error"]) for row in of]), max(float(row["worst_error"]) for row in of)
        cog.outl(f"| {part} | {gain:.2g} | {middle:.2g} | {worst:.2g} |")


def calibration(cog, target: str) -> None:
    """Write how often the intervals held for a target, run by run."""
    rows = [row for row in rows_of("calibration.csv") if row["target"] == target]
    cog.outl(
        "| scene, tree | pixels | caches | seeds | sampled | all hold % | targeted hold % | worst quantity holds % | "
        "bias / half-width | rays % | reasons for exact counts (times) |"
    )
    cog.outl("| --- | ---: | --- |" + " ---: |" * 7 + " --- |")
    for row in rows:
        head = (
            f"| {row['scene']}, {TREES[row['tree']]} | {row['size'].replace('x', ' x ')} | {row['caches']} | {row['seeds']} "
            f"| {row['sampled']} |"
        )
        if int(row["sampled"]):
            parts = [100 * float(row[name]) for name in ("hold_all", "hold_targeted", "worst_cell_holds")]
            share = 100 * float(row["median_share"])
            head += f" {parts[0]:.1f} | {parts[1]:.1f} | {parts[2]:.1f} | {float(row['bias']):.2f} | {share:.1f} |"
        else:
            head += " exact | | | | |"
        cog.outl(f"{head} {row['reason']} |")
    held = [row for row in rows if int(row["sampled"])]
    if held:
        n = sum(int(row["sampled"]) for row in held)
        every = sum(float(row["hold_all"]) * int(row["sampled"]) for row in held) / n
        least, bias = min(float(row["hold_all"]) for row in held), max(float(row["bias"]) for row in held)
        cog.outl(
            f"\nOver all {n:,} sampled runs it held in {100 * every:.1f} %, and in the worst line in {100 * least:.1f} %."
            f" The largest bias is {bias:.2f} half-widths."
        )
    first = [row for row in rows if row["size"] == "2048x2048" and row["caches"] == "Table I"]
    if first:
        share = 100 * _median([float(row["first_share"]) for row in first])
        half, error = (_median([float(row[name]) for row in first]) for name in ("first_ratio_half", "first_ratio_error"))
        worst = max(float(row["first_ratio_error"]) for row in first)
        cog.outl(
            f"From the first {share:.1f} % of the rays at 2048x2048, the ratios B/A and traffic B/A of all caches are "
            f"correct to {error:.2f} points in 95 % of the seeds in the median run ({worst:.2f} in the worst); the "
            f"half-width stated for all of them at once is {half:.2f} points."
        )


def estimate_speed(cog) -> None:
    """Write the wall times of estimates at 2048x2048 beside those of the exact runs."""
    rows = rows_of("estimate_speed.csv")
    cog.outl(
        "| scene, tree | build, s | exact, s | estimate, s | speed-up, wall | speed-up, CPU | rays % | predicted / exact |"
    )
    cog.outl("| --- |" + " ---: |" * 7)
    for row in rows:
        cells = [f"{float(row[name]):.1f}" for name in ("build_s", "exact_s", "estimate_s", "wall", "cpu")]
        cog.outl(f"| {row['scene']}, {TREES[row['tree']]} | {' | '.join(cells)} | {100 * float(row['share']):.1f} | "
                 f"{row.get('predicted', '')} |")  # fmt: skip
    if rows:
        for name, what in (("wall", "wall time"), ("cpu", "CPU time")):
            values = [float(row[name]) for row in rows]
            cog.outl(f"\nSpeed-up in {what}: median {_median(values):.1f}, least {min(values):.1f}." if values else "")


def arithmetic(cog) -> None:
    """Write the hits that other arithmetic and boxes without margins lose."""
    rows = rows_of("arithmetic.csv")
    cog.outl("| traversal | tree | rays | lost | invented | other triangle | t, p99.9 / kappa | visits % | miss A % | speed |")
    cog.outl("| --- | --- |" + " ---: |" * 8)
    for row in rows:
        cog.outl("| " + " | ".join(row[name] for name in (
            "traversal", "tree", "rays", "lost", "invented", "other", "t_error", "visits", "miss", "speed"
        )) + " |")  # fmt: skip
