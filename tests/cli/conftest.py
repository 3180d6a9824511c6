"""Runs that the command-line tests share: one short race and one short collection."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.cli.main import run

CAMERAS = "sim:tunnel?size=320x240"
RIVAL = "fixed:exposure_us=2000,gain_db=6"


@pytest.fixture(scope="session")
def race_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("race") / "run"
    arguments = ["race", "aeag", RIVAL, "--cameras", CAMERAS, "--frames", "14", "--seed", "3"]
    assert run([*arguments, "--out", str(folder), "-q"]) == 0
    return folder


@pytest.fixture(scope="session")
def collect_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("collect") / "run"
    arguments = ["collect", "--perturb", "cycle", "--cameras", CAMERAS, "--frames", "12"]
    assert run([*arguments, "--out", str(folder), "-q"]) == 0
    return folder
