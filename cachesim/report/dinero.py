"""A Result as DineroIV prints it: the statistics block, row for row and byte for byte.

Columns are Total, Instrn, Data (read, write and misc), Read, Write and Misc. Rows about prefetches appear, as there, with any
fetch policy except demand; rows about the three kinds of misses appear on request. A rate whose denominator is 0 is
printed as its numerator, as DineroIV does.
"""

import numpy as np

from cachesim.access import IFETCH, MISC, PREFETCH, READ, WRITE
from cachesim.result import Result

_HEADER = (
    " Metrics\t\t      Total\t      Instrn\t       Data\t       Read\t      Write\t       Misc\n"
    + " -----------------\t"
    + "\t".join(["      ------"] * 6)
    + "\n"
)


def dinero_block(result: Result, *, name: str = "l1-ucache", prefetch_rows: bool | None = None) -> str:
    """Return the statistics block of one result.

    Parameters
    ----------
    result : Result
    name : str
        The cache's name, the block's first line.
    prefetch_rows : bool, optional
        Whether to print the rows about prefetches (DineroIV: ``-fetch l``, not ``-fetch d``); when None, if the replay
        had a prefetcher or prefetches.
    """
    if prefetch_rows is None:
        prefetch_rows = result.prefetch.startswith("next-line") or result.prefetch_accesses > 0
    demand, requests = _columns(result.accesses, 0), _columns(result.accesses, PREFETCH)
    demand_misses, request_misses = _columns(result.misses, 0), _columns(result.misses, PREFETCH)
    total, total_misses = demand + requests, demand_misses + request_misses
    text = [name, "\n", _HEADER]
    text += [_counts(" Demand Fetches\t", demand), _rates("  Fraction of total", demand / _or_one(demand[0]))]
    if prefetch_rows:
        text += [_counts(" Prefetch Fetches", requests), _rates("  Fraction\t", requests / _or_one(requests[0]))]
        text += [_counts(" Total Fetches\t", total), _rates("  Fraction\t", total / _or_one(total[0]))]
    text += ["\n", _counts(" Demand Misses\t", demand_misses)]
    text += [_rates("  Demand miss rate", demand_misses / _or_one(demand))]
    if result.has_3c:
        text += _three_c(result, 0, demand_misses, "{}", "fraction")
    if prefetch_rows:
        text += [_counts(" Prefetch Misses", request_misses)]
        text += [_rates("  PF miss rate\t", request_misses / _or_one(requests))]
        if result.has_3c:
            text += _three_c(result, PREFETCH, request_misses, "PF {}", "fract")
        text += [_counts(" Total Misses\t", total_misses), _rates("  Total miss rate", total_misses / _or_one(total))]
    per_fetch = result.bytes_from_memory / _or_one(demand)[0]
    text += ["\n", f" Multi-block refs      {result.n_splits:12.0f}\n"]
    text += [f" Bytes From Memory\t{result.bytes_from_memory:12.0f}\n", f" ( / Demand Fetches)\t{per_fetch:12.4f}\n"]
    text += [f" Bytes To Memory\t{0:12.0f}\n", f" ( / Demand Writes)\t{0:12.4f}\n"]
    text += [f" Total Bytes r/w Mem\t{result.bytes_from_memory:12.0f}\n", f" ( / Demand Fetches)\t{per_fetch:12.4f}\n", "\n"]
    return "".join(text)


def _columns(per_type: np.ndarray, mark: int) -> np.ndarray:
    read, write, fetch, misc = (float(per_type[mark | type_]) for type_ in (READ, WRITE, IFETCH, MISC))
    return np.array([fetch + read + write + misc, fetch, read + write + misc, read, write, misc])


def _or_one(values: np.ndarray | float) -> np.ndarray:
    return np.where(np.asarray(values) == 0, 1.0, values)


def _counts(label: str, values: np.ndarray) -> str:
    return f"{label}\t" + "\t".join(f"{value:12.0f}" for value in values) + "\n"


def _rates(label: str, values: np.ndarray) -> str:
    return f"{label}\t" + "\t".join(f"{value:12.4f}" for value in values) + "\n"


def _three_c(result: Result, mark: int, misses: np.ndarray, name: str, fraction: str) -> list[str]:
    kinds = {
        "compulsory": _columns(result.compulsory, mark),
        "capacity": _columns(result.capacity, mark),
        "conflict": _columns(result.conflict, mark),
    }
    names = {kind: "   " + name.format(kind if mark else kind.capitalize()) for kind in kinds}
    rows = [_counts(f"{names[kind]} misses", values) for kind, values in kinds.items()]
    return rows + [_rates(f"{names[kind]} {fraction}", values / _or_one(misses)) for kind, values in kinds.items()]
