"""Settings for all tests."""

from hypothesis import settings

# A busy machine is no failure.
settings.register_profile("nmes", deadline=None)
settings.load_profile("nmes")
