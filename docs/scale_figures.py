"""The tables of docs/scale.md, from the files that tests/bench/scale.py writes."""

from figures import rows_of

#: The rates, and how they are printed.
RATES = {
    "render_per_access": ("rendering, ns an access", 1e9), "replay_per_access": ("replay from Parquet, ns an access", 1e9),
    "join": ("joining two summaries, ms", 1e3), "summary_bytes": ("a summary file, KB", 1 / 1024),
    "begin": ("start of a worker, s", 1.0),
}  # fmt: skip
WORDS = {"replay": "Replay", "render and replay": "Rendering and replay"}


def rates(cog) -> None:
    """Write what was measured."""
    values = {row["rate"]: float(row["value"]) for row in rows_of("scale_rates.csv")}
    cog.outl("| " + " | ".join(title for title, _ in RATES.values()) + " |")
    cog.outl("|" + " ---: |" * len(RATES))
    cog.outl("| " + " | ".join(f"{values[name] * by:.3g}" for name, (_, by) in RATES.items()) + " |")


def study(cog) -> None:
    """Write wall time and efficiency by the number of workers."""
    rows = rows_of("scale.csv")
    workers = list(dict.fromkeys(row["workers"] for row in rows))
    cog.outl("| accesses | | core hours | " + " | ".join(f"{int(n):,}" for n in workers) + " |")
    cog.outl("| ---: | --- | ---: |" + " ---: |" * len(workers))
    for n, work in dict.fromkeys((row["accesses"], row["work"]) for row in rows):
        of = [row for row in rows if (row["accesses"], row["work"]) == (n, work)]
        cells = [f"{_time(float(row['wall s']))}, {100 * float(row['efficiency']):.0f} %" for row in of]
        cog.outl(f"| 10^{len(n) - 1} | {work} | {_three(float(of[0]['core hours']))} | {' | '.join(cells)} |")


def limits(cog) -> None:
    """Write where more workers stop helping, in sentences."""
    rows = rows_of("scale.csv")
    for n, work in dict.fromkeys((row["accesses"], row["work"]) for row in rows):
        of = [row for row in rows if (row["accesses"], row["work"]) == (n, work)]
        best = min(of, key=lambda row: float(row["wall s"]))
        well = [row for row in of if float(row["efficiency"]) >= 0.5]
        most = max(well, key=lambda row: int(row["workers"])) if well else None
        half = f"{int(most['workers']):,} workers are busy at least half of the time" if most else "workers mostly wait"
        cog.outl(
            f"- {WORDS[work]} of 10^{len(n) - 1} accesses: {half}; the least time is {_time(float(best['wall s']))} on "
            f"{int(best['workers']):,}, which send {_three(float(best['summaries MB']))} MB of summaries."
        )


def causes(cog) -> None:
    """Write how much less time a replay of 10^12 accesses would take without each limit."""
    rows = rows_of("scale_limits.csv")
    for n in dict.fromkeys(row["workers"] for row in rows):
        of = sorted((row for row in rows if row["workers"] == n), key=lambda row: -float(row["saved s"]))
        parts = [f"{row['without']} {_time(max(float(row['saved s']), 0.0))}" for row in of]
        cog.outl(f"- {int(n):,} workers take {_time(float(of[0]['wall s']))}: {', '.join(parts)}.")


def network(cog) -> None:
    """Write the cost of a ray, the bytes of a run, and how many of them workers write in a second."""
    rates = {row["rate"]: float(row["value"]) for row in rows_of("scale_rates.csv")}
    large = max(rows_of("scaling.csv"), key=lambda row: int(row["accesses"]))
    per_ray, per_access = (int(large["accesses"]) / int(large["rays"]), int(large["bytes"]) / int(large["accesses"]))
    picture = f"{large['scene']} as a BVH at {large['pixels a side']} x {large['pixels a side']}"
    render, replay = (_three(1e6 * per_ray * rates[f"{name}_per_access"]) for name in ("render", "replay"))
    cog.outl(
        f"- A ray of {picture} makes {_three(per_ray)} accesses: at the rates above it takes {render} us to render and "
        f"{replay} us to replay."
    )
    cog.outl(
        f"- A run of that picture has {_three(per_access)} bytes for each access. Workers write all of them when they render, "
        "and read those of the accesses when they replay:"
    )
    rows = [row for row in rows_of("scale.csv") if row["work"] == "render and replay"]
    for n in dict.fromkeys(row["accesses"] for row in rows):
        best = min((row for row in rows if row["accesses"] == n), key=lambda row: float(row["wall s"]))
        gigabytes, seconds = per_access * float(n) / 1e9, float(best["wall s"])
        cog.outl(
            f"  {_three(gigabytes)} GB for 10^{len(n) - 1} accesses, which is {_three(gigabytes / seconds)} GB/s for the "
            f"{int(best['workers']):,} workers that take {_time(seconds)}{'.' if n == rows[-1]['accesses'] else ','}"
        )


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{_three(seconds / 3600)} h"


def _three(value: float) -> str:
    """Return three digits of a number, without an exponent."""
    return f"{float(f'{value:.3g}'):,g}"
