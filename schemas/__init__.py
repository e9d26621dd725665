"""JSON Schema files of the protocol's messages, read through `importlib.resources`."""
