"""`rig serve`: says where the cameras are, answers, and ends with Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import sys

import pytest

from rig.cli.main import run
from rig.drivers.aravis.probe import is_controlled

MAIN = "from rig.cli.main import main; main()"


def serve(*options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, "serve", "sim:tunnel?size=320x240", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_two_cameras_are_served_until_ctrl_c() -> None:
    with serve("--json") as serving:
        assert serving.stdout is not None and serving.stderr is not None
        told = ""
        while not told.endswith("}\n"):
            told += serving.stdout.readline()
        places = json.loads(told)
        assert is_controlled(places["primary"]) is False
        assert is_controlled(places["secondary"]) is False
        serving.send_signal(signal.SIGINT)
        assert serving.wait(10) == 130
        said = serving.stderr.read()
    assert "SIMULATED: sim:tunnel" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["gige:sim:tunnel"], "only simulated cameras are served; try sim:tunnel"),
        (["sim:tunel"], "unknown world 'tunel'; did you mean tunnel?"),
        (["sim:tunnel?size=320x240", "--at", "127.0.0.5"], "write two different addresses"),
        (["sim:tunnel?size=320x240", "--at", "127.0.0.5,127.0.0.5"], "write two different"),
    ],
)
def test_what_cannot_be_served_is_said(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["serve", *words]) == 2
    assert message in capsys.readouterr().err


def test_an_address_of_another_computer_cannot_be_had(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["serve", "sim:tunnel?size=320x240", "--at", "192.0.2.1,192.0.2.2"]
    assert run(words) == 1
    assert "192.0.2.1: no camera can be served there" in capsys.readouterr().err
