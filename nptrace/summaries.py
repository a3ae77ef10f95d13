"""``nptrace.summarise`` and ``nptrace.combine``: parts of a run replayed apart, as the commands of these names do."""

from collections.abc import Iterable
from pathlib import Path

from nptrace.plans import Given, replay_plan
from nptrace.progress import Progress
from nptrace.results import Results
from nptrace.values import PATH, checked
from nptrace_base.places import Place, place
from traces.reader import Run, open_run


@checked(out=PATH)
# Many parameters: one per option of the command, as callers write them and help() lists them.
def summarise(
    run: Run | Place | str, out: Path | str, /, *, part: str | tuple[int, int], size: Given = "8K", ways: Given = "1",
    line: Given = "32", policy: Given = "lru", prefetch: Given = "traced", layout: Given = "stored",
    three_c: bool = False, threads: int | None = None,
) -> Path:  # fmt: skip
    """Replay a part of a run, and write and return a file from which ``combine`` makes the results of the whole run.

    Parameters
    ----------
    run : Run or path
        The whole run.
    out : Path
        The file.
    part : str or (int, int)
        Which of how many parts, ``"3/8"`` or ``(3, 8)``; it can be counted on another machine, at any time.
    size, ways, line, policy, prefetch, layout, three_c, threads
        As those of ``replay``.

    Returns
    -------
    Path
        ``out``.

    Raises
    ------
    NptraceError
        A value is wrong, parts cannot be counted apart (fifo, random, opt, next-line at misses), or the run cannot be read.
    """
    from cachesim.parts import parse_part
    from nptrace.studies import summarised

    chosen = parse_part(part if isinstance(part, str) else "/".join(map(str, part)))
    configs, prefetches, layouts = replay_plan(size, ways, line, policy, 0, prefetch, layout)
    with Progress(len(layouts) * len(prefetches)) as bar:
        summarised(
            run if isinstance(run, Run) else open_run(place(run)), configs, prefetches, layouts, chosen, Path(out), bar,
            three_c=three_c, threads=threads,
        )  # fmt: skip
    return Path(out)


@checked()
def combine(summaries: Path | str | Iterable[Path | str], /) -> Results:
    """Return what ``replay`` returns for the run whose parts, all of them, these summaries are; in any order.

    Parameters
    ----------
    summaries : Path, str or a list of them
        The files of ``summarise``.

    Returns
    -------
    Results
        The rows of ``replay``.

    Raises
    ------
    NptraceError
        A part is missing or twice there, or files are of other runs or questions, or damaged.
    """
    from cachesim.report import replay_tables
    from cachesim.summary_file import combine as combined

    named = [summaries] if isinstance(summaries, (str, Path)) else summaries
    results = combined([Path(each) for each in named])
    return Results("combine", [each.to_dict() for each in results], lambda: replay_tables.tables(results))
