"""What pyproject.toml cannot say of the package: README.md without the links that lead nowhere once it is packaged."""

import re
from pathlib import Path

from setuptools import setup

_RELATIVE = r"\((?![a-z]+://|#)[^)]*\)"  # the target of a link or picture that is no address


def packaged(readme: str) -> str:
    """Returns the text with relative links as plain words, and without relative pictures."""
    return re.sub(rf"\[([^\]]*)\]{_RELATIVE}", r"\1", re.sub(rf"!\[[^\]]*\]{_RELATIVE}\n*", "", readme))


setup(
    long_description=packaged(Path(__file__).with_name("README.md").read_text(encoding="utf-8")),
    long_description_content_type="text/markdown",
)
