"""The package from outside: its public names, and how little it takes to import it or to ask for help."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import microbundle

HEAVY = ("cv2", "pandas", "xarray", "scipy", "matplotlib", "h5py", "tifffile", "numpy", "pydantic")
MOST_CPU_S = 0.6
"""Twice what is promised, for slow machines under load."""


@pytest.mark.parametrize("name", microbundle.__all__)
def test_every_public_name_can_be_imported_and_has_a_docstring(name: str) -> None:
    thing = getattr(microbundle, name)
    assert isinstance(thing, str) or thing.__doc__


def test_the_list_of_public_names_is_complete_and_sorted() -> None:
    tree = ast.parse(Path(str(microbundle.__file__)).read_text(encoding="utf-8"))
    guarded = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name for node in guarded.body if isinstance(node, ast.ImportFrom) and node.level
             for alias in node.names}
    assert typed == set(microbundle._HOME) | set(microbundle._MODULES) == set(microbundle.__all__) - {"__version__"}
    assert sorted(microbundle.__all__) == microbundle.__all__
    assert dir(microbundle) == microbundle.__all__


def test_all_errors_are_public_and_of_one_family() -> None:
    from microbundle import errors

    family = {name for name, thing in vars(errors).items() if isinstance(thing, type)}
    assert family <= set(microbundle.__all__)
    assert all(issubclass(getattr(errors, name), microbundle.MicrobundleError) for name in family)
    assert all(name in str(errors.__doc__) for name in family)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'microbundle' has no attribute 'nothing'"):
        _ = microbundle.nothing  # type: ignore[attr-defined]


def loaded_by(code: str) -> set[str]:
    script = f"import sys\n{code}\nprint('\\n', ' '.join(sys.modules))"
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    return set(out.splitlines()[-1].split())


def test_importing_the_package_loads_nothing_heavy() -> None:
    assert loaded_by("import microbundle; dir(microbundle)").isdisjoint(HEAVY)


def test_help_loads_nothing_heavy() -> None:
    assert loaded_by("from microbundle.cli import run; run(['--help'])").isdisjoint(HEAVY)


def test_help_of_a_command_loads_no_science() -> None:
    loaded = loaded_by("from microbundle.cli import run; run(['analyze', '--help'])")
    assert loaded.isdisjoint(set(HEAVY) - {"pydantic"})


def test_the_dictionary_loads_no_science() -> None:
    loaded = loaded_by("from microbundle.cli import run; run(['metrics', 'amplitude'])")
    assert loaded.isdisjoint(set(HEAVY) - {"pydantic"})


@pytest.mark.skipif(sys.platform == "win32", reason="the CPU time of a child is not told on Windows")
@pytest.mark.parametrize("code", ["import microbundle", "from microbundle.cli import run; run(['--help'])"])
def test_start_takes_little_cpu(code: str, tmp_path: Path) -> None:
    """CPU time of a whole interpreter with compiled bytecode, the best of three after one that compiles."""
    import resource

    clean = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    clean["PYTHONPYCACHEPREFIX"] = str(tmp_path)

    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", code], env=clean, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    once()
    assert min(once() for _ in range(3)) < MOST_CPU_S


def test_ci_runs_the_readmes_test_command():
    root = Path(__file__).parent.parent
    readme, ci = (root / "README.md").read_text(encoding="utf-8"), (root / ".ci" / "run").read_text(encoding="utf-8")
    command = 'python3 -m venv .venv && .venv/bin/pip install -q -e ".[test]" && .venv/bin/python -m pytest -q -n 2'
    assert command + "\n" in readme
    assert command in ci
