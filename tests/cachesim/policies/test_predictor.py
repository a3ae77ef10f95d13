"""The ray predictor in the clock against its model, and the keys of rays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cachesim.clock.parameters import PRESETS
from cachesim.clock.stretches import Stretches
from cachesim.clock.timing import time_run
from cachesim.config import CacheConfig
from cachesim.policies.predictor import Predictor, folded, keys_of, learn, look_up
from cachesim.prefetch import parse_prefetch
from cachesim.source import RunSource
from nptrace_base.errors import NptraceError
from rtrace.render import Shooting, render
from rtrace.scenes.stand_ins import stand_in
from rtrace.trees.tree_cache import build_tree
from tests.reference.clock_cases import cases, check_account, config_of, configs, fast_account, machines, slow_account
from tests.reference.policies import SlowPredictor, slow_key
from traces.rays import TracedRays, traced_rays
from traces.reader import open_run

options = st.fixed_dictionaries({
    "entries": st.sampled_from((1, 2, 4, 8)), "ways": st.sampled_from((1, 2, 4)), "origin": st.integers(0, 2),
    "direction": st.integers(0, 2), "up": st.integers(0, 3),
}).filter(lambda options: options["entries"] >= options["ways"])  # fmt: skip


@given(cases, machines, configs, st.integers(1, 8), options)
def test_every_number_is_that_of_the_model(case, numbers, config, n_slots, options):
    text = ":".join(["predictor", *(f"{name}={value}" for name, value in options.items())])
    fast = fast_account(case, numbers, config_of(config), n_slots, text)
    model = SlowPredictor(case.lines, case.trace.parent, case.traced, **options)
    assert fast == slow_account(case, numbers, config_of(config), n_slots, model)
    check_account(fast, n_slots)


def test_the_key_used_least_recently_is_replaced():
    """One set of two ways, and three keys: looking a key up counts as a use, and so does learning its node again."""
    zeros, ray = np.zeros(1, np.int64), [np.int64(i) for i in range(3)]
    unit = Predictor(
        np.array([10, 11, 12]), np.zeros(3, np.int64), np.ones(3, bool), np.full((1, 2), -1), np.zeros((1, 2), np.int64),
        zeros.reshape(1, 1), zeros, zeros, zeros, zeros, 3,
    )  # fmt: skip
    learn(unit, ray[0], np.int64(5))
    learn(unit, ray[1], np.int64(6))
    assert look_up(unit, ray[0]) == 5
    learn(unit, ray[2], np.int64(7))
    assert (look_up(unit, ray[1]), look_up(unit, ray[0]), look_up(unit, ray[2])) == (-1, 5, 7)
    learn(unit, ray[0], np.int64(8))
    learn(unit, ray[1], np.int64(6))
    assert (look_up(unit, ray[2]), look_up(unit, ray[0]), look_up(unit, ray[1])) == (-1, 8, 6)


@given(st.integers(0, 1 << 20), st.integers(0, 40), st.integers(0, 10), st.integers(0, 8))
def test_keys_are_those_of_the_model(seed, n, origin_bits, direction_bits):
    rng = np.random.default_rng(seed)
    rays = TracedRays(
        rng.normal(size=(n, 3)).astype(np.float32), rng.normal(size=(n, 3)).astype(np.float32), rng.random(n) < 0.5,
        np.ones(n, bool),
    )  # fmt: skip
    keys = keys_of(rays, origin_bits, direction_bits)
    assert keys.tolist() == [slow_key(ray, rays, origin_bits, direction_bits) for ray in range(n)]


def test_a_key_by_hand():
    """Half way through the grid along x, at its end along y, at its begin along z; theta 90, phi 180 + 45 degrees."""
    origin = np.array([[0, 0, 0], [8, 8, 8], [4, 9, -1]], np.float32)
    rays = TracedRays(origin, np.array([[1, 1, 0]] * 3, np.float32), np.array([True, True, False]), np.ones(3, bool))
    direction = (225 >> 5) << 3 | 90 >> 5
    assert keys_of(rays, 5, 3).tolist() == [direction, 0b11111_11111_11111 ^ direction, 0b10000_11111_00000 ^ direction]
    assert folded(np.array([0b101_0011_1100]), 16).tolist() == [0b0101 ^ 0b0011 ^ 0b1100]
    assert folded(np.array([7]), 1).tolist() == [0]


@pytest.mark.parametrize("options", ["size=4", "entries=0", "ways=3", "entries=12:ways=4", "up=x", "origin=11"])
def test_bad_options_are_refused(options):
    with pytest.raises(NptraceError, match="write predictor"):
        parse_prefetch(f"predictor:{options}")


@pytest.mark.parametrize("kind", ["kdtree", "bvh64"])
def test_rays_that_read_nothing_have_no_key(kind, tmp_path):
    """The clock numbers the rays that read nodes, and so do the keys."""
    scene = stand_in("blob", detail=0.2)
    render(scene, build_tree(scene.triangles, kind), Shooting(32, 32), tmp_path / "run", threads=1)
    run = open_run(tmp_path / "run")
    n = Stretches(RunSource(run)).n_rays
    assert len(traced_rays(run).is_hit) == n and (n < run.footer.n_rays) == (kind == "kdtree")
    clock = PRESETS["paper"].clock.with_numbers(rays=4)
    (timing,) = time_run(run, [CacheConfig(1024, 2, 64)], [clock], ["predictor"], threads=1)
    assert timing.lines["timely"] > 0
