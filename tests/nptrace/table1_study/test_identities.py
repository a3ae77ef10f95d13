"""What holds for every knob and every policy of the study, whatever the scene."""

from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cachesim.config import CacheConfig
from cachesim.layout import parse_layout
from cachesim.prefetch import parse_prefetch
from cachesim.replay import replay
from cachesim.report.table1 import caches
from nptrace.table1_study.figures import figures_of
from nptrace.table1_study.heights import stack_counts
from nptrace.table1_study.knobs import BVH, KD, KNOBS, REPLAYED, Setting, knob
from nptrace.table1_study.measure import counts_of, lines_touched, rows_of
from nptrace.table1_study.plan import combined, one_at_a_time
from nptrace.table1_study.traced import traced
from rtrace.render import render
from rtrace.scenes.stand_ins import stand_in
from rtrace.shooting import Shooting
from rtrace.trees.tree_cache import cached_tree
from traces.format import LEAF, PUSH, READ, SHADOW
from traces.format import PREFETCH as REQUEST
from traces.reader import open_run

SMALL = Setting(pixels=24)
RUNS = {}


def run_of(kind):
    if kind not in RUNS:
        RUNS[kind] = traced(stand_in("blob"), kind, SMALL, threads=1)
    return RUNS[kind]


def rows(kind, *asked):
    run = run_of(kind)
    return list(rows_of(run, asked, {"scene": "bunny", "tree": kind}, lambda: None))


def check(row):
    """The account closes, and the paper's figures are made of the counts; no cache fetches less than what is touched."""
    filled, fills = row["prefetch_misses"], row["demand_misses"] + row["prefetch_misses"]
    assert filled == row["useful"] + row["useless"] + row["resident"]
    assert 0 <= filled <= row["prefetches"] and row["useful"] <= row["prefetches"]
    assert row["pollution"] <= row["demand_misses"] <= row["demand_accesses"]
    figures = figures_of(row)
    p = row["prefetches"] / row["demand_accesses"]
    assert figures["miss_b"] == pytest.approx(100 * fills / ((1 + p) * row["demand_accesses"]))
    assert figures["miss_ratio"] == pytest.approx(figures["kb_ratio"] / (1 + p))
    assert min(row["misses_a"], fills) >= row["lines_touched"]
    if row["ways"] == 1 and row["policy"] != "opt":  # a direct-mapped set has no choice
        assert fills >= row["misses_a"]


def choice(name):
    found = knob(name)
    return st.sampled_from([getattr(Setting(), name), *dict.fromkeys(found.values[KD] + found.values[BVH])])


@pytest.mark.parametrize("kind", [KD, BVH])
@settings(max_examples=25)
@given(values=st.fixed_dictionaries({name: choice(name) for name in REPLAYED}))
def test_the_identities_hold_for_every_combination_of_the_knobs_of_a_replay(kind, values):
    if values["flush"] == "ray" and values["policy"] not in ("lru", "fifo"):
        values["policy"] = "fifo"
    for row in rows(kind, replace(SMALL, **values)):
        check(row)


@pytest.mark.parametrize("kind", [KD, BVH])
def test_every_default_is_that_of_the_program(kind, tmp_path):
    """A row of the default is what ``render`` and ``replay`` give: the same run, the recorded requests."""
    scene = stand_in("blob")
    render(scene, cached_tree(scene, kind), Shooting(24, 24), tmp_path / "run")
    results = replay(open_run(tmp_path / "run"), caches())
    for row, result in zip(rows(kind, SMALL), results, strict=True):
        assert {name: row[name] for name in counts_of(result)} == counts_of(result)
        assert row["rays"] == result.n_rays
    usual = {each.name: each.default for each in fields(Shooting)}
    for each in fields(Setting):
        if each.name in usual:
            assert each.default == usual[each.name], each.name
    assert Setting().pixels == usual["width"] == usual["height"]


@pytest.mark.parametrize("kind", [KD, BVH])
def test_every_value_of_a_knob_is_one_of_the_program_and_each_matters_or_is_the_cache_s(kind):
    asked = [each for each in one_at_a_time(Setting(), kind)]
    for setting in asked:
        parse_prefetch(setting.prefetch)
        parse_layout(setting.layout)
        CacheConfig(8192, 1, 32, setting.policy)
    assert len(asked) == len(set(asked)) == 1 + sum(len(each.values[kind]) for each in KNOBS)
    names = {each.name for each in fields(Setting)}
    assert {each.name for each in KNOBS} == names
    everywhere, own = ({*combined(Setting(), kind, is_own=is_own)} for is_own in (False, True))
    assert Setting() in everywhere < own


@pytest.mark.parametrize("kind", [KD, BVH])
def test_heights_are_those_of_a_stack_kept_in_a_list(kind):
    run = run_of(kind)
    wanted = {f"{which}_{name}": 0 for which in ("primary", "shadow")
              for name in ("leaves", "leaves_few", "leaf_entries", "ended", "ended_with_entries")}  # fmt: skip
    types, n_prims = iter(run.types[run.has_rows].tolist()), run.columns("nodes", ["n_prims"])["n_prims"].tolist()
    stack, last, which = [], None, ""

    def end():
        wanted[f"{which}_ended"] += 1
        wanted[f"{which}_ended_with_entries"] += bool(stack)

    for node, row in zip(*(column.tolist() for column in run.rows), strict=True):
        assert row != REQUEST
        if node == 0:
            if which:
                end()
            stack, which = [], "shadow" if next(types) == SHADOW else "primary"
        elif last == PUSH:
            stack.append(((node - 1) ^ 1) + 1)
        elif last == LEAF or (last == READ and kind == BVH):
            while stack.pop() != node:
                pass
        if row == LEAF and n_prims[node]:
            wanted[f"{which}_leaves"] += 1
            wanted[f"{which}_leaves_few"] += len(stack) <= 3
            wanted[f"{which}_leaf_entries"] += len(stack)
        last = row
    end()
    assert stack_counts(run) == wanted
    assert wanted["primary_leaf_entries"] > wanted["primary_leaves"] > 0 < wanted["shadow_leaves"]
    assert (wanted["primary_ended_with_entries"] > 0) == (kind == KD)  # a BVH's stack drains


def test_lines_touched_are_those_of_the_nodes_visited():
    for kind in (KD, BVH):
        run = run_of(kind)
        for layout in ("stored", "stored+8", "veb"):
            lines = run.source(layout).lines(32, 0)
            read, _ = lines.accesses(run.rows[0], run.rows[1] * 0)
            assert lines_touched(run, lines.of_nodes()) == len(set(read.tolist()))
