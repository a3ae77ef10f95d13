"""The two commands, nptrace and npcache, assembled from ``nptrace.commands``."""

from nptrace.groups import Commands

nptrace = Commands(
    "nptrace", ["render", "scenes", "info", "view", "check", "export", "map", "compile"],
    help="Stage 1: render scenes and record every node access.",
)  # fmt: skip
npcache = Commands(
    "npcache", ["replay", "sweep", "time", "compare", "estimate", "table1", "plot"],
    help="Stage 2: replay node accesses through node caches.",
)  # fmt: skip
