"""One name has one meaning: no two modules define a public class, or a type, of the same name; modules stay short."""

import ast
from collections import defaultdict
from pathlib import Path

from nptrace_base.source_files import OURS, ROOT

MOST_LINES = 400


def sources():
    return [path for name in OURS for path in ROOT.glob(f"{name}/**/*.py")]


def defined(path: Path):
    """Yield the classes and the named types that a file defines, also within functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    yield from (node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if name[0].isupper() and not name.isupper():
                yield name


def test_no_two_modules_define_a_type_of_one_name():
    places = defaultdict(list)
    for path in sources():
        for name in defined(path):
            if not name.startswith("_"):
                places[name].append(path.relative_to(ROOT).as_posix())
    assert len(places) > 150
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_a_module_is_short_and_its_first_line_says_what_it_is():
    for path in sources():
        text = path.read_text(encoding="utf-8")
        assert text.count("\n") <= MOST_LINES, path
        assert (ast.get_docstring(ast.parse(text)) or "").strip(), path
