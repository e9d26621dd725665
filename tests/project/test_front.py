"""What `import nmes` gives: checked in fresh processes, where nothing else has been imported."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

NAMES = [
    *("AsyncClient", "Client", "Cut", "Episode", "Evaluation", "Evaluator", "Genome", "Recorder", "Recording"),
    *("Task", "World", "evaluate", "film", "load_backend", "replay"),
]
IMPORT_ALL = """
import importlib, pkgutil
import nmes
for module in list(pkgutil.walk_packages(nmes.__path__, "nmes.")):
    if not module.name.endswith(("__main__", "test_conformance")):
        importlib.import_module(module.name)
"""
ARE_WHAT_THEY_ARE_CALLED = """
assert [value.__name__ for value in front] == names, front
assert all(callable(value) for value in front), front
"""


def run(code: str) -> str:
    code = f"names = {NAMES}\n{code}"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_there_in_a_process_that_asks_for_nothing_else(name: str) -> None:
    assert run(f"import nmes; print(nmes.{name}.__name__)") == name


def test_a_star_import_gives_all_names_and_no_other() -> None:
    output = run("before = set(globals())\nfrom nmes import *\nprint(*sorted(set(globals()) - before - {'before'}))")
    assert output.split() == NAMES


def test_dir_shows_all_names_and_no_others() -> None:
    shown = run("import nmes; print(*dir(nmes))").split()
    assert sorted(name for name in shown if not name.startswith("__")) == sorted(NAMES)
    assert len(shown) == len(set(shown))


def test_the_docstring_says_what_each_name_is() -> None:
    told = run("import nmes; print(nmes.__doc__)").partition("- Worlds:")[2]
    assert [name for name in NAMES if f"`{name}`" not in told] == []


def test_the_example_of_the_docstring_works(tmp_path: Path) -> None:
    code = run("import nmes; print(nmes.__doc__)").partition("```python\n")[2].partition("```")[0]
    program = code.replace("nmes.film(", "nmes.film.__name__, (")  # which needs OpenGL
    output = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    score, verdict = output.stdout.split()
    assert float(score) > 10.0 and verdict == "reproduced" and len(list(tmp_path.glob("walker-*.mcap"))) == 3


def test_importing_the_front_imports_nothing_else() -> None:
    assert run("import nmes, sys; print(*(m for m in sys.modules if m.split('.')[0] in ('nmes', 'numpy')))") == "nmes"


def test_no_submodule_hides_a_name_that_was_not_asked_for_before() -> None:
    run(f"{IMPORT_ALL}\nfront = [getattr(nmes, name) for name in names]\n{ARE_WHAT_THEY_ARE_CALLED}")


def test_no_submodule_replaces_a_name_that_was_imported_before() -> None:
    run(
        f"import nmes\nfor name in names: getattr(nmes, name)\n{IMPORT_ALL}"
        f"front = [getattr(nmes, name) for name in names]\n{ARE_WHAT_THEY_ARE_CALLED}"
    )


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    assert (
        run("import nmes\ntry: nmes.Clint\nexcept AttributeError as error: print(error)")
        == "module 'nmes' has no attribute 'Clint'"
    )


def test_the_version_is_there_without_importing_anything_else() -> None:
    version = run("import nmes; print(nmes.__version__)")
    assert version == importlib.metadata.version("nmes")
    assert "__version__" in run("import nmes; print(*dir(nmes))").split()


@pytest.mark.parametrize("option", ["-V", "--version"])
def test_python_m_nmes_is_the_command(option: str) -> None:
    result = subprocess.run([sys.executable, "-m", "nmes", option], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (0, f"nmes {importlib.metadata.version('nmes')}\n")


def test_python_m_nmes_ends_as_the_command_does() -> None:
    result = subprocess.run([sys.executable, "-m", "nmes", "fly"], capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr.startswith("Usage: nmes ") and "No such command 'fly'" in result.stderr


def test_what_pytest_loads_needs_nothing_that_windows_lacks() -> None:
    # It is loaded by every run of pytest where NMES is installed, whatever is tested.
    lacking = "import sys; sys.modules |= dict.fromkeys(['fcntl', 'resource', 'termios', 'pwd'])"
    assert run(f"{lacking}\nimport nmes.conformance.plugin, nmes.cli.conform; print('loaded')") == "loaded"


def test_what_pytest_loads_is_little() -> None:
    modules = run("import nmes.conformance.plugin, sys; print(*sys.modules)").split()
    assert not {"hypothesis", "numpy", "orjson", "nmes.protocol"} & set(modules)
    names = run(
        "import nmes.conformance as suite; print(*(name for name in suite.__all__ if not hasattr(suite, name)))"
    )
    assert names == ""
