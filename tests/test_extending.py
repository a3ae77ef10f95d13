"""What docs/extending.md names is there: its code is that of the program, its files, names and entry points exist."""

import re

from cachesim.policies import GROUP
from tests.pages import ROOT, read_page

PAGE = ROOT / "docs" / "extending.md"
TEXT = PAGE.read_text(encoding="utf-8")
#: Words of the page that are no names of ours.
OTHERS = {"--help", "NamedTuple", "level", "parent", "1.5"}


def test_code_of_the_program_is_written_by_cog():
    blocks = [block for block in read_page(PAGE).blocks if block.language == "python"]
    assert len(blocks) >= 3 and all(block.is_made for block in blocks)
    assert f'[project.entry-points."{GROUP}"]' in TEXT and f"the group `{GROUP}`" in TEXT


def test_every_file_and_name_is_there():
    paths = set(re.findall(r"`((?:\w+/)*[\w]+\.(?:py|json|txt)|(?:\w+/)+)`", TEXT))
    assert len(paths) > 25
    for path in paths:
        assert (ROOT / path.replace("NAME.py", "")).exists(), path
    rows = [line for line in TEXT.splitlines() if line.startswith("| a ")]
    assert len(rows) >= 8
    for row in rows:
        files = [ROOT / path for path in re.findall(r"`([\w/]+\.(?:py|json|txt))`", row) if "NAME" not in path]
        folders = [ROOT / path for path in re.findall(r"`([\w/]+/)(?:NAME\.py)?`", row)]
        sources = "".join(
            p.read_text(encoding="utf-8") for f in (*files, *folders) for p in (f.rglob("*.py") if f.is_dir() else [f])
        )
        for name in set(re.findall(r"`([A-Za-z_][\w.]*)(?:\(\))?`", row)) - OTHERS:
            if not name.endswith((".py", ".json", ".txt")):
                assert name.rpartition(".")[2] in sources, (name, row)
