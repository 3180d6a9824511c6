"""A controller from another package, really built and installed, drives like any other."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.controllers.registry import make_controller
from rig.core.errors import ControllerError, UsageError
from rig.core.types import THESIS_LIMITS, Settings

PROJECT = """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "halving-exposure"
version = "1.0"

[project.entry-points."rig.controllers"]
halve = "halving_exposure:Halve"
broken = "halving_exposure:Missing"
number = "halving_exposure:NUMBER"

[tool.setuptools]
py-modules = ["halving_exposure"]
"""

MODULE = (Path(__file__).parents[2] / "docs" / "controllers.md").read_text(encoding="utf-8")


def example() -> str:
    """Return the plug-in that the docs show."""
    return MODULE.split("```python\n")[1].split("```")[0]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the package and install it into a folder of its own."""
    source, site = tmp_path_factory.mktemp("package"), tmp_path_factory.mktemp("site")
    (source / "pyproject.toml").write_text(PROJECT, encoding="utf-8")
    (source / "halving_exposure.py").write_text(example() + "\nNUMBER = 3\n", encoding="utf-8")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps"]
    install += ["--no-build-isolation", "--disable-pip-version-check", "--target", str(site)]
    subprocess.run([*install, str(source)], check=True, capture_output=True)
    return site


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(site))
    yield
    sys.modules.pop("halving_exposure", None)


def test_the_example_of_the_docs_is_short() -> None:
    assert len(example().splitlines()) < 30


@pytest.mark.usefixtures("installed")
def test_an_installed_controller_is_found_with_its_options() -> None:
    named = make_controller("halve:start_us=800", seed=0, networks={})
    assert named.options == {"start_us": "800.0"}
    assert named.controller.reset(THESIS_LIMITS) == Settings(800.0, 0.0)
    with pytest.raises(UsageError, match="unknown option 'star_us'; did you mean 'start_us'"):
        make_controller("halve:star_us=1", seed=0, networks={})
    with pytest.raises(UsageError, match=r"did you mean 'halve'\?"):
        make_controller("halves", seed=0, networks={})


@pytest.mark.usefixtures("installed")
def test_a_plug_in_that_cannot_be_used_is_named_in_one_line() -> None:
    with pytest.raises(ControllerError, match="'broken': its plug-in halving_exposure:Missing"):
        make_controller("broken", seed=0, networks={})
    with pytest.raises(ControllerError, match=r"'number': its plug-in .* is no dataclass"):
        make_controller("number", seed=0, networks={})


def test_without_the_package_there_is_no_such_controller() -> None:
    with pytest.raises(UsageError, match="unknown controller 'halve'"):
        make_controller("halve", seed=0, networks={})
