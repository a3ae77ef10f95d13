"""``python -m nptrace.table1_study [--quick] [--out FOLDER] -o FILE``: measure every setting, and write the rows."""

import hashlib
import json
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from nptrace.progress import Progress, done, say
from nptrace.table1_study import measure
from nptrace.table1_study.heights import stack_counts
from nptrace.table1_study.measure import rows_of
from nptrace.table1_study.plan import StudyJob, plan
from nptrace.table1_study.traced import traced
from nptrace_base.atomic import whole_file
from nptrace_base.records import write_parquet
from nptrace_base.source_files import digest_of


@click.command()
@click.option("--quick", is_flag=True, help="Small pictures and few settings, for a test of the whole chain.")
@click.option(
    "--out", "folder", type=click.Path(path_type=Path), default="traces/study", show_default=True,
    help="Folder for finished parts; the same command goes on where it stopped.",
)  # fmt: skip
@click.option("-o", "--output", "path", type=click.Path(path_type=Path), required=True, help="The table, in Parquet.")
@click.option("--threads", type=click.IntRange(1), default=2, show_default=True, help="Runs measured at a time.")
@click.option("--limit", type=click.IntRange(0), help="Measure so many parts at most, and write what there is.")
def main(quick: bool, folder: Path, path: Path, threads: int, limit: int | None) -> None:
    """Measure what Table I of the paper measures, knob by knob."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    began, jobs = time.perf_counter(), plan(quick=quick)
    folder.mkdir(parents=True, exist_ok=True)
    parts = [_part(folder, job) for job in jobs]
    waiting = [(job, part) for job, part in zip(jobs, parts, strict=True) if not part.exists()][:limit]
    say(f"{len(jobs)} runs, {sum(len(job.settings) for job in jobs)} settings of four caches; {len(waiting)} runs to measure")
    with Progress() as bar, ThreadPoolExecutor(threads) as pool:
        bar.job("study")
        advance = bar.phase("measure", sum(len(job.settings) for job, _ in waiting))
        for future in as_completed([pool.submit(_measure, job, part, lambda: advance(1)) for job, part in waiting]):
            future.result()
    table = pa.concat_tables([pq.read_table(part) for part in parts if part.exists()])
    with whole_file(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", compression_level=19)
    done(f"{len(table)} rows", began)


def _part(folder: Path, job: StudyJob) -> Path:
    """Return the file of a job's rows: its name tells the job, the scene and the program."""
    view = job.view
    asked: list[Any] = [job.of_run, view.seen.sha256, repr(view.seen.camera), view.seen.light, list(map(asdict, job.settings))]
    key = json.dumps([*asked, digest_of([Path(measure.__file__)])], sort_keys=True)
    return folder / f"part-{hashlib.sha256(key.encode()).hexdigest()[:16]}.parquet"


def _measure(job: StudyJob, path: Path, advance: Callable[[], object]) -> None:
    """Trace a run, replay it and write its rows."""
    run = traced(job.view.seen, job.tree, job.settings[0], threads=1)
    rows = list(rows_of(run, job.settings, job.of_run | stack_counts(run), advance))
    with whole_file(path) as temporary:
        write_parquet(rows, temporary)


if __name__ == "__main__":
    main()
