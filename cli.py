"""The two commands, nptrace and npcache, assembled from ``nptrace.commands``."""

from nptrace.commands.check import check
from nptrace.commands.compare import compare
from nptrace.commands.compile import compile_
from nptrace.commands.estimate import estimate
from nptrace.commands.export import export
from nptrace.commands.render import render
from nptrace.commands.replay import replay
from nptrace.commands.scenes import scenes
from nptrace.commands.sweep import sweep
from nptrace.commands.table1 import table1
from nptrace.commands.time import time_
from nptrace.groups import Commands

nptrace = Commands(
    "nptrace", [render, scenes, check, export, compile_], help="Stage 1: render scenes and record every node access."
)
npcache = Commands("npcache", [replay, sweep, time_, compare, estimate, table1], help="Stage 2: replay node accesses through node caches.")
