"""docs/pay.py: beside the fastest line and layout of each scene stands the best single one for all of them."""

import sys

from tests.checks import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import pay


def row(run, line, layout, speed_up, traffic="1.0", **changes):
    of = {"run": run, "tree": "bvh", "group": "baseline", "prefetch": "none", "line_bytes": line, "layout": layout}
    return of | {"speed_up": speed_up, "traffic_ratio": traffic} | changes


def test_one_line_and_layout_for_all_scenes(monkeypatch):
    """The fastest of some twenty cases, chosen scene by scene, stood against one fixed unit."""
    rows = [
        row("a", "64", "veb", "2.0"), row("b", "64", "veb", "1.1"),
        row("a", "32", "dfs", "1.5"), row("b", "32", "dfs", "1.7"),
        row("a", "64", "bfs", "3.0", "1.2"), row("b", "64", "bfs", "3.0"),
        row("b", "128", "bfs", "9.0"), row("b", "32", "stored", "9.0", group="policy"),
    ]  # fmt: skip
    monkeypatch.setattr(pay, "_rows", lambda name: rows)
    assert pay.one_for_all("bvh") == "1.50 to 1.70x (32 B, `dfs`)"
    assert pay.most_without_unit("bvh") == 9
    monkeypatch.setattr(pay, "_rows", lambda name: rows[6:])
    assert pay.one_for_all("kdtree") == "none"
