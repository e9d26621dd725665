"""The whole contract of an engine, in one line."""

from nmes_example_backend import ExampleBackend

from nmes.backend.contract import BackendContract


class TestExample(BackendContract):
    """Run with pytest."""

    backend = ExampleBackend
