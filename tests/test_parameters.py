"""A function has nine parameters at most, or says beside it why it has more."""

import ast
from pathlib import Path

from nptrace_base.source_files import OURS, ROOT

MOST, REASON = 9, "# Many parameters: "


def long_ones(path: Path):
    """Yield the functions of a file with too many parameters, and the line above each."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            of = node.args
            if len([*of.posonlyargs, *of.args, *of.kwonlyargs]) > MOST:
                yield f"{path.relative_to(ROOT)}: {node.name}", lines[node.lineno - 2]


def test_a_function_with_many_parameters_says_why():
    found = [each for name in OURS for path in ROOT.glob(f"{name}/**/*.py") for each in long_ones(path)]
    assert 10 < len(found) < 30
    assert not [name for name, above in found if not above.strip().startswith(REASON)]
