"""Settings for every test, and the four benchmark scenes: real where NPTRACE_SCENES has them, otherwise built-in ones."""

import os

import pytest
from hypothesis import Phase, settings

# Without deadlines, because the first call of a kernel compiles it.
settings.register_profile("project", deadline=None, derandomize=True)
# For tests.mutations, to which any failure will do: the smallest one is not looked for.
settings.register_profile("first failure", deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "project"))

BENCHMARK = {"bunny": "blob", "conference": "room", "sibenik": "nave", "sponza": "court"}


def pytest_report_header():
    folder = os.environ.get("NPTRACE_SCENES")
    return (
        f"scenes: {folder}" if folder else "scenes: NPTRACE_SCENES is not set, built-in stand-ins take the real scenes' place"
    )


@pytest.fixture
def bucket(tmp_path, monkeypatch):
    """An object store, s3://bucket, that is the folder ``bucket`` of ``tmp_path``."""
    from pyarrow.fs import LocalFileSystem, SubTreeFileSystem

    from nptrace_base import places

    stored = SubTreeFileSystem(str(tmp_path), LocalFileSystem())
    monkeypatch.setattr(places, "filesystem_of", lambda scheme, authority, query: (stored, authority))
    return places.place("s3://bucket")


@pytest.fixture(scope="session", params=sorted(BENCHMARK))
def benchmark_scene(request):
    """One of the four scenes of Table I."""
    from rtrace.scenes.catalog import load_scene

    name = request.param if os.environ.get("NPTRACE_SCENES") else BENCHMARK[request.param]
    return load_scene(name, notify=lambda text: None)
