"""A run's files, read with DuckDB, and a slow cache's counts of them: the reference for every printed value."""

import json
import re

import duckdb
import pyarrow.parquet as pq

from cachesim.config import CacheConfig
from tests.reference.cache import Cache, derive, pieces

NODE_BYTES = {"kdtree": 8, "bvh": 32}


def query(run, table, sql):
    """Return the rows of a query; ``FROM it`` is a table of the run."""
    return duckdb.sql(f"WITH it AS (FROM read_parquet('{run}/{table}.parquet')) {sql}").fetchall()


def events(run, tree, prefetch, base=0):
    """Return (address, size, label) of every access of a run under a prefetch policy."""
    rows = query(run, "accesses", "SELECT node, kind FROM it")
    nodes = query(run, "nodes", "SELECT address, n_prims FROM it ORDER BY node")
    if prefetch == "traced":
        seen = [(node, kind == 3) for node, kind in rows]
    elif prefetch == "stack:tris*2":
        seen = derive(rows, tree, [n_prims for _, n_prims in nodes], budget=2, per_triangle=True)
    else:
        seen = [(node, False) for node, kind in rows if kind != 3]
    return [(base + nodes[node][0], NODE_BYTES[tree], 11 if is_request else 0) for node, is_request in seen]


def replayed(trace, config, prefetch="none"):
    """Return the slow cache after a trace of (address, size, label)."""
    trigger = prefetch.split(":")[1] if prefetch.startswith("next-line") else None
    return Cache(config).replay(pieces(trace, config.line_bytes), trigger)


def share(a, b):
    return a / b if b else None


def values_of(run, tree, config, prefetch, base=0):
    """Return every value that is printed of a replay, by its name in the JSON."""
    full = replayed(events(run, tree, prefetch, base), config, prefetch)
    alone = replayed(events(run, tree, "none", base), config)
    accesses, misses = full.counts["accesses"], full.counts["misses"]
    demand, demand_misses, requests, filled = sum(accesses[:8]), sum(misses[:8]), sum(accesses[8:]), sum(misses[8:])
    without = sum(alone.counts["misses"])
    return {
        "size_bytes": config.size_bytes, "ways": config.ways, "line_bytes": config.line_bytes, "policy": config.policy,
        "policy_seed": config.seed if config.policy == "random" else None,
        "prefetch": prefetch, "layout": f"stored+{base}" if base else "stored", "reads": "own", "flush": "never",
        "demand_accesses": demand, "demand_misses": demand_misses, "prefetch_accesses": requests, "prefetch_misses": filled,
        **{kind: sum(full.counts[kind][:8]) for kind in ("compulsory", "capacity", "conflict")},
        "redundant": requests - filled, "filled": filled, "useful": full.useful, "useless": full.useless,
        "resident": len(full.unused), "pollution": full.pollution, "demand_misses_without": without,
        "bytes_from_memory": (demand_misses + filled) * config.line_bytes,
        "demand_miss_rate": share(demand_misses, demand), "paper_miss_rate": share(demand_misses + filled, demand + requests),
        "accuracy": share(full.useful, filled), "coverage": 1 - demand_misses / without,
        "traffic_ratio": (demand_misses + filled) / without,
    }  # fmt: skip


def identity_of(run):
    """Return the columns that say which run a row is of, from the footer of a file and the place."""
    footer = json.loads(pq.read_metadata(run / "rays.parquet").metadata[b"nptrace"])
    camera = {name: ",".join(map(repr, footer["camera"][name])) for name in ("eye", "look_at", "up")}
    params = {name: value for name, value in footer["tree"].items() if name not in ("kind", "node_bytes")}
    return {
        "run": run.name, "path": str(run), "scene": footer["scene"]["name"], "stand_in": footer["scene"]["stand_in"],
        "tree": footer["tree"]["kind"], "builder": " ".join(f"{name}={params[name]}" for name in sorted(params)),
        "width": footer["width"], "height": footer["height"], "order": footer["order"],
        "order_seed": footer["seed"] if footer["order"] == "random" else None, "batch": footer["batch"],
        "packet": footer.get("packet", 1), "shadow": footer.get("shadow", "lit"),
        "shadow_order": footer.get("shadow_order", "sign"), "shadow_end": footer.get("shadow_end", "stop"),
        "camera": "eye={eye} at={look_at} up={up} fov=".format(**camera) + repr(footer["camera"]["fov"]),
        "light": ",".join(map(repr, footer["light"])),
    }  # fmt: skip


def number(value, decimals=0, scale=1):
    """Return a value as a table prints it."""
    return "-" if value is None else f"{value * scale:,.{decimals}f}"


def table_rows(text, start):
    """Return the words of every line of a printed table that matches ``start``."""
    return [line.split() for line in text.splitlines() if re.match(start, line)]


def config_of(size, ways, line=32, policy="lru", seed=0):
    return CacheConfig(size, ways, line, policy, seed)
