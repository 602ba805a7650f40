"""Laws of the project around the code: it imports, it names what it has, its numbers agree."""

from __future__ import annotations

import importlib
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import jaxtyping
import pytest
import torch

import mcpilco
from mcpilco.policies import cart_pole_cost

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def modules(*packages: str) -> list[str]:
    """The dotted names of all modules, packages by their own name."""
    paths = [
        path.relative_to(ROOT) for package in packages for path in (ROOT / package).rglob("*.py")
    ]
    names = [".".join(path.with_suffix("").parts) for path in paths]
    return sorted(name.removesuffix(".__init__") for name in names if not name.endswith("__main__"))


def public_modules() -> list[str]:
    """The packages: they list their public names."""
    return [
        name for name in modules("mcpilco", "envs") if find_spec(name).submodule_search_locations
    ]


@pytest.mark.parametrize("name", modules("mcpilco", "envs", "baselines"))
def test_module_imports_and_says_what_it_is(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__doc__


@pytest.mark.parametrize("name", public_modules())
def test_every_public_name_exists(name: str) -> None:
    module = importlib.import_module(name)
    missing = [public for public in module.__all__ if not hasattr(module, public)]
    assert not missing


def test_version_is_the_projects() -> None:
    assert mcpilco.__version__ == PROJECT["version"]
    assert f"version: {PROJECT['version']}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert PROJECT["version"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_command_exists() -> None:
    module, function = PROJECT["scripts"]["mcpilco"].split(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_the_command_line_loads_nothing_slow() -> None:
    """What keeps `mcpilco --help` fast."""
    slow = {"torch", "rerun", "gymnasium", "numba", "scipy", "mujoco", "stable_baselines3"}
    code = f"import sys, mcpilco.cli; print(sorted({slow!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_importing_the_package_does_not_import_envs() -> None:
    code = "import sys, mcpilco.agent.agent; print({'envs', 'baselines'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "set()", done.stderr


@pytest.mark.parametrize("package", ["mcpilco", "envs"])
def test_types_are_published(package: str) -> None:
    assert (ROOT / package / "py.typed").exists()


INTEGERS = torch.zeros(4, dtype=torch.int64)  # where a cost says Float


def test_wrong_arrays_are_caught_while_tests_run() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="states"):
        cart_pole_cost()(INTEGERS)


@pytest.mark.usefixtures("unchecked_shapes")
def test_wrong_arrays_reach_the_code_where_a_test_asks_for_it() -> None:
    assert cart_pole_cost()(INTEGERS).shape == ()
