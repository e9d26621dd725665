"""Brings what pages link to outside of `docs/` into the site: schemas, examples, the corpus of recordings.

On the forge and in a clone such links lead to the files themselves; here each file that a page names is copied.
"""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
_LINK = re.compile(r"\]\(\.\./([^)#\s]+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the files that pages link to."""
    files.remove(next(file for file in files if file.src_uri == "hooks.py"))
    for page in list(files.documentation_pages()):
        for path in _LINK.findall(page.content_string):
            if files.get_file_from_path(_target(path)) is None and (ROOT / path).is_file():
                files.append(File.generated(config, _target(path), content=(ROOT / path).read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lets the links lead to the copies."""
    return _LINK.sub(lambda match: f"]({_target(match[1])}", markdown)


def _target(path: str) -> str:
    # As text: a page would want a place in the navigation, and what it links to in turn.
    return f"repository/{path}.txt" if path.endswith(".md") else f"repository/{path}"
