"""A policy of another package: registered by an entry point, it replays and is timed, and never runs from old source."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.reference.traces import make_trace, write

ROOT = Path(__file__).resolve().parents[3]

TOY = '''"""Request one and the same node at every leaf."""

from typing import NamedTuple

import numpy as np

from cachesim.policies import Policy, no_options
from cachesim.policies.hooks import NOTHING
from cachesim.policies.machine import drop, offer, stop_waiting

NODE = 1


class Toy(NamedTuple):
    wants: np.ndarray

    def on_leaf(self, machine, slot, node):
        self.wants[slot] = 1
        offer(machine, slot, 1)

    def on_leaf_end(self, machine, slot):
        if self.wants[slot] == 1:
            drop(machine, slot, 1)
            stop_waiting(machine, slot)
            self.wants[slot] = 0

    def request(self, machine, slot):
        return np.int64(NODE if self.wants[slot] == 1 else NOTHING)

    def requested(self, machine, slot):
        self.wants[slot] = 0


POLICY = Policy("toy", "toy", no_options, lambda machine, facts: Toy(np.zeros(machine.sp.size, np.int64)), watches_leaves=True)
'''
USE = """
import json, sys
import numpy as np
from cachesim.clock.parameters import PRESETS
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from cachesim.source import RunSource
from traces.reader import open_run

run, configs = open_run(sys.argv[1]), [CacheConfig(256, 2, 32)]
events = [each for batch in RunSource(run).events(parse_prefetch("toy")) for each in zip(*batch)]
[counts] = replay(run, configs, prefetch="toy")
[timing] = time_run(run, configs, [PRESETS["paper"].clock.with_numbers(rays=3)], ["toy"])
print(json.dumps({
    "requests": sorted({int(node) for node, access_type in events if access_type}), "replayed": counts.prefetch_accesses,
    "timed": timing.lines, "candidates": timing.candidates, "name": timing.prefetch, "speed_up": timing.speed_up,
}))
"""


@pytest.fixture
def package(tmp_path):
    """Return the folder of an installed package with a policy."""
    folder = tmp_path / "installed"
    about = folder / "toy-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[nptrace.policies]\ntoy = toy:POLICY\n")
    (folder / "toy.py").write_text(TOY)
    return folder


def used(package, run):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(package), str(ROOT)]), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", USE, str(run)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_it_replays_and_is_timed_and_its_source_may_change(package, tmp_path):
    trace = make_trace("kdtree", 5, n_rays=40)
    write(trace, tmp_path / "run")
    n_leaves, n_tests = (sum(kind == 2 and trace.n_prims[node] >= least for _, node, kind in trace.rows) for least in (0, 1))
    last = len(trace.parent) - 1
    for node in (1, last):
        (package / "toy.py").write_text(TOY.replace("NODE = 1", f"NODE = {node}"))
        found = used(package, tmp_path / "run")
        assert (found["name"], found["requests"], found["replayed"]) == ("toy", [node], n_leaves)
        assert found["candidates"]["offered"] == n_tests
        assert found["candidates"]["issued"] == sum(found["timed"][name] for name in ("redundant", "joined", "filled"))
        if node == 1:
            first = found
    assert found["timed"] != first["timed"]
