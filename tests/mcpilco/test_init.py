"""Laws of the package's front door."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import mcpilco

ROOT = Path(__file__).parent.parent.parent


@pytest.mark.parametrize("name", mcpilco.__all__)
def test_a_public_name_is_the_one_of_its_home(name: str) -> None:
    module = importlib.import_module(mcpilco._HOMES[name])
    assert getattr(mcpilco, name) is getattr(module, name)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'PILCO'; it has MCPILCO"):
        mcpilco.PILCO  # noqa: B018


def test_the_package_waits_for_nothing_until_a_name_is_asked_for() -> None:
    code = """if True:
        import sys, mcpilco
        assert not {"numpy", "torch"} & set(sys.modules)
        assert mcpilco.Config().horizon is None
        assert "torch" not in sys.modules
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_dir_shows_the_public_names_alone() -> None:
    assert dir(mcpilco) == sorted(mcpilco.__all__)
