"""Settings for every test: hypothesis without deadlines, because the first call of a kernel compiles it."""

from hypothesis import settings

settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")
