"""No module imports itself through others, wherever in its text it imports them; import-linter looks at floors only."""

import graphlib

from nptrace_base.sources import ROOT, _imported

FILES = [path for part in ("nptrace", "nptrace_base", "rtrace", "cachesim", "traces") for path in (ROOT / part).rglob("*.py")]


def test_imports_make_no_circle():
    arrows = {path: {other for other in _imported(path) if other != path} for path in FILES}
    assert sum(map(len, arrows.values())) > 200
    order = list(graphlib.TopologicalSorter(arrows).static_order())  # CycleError has the files of a circle
    assert set(FILES) <= set(order)
