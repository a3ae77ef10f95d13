"""What the packages offer by name: each name is there, and costs nothing before it is used."""

import importlib
import subprocess
import sys

import pytest

from nptrace_base.source_files import ROOT

PACKAGES = ("traces", "rtrace", "cachesim")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there(package):
    module = importlib.import_module(package)
    assert len(module.__all__) > 5
    for name in module.__all__:
        assert getattr(module, name).__name__ == name
        assert name in dir(module)
        with pytest.raises(ModuleNotFoundError):  # a module of that name would hide it
            importlib.import_module(f"{package}.{name}")
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing


def test_packages_import_nothing_of_weight():
    code = f"import sys, nptrace, nptrace_base, {', '.join(PACKAGES)}\n"
    code += "assert not {'numpy', 'pyarrow', 'click'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
