"""No module imports itself through others, wherever in its text it imports them; import-linter looks at floors only.

A package that finds its modules by listing its folder imports them when it is asked to, and not on the way to any of them.
"""

import graphlib

from nptrace_base.source_files import ROOT, _files, _names

PACKAGES = ("nptrace", "nptrace_base", "rtrace", "cachesim", "traces")
TEXTS = {str(path): path.read_text(encoding="utf-8") for part in PACKAGES for path in (ROOT / part).rglob("*.py")}


def test_imports_make_no_circle():
    arrows = {path: {file for name in _names(text) for file in _files(name)} - {path} for path, text in TEXTS.items()}
    assert sum(map(len, arrows.values())) > 200
    order = list(graphlib.TopologicalSorter(arrows).static_order())  # CycleError has the files of a circle
    assert set(TEXTS) <= set(order)
