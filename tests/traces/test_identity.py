"""Which run a row is of: no two runs have one label, and what varies is told once."""

from dataclasses import replace
from itertools import pairwise

import pytest

from tests.reference.traces import make_footer
from traces.footer import CameraFacts, SceneFacts, TreeFacts
from traces.identity import COLUMNS, RunIdentity, identity_of, labels

SCENE = SceneFacts("sponza", "Sponza", "", "", 8, False)
FOOTER = make_footer(scene=SCENE, tree=TreeFacts("bvh", 32, {"builder": "sweep"}), width=128, height=128)
CHANGES = {
    "scene": {"scene": replace(SCENE, name="bunny")},
    "stand-in": {"scene": replace(SCENE, stand_in=True)},
    "kdtree": {"tree": TreeFacts("kdtree", 8, {"c_trav": 1.5})},
    "binned": {"tree": TreeFacts("bvh", 32, {"builder": "binned"})},
    "512x128": {"width": 512},
    "morton": {"order": "morton"},
    "batch 0": {"batch": 0},
    "packet 64": {"packet": 64},
    "shadow hit": {"shadow": "hit"},
    "shadow-order cheaper": {"shadow_order": "cheaper"},
    "shadow-end drain": {"shadow_end": "drain"},
    "camera": {"camera": CameraFacts((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 45.0)},
    "light": {"light": (1.0, 0.0, 0.0)},
}


def test_a_run_has_every_column():
    identity = identity_of(FOOTER, "sponza-bvh", "traces/sponza-bvh")
    assert list(identity.to_dict()) == list(COLUMNS)
    for name, value in identity.to_dict().items():
        assert value is None or type(value) is COLUMNS[name]
    assert (identity.builder, identity.pixels, identity.order_seed) == ("builder=sweep", "128x128", None)
    assert identity_of(make_footer(order="random", seed=7), "x").order_seed == 7
    assert [value for value in RunIdentity("x.din").to_dict().values() if value is not None] == ["x.din"]


@pytest.mark.parametrize("what", CHANGES)
def test_what_varies_is_told_unless_the_name_tells_it(what):
    one, other = identity_of(FOOTER, "one", "a/one"), identity_of(replace(FOOTER, **CHANGES[what]), "other", "a/other")
    told = labels([one, other])
    assert told[one] != told[other]
    assert ("bunny" if what == "scene" else what) in told[other]
    named = replace(other, run=f"other-{what.replace(' ', '')}")
    if what not in ("scene", "stand-in", "camera", "light"):
        assert labels([one, named])[named] == named.run


def test_what_of_packets_and_shadow_rays_is_not_as_usual():
    assert identity_of(FOOTER, "x").knobs == RunIdentity("x.din").knobs == []
    other = replace(FOOTER, packet=16, shadow="all", shadow_order="cheaper", shadow_end="drain")
    assert identity_of(other, "x").knobs == ["packet 16", "shadow all", "shadow-order cheaper", "shadow-end drain"]


def test_runs_of_one_name_are_told_by_their_paths():
    runs = [identity_of(FOOTER, "sponza-bvh", path) for path in ("a/sponza-bvh", "b/sponza-bvh")]
    assert list(labels(runs).values()) == ["a/sponza-bvh", "b/sponza-bvh"]
    assert list(labels(runs[:1] * 2).values()) == ["sponza-bvh"]
    assert list(labels(runs[:1], by_path=True).values()) == ["a/sponza-bvh"]


def test_all_labels_differ():
    everything = [identity_of(FOOTER, "run", "0/run")]
    everything += [identity_of(replace(FOOTER, **change), "run", f"{i}/run") for i, change in enumerate(CHANGES.values(), 1)]
    told = sorted(labels(everything).values())
    assert all(a != b for a, b in pairwise(told))


def test_scenes_differ_in_their_cameras_by_nature():
    other = replace(FOOTER, scene=replace(SCENE, name="bunny"), **CHANGES["camera"], **CHANGES["light"])
    assert list(labels([identity_of(FOOTER, "sponza-bvh"), identity_of(other, "bunny-bvh")]).values()) == [
        "sponza-bvh", "bunny-bvh",
    ]  # fmt: skip
