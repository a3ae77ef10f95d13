"""The harness that breaks the program on purpose: what it compiles again, what it keeps, and what it calls a survivor."""

import re
import shlex
import shutil
from itertools import pairwise

import pytest

from tests.mutations import MUTATIONS, ROOT, Workshop
from tests.mutations.mutation import Mutation

INNER = """from nptrace_base.jit import inlined

STEP = 2

@inlined
def double(x):
    return STEP * x
"""
OUTER = """from nptrace_base.jit import kernel
from rtrace.inner import double

@kernel
def total(n):
    sum_ = 0
    for i in range(n):
        sum_ += double(i)
    return sum_
"""
TEST = """from cachesim.outer import total

def test_total():
    assert total(10) == 90
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project of two kernels: one file's is pasted into the other's, which a test calls."""
    folder = tmp_path_factory.mktemp("small") / "project"
    files = {
        "rtrace/__init__.py": "",
        "cachesim/__init__.py": "",
        "rtrace/inner.py": INNER,
        "cachesim/outer.py": OUTER,
        "tests/test_total.py": TEST,
        "pytest.ini": "[pytest]\n",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    shutil.copytree(ROOT / "nptrace_base", folder / "nptrace_base", ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def test_a_kernel_pasted_into_another_file_is_compiled_again(project, tmp_path):
    workshop, tests = Workshop(tmp_path / "copy", tmp_path / "kernels", project), "tests/test_total.py"
    broken = Mutation("pasted", "rtrace/inner.py", "STEP * x", "STEP * x + 1", tests)
    harmless = Mutation("harmless", "rtrace/inner.py", "STEP * x", "x * STEP", tests)
    assert workshop.who_notices(broken) == "test_total.py::test_total"
    assert workshop.who_notices(harmless) == ""


def test_every_mutation_has_its_place_and_its_name():
    names = [mutation.what for mutation in MUTATIONS]
    assert len(set(names)) == len(names)
    for mutation in MUTATIONS:
        assert mutation.old in (ROOT / mutation.file).read_text(encoding="utf-8"), mutation.what
        assert mutation.old != mutation.new


def test_every_mutation_has_its_tests():
    """Those that were given another name notice nothing."""
    for mutation in MUTATIONS:
        words = shlex.split(mutation.tests)
        files = {word: word.split("::")[0] for word in words if word.startswith("tests/")}
        assert files, mutation.what
        texts = "".join(file + (ROOT / file).read_text(encoding="utf-8") for file in files.values())
        chosen = [name.split("[")[0] for word in files for name in word.split("::")[1:]]
        for option, expression in pairwise(words):
            chosen += set(re.findall(r"\w+", expression)) - {"and", "or", "not"} if option == "-k" else []
        assert not [name for name in chosen if name not in texts], mutation.what
