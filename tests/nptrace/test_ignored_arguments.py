"""Arguments without effect are refused from Python as on the command line; those with an effect are taken."""

import pytest

import nptrace as nt
from tests.nptrace.test_terminal import inputs

RUN = "traces/bunny-bvh"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs(tmp_path)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: nt.render("ball.obj", accel="bvh", kd="max_leaf=4"), "kd: accel asks for no kd-tree"),
        (lambda: nt.render("ball.obj", accel=["KDTREE"], bvh="binned"), "bvh: accel asks for no BVH"),
        (lambda: nt.estimate("ball.obj", accel="kdtree", bvh_nodes=64), "bvh_nodes: accel asks for no BVH"),
        (lambda: nt.render("ball.obj", seed=3), "seed: nothing is random"),
        (lambda: nt.replay(RUN, seed=3), "seed: nothing is random"),
        (lambda: nt.time(RUN, policy=["lru", "fifo"], seed=3), "seed: nothing is random"),
        (lambda: nt.replay(RUN, traces="other"), "traces: the runs to read are named"),
        (lambda: nt.compare([nt.open(RUN)], traces="other"), "traces: the runs to read are named"),
    ],
)
def test_it_is_refused(call, sentence):
    with pytest.raises(nt.NptraceError) as caught:
        call()
    assert str(caught.value) == f"{sentence}, so it has no effect; leave it out"


def test_it_is_taken():
    assert len(nt.replay(RUN, policy="lru,RANDOM", seed=3)) == 2
    assert len(nt.replay(traces="traces", seed=0)) == 2
    nt.render("ball.obj", accel="kdtree, BVH", kd="max_leaf=4", bvh="binned", order="random", seed=3, pixels="8x8")
    nt.estimate("ball.obj", accel="bvh", bvh="binned", seed=3, pixels="8x8")
