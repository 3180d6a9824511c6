"""A real disk that fills up, and real system calls that fail: no double stands in for them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rig.core.errors import RecordingDamaged
from rig.record.recover import recover
from rig.record.verify import verify

TESTS = Path(__file__).parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (TESTS.parent, TESTS)))}
RIG = "from rig.cli.main import main; main()"

FILL_UP = """
import json, os, subprocess, sys, time
from pathlib import Path
disk = Path(sys.argv[1])
command = [sys.executable, "-c", sys.argv[2]]
cameras = "sim:tunnel?size=320x240"
record = ["collect", "--frames", "200", "--cameras", cameras, "--out", str(disk / "run")]
with subprocess.Popen([*command, *record], stderr=subprocess.PIPE, text=True) as process:
    file = disk / "run" / "run.mcap"
    while not file.exists() or file.stat().st_size < 2_000_000:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.02)
    with (disk / "filler").open("wb", buffering=0) as filler:
        try:
            while process.poll() is None:
                filler.write(bytes(100_000))
        except OSError:
            pass
        said = process.communicate()[1]
left = sorted(each.name for each in (disk / "run").iterdir())
(disk / "filler").unlink()
proof = subprocess.run([*command, "verify", str(disk / "run"), "--json"], stdout=subprocess.PIPE)
print(json.dumps({"code": process.returncode, "said": said, "left": left,
                  "proof": proof.returncode, **json.loads(proof.stdout)}))
"""

RECORD = """
import sys
from pathlib import Path
from record_samples import HEADER, record
from rig.core.errors import RecordingError
from rig.record import sink
from rig.record.writer import RecordWriter
sink.CHUNK_BYTES, sink._RESERVE_BYTES, sink.PART_BYTES = 1, 100_000, 60_000
try:
    with RecordWriter(Path(sys.argv[1]), HEADER, real_time=True) as writer:
        for trigger in range(40):
            writer.write(record(trigger))
except RecordingError as error:
    print(error)
"""


def on_small_disk(folder: Path, megabytes: int, script: str, *arguments: str) -> str:
    """Run a script with a disk of its own mounted at `folder`."""
    mount = f'mount -t tmpfs -o size={megabytes}m tmpfs "$0" && exec "$@"'
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", mount, str(folder)]
    probe = subprocess.run([*command, "true"], capture_output=True, check=False)
    if probe.returncode != 0:
        pytest.skip("no disk can be mounted here")
    done = subprocess.run(
        [*command, sys.executable, "-c", script, str(folder), *arguments],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.heavy
def test_a_disk_that_fills_up_during_a_drive_ends_it_with_losses(tmp_path: Path) -> None:
    if shutil.which("unshare") is None:
        pytest.skip("no disk can be mounted here")
    told = json.loads(on_small_disk(tmp_path, 60, FILL_UP, RIG))
    problems = [line for line in told["said"].splitlines() if line.startswith("rig: ")]
    assert told["code"] == 3, told
    assert len(problems) == 1
    assert "the disk is full at trigger" in problems[0]
    assert "run.mcap is finalised" in problems[0]
    assert told["left"] == ["metadata.yaml", "run.mcap"]
    assert told["sound"], told
    assert told["pairs"] > 10
    assert set(told["lost"]) <= {"disk full"}


@pytest.mark.heavy
def test_a_disk_that_is_full_at_the_start_is_refused(tmp_path: Path) -> None:
    if shutil.which("unshare") is None:
        pytest.skip("no disk can be mounted here")
    script = "import sys, subprocess; print(subprocess.run([sys.executable, *sys.argv[2:]], "
    script += "stderr=subprocess.PIPE, text=True).stderr)"
    run = ["collect", "--cameras", "sim:tunnel?size=640x480", "--out", str(tmp_path / "run")]
    said = on_small_disk(tmp_path, 10, script, "-c", RIG, *run).strip().splitlines()
    assert len(said) == 2  # the first line says which cameras are driven
    assert "the disk has room for 2 s of pictures (10 MB, 16 triggers of 120)" in said[1]


@pytest.mark.heavy
@pytest.mark.parametrize("error", ["ENOSPC", "EIO", "EDQUOT", "EFBIG"])
@pytest.mark.parametrize("call", ["pwrite64", "fdatasync", "fsync", "ftruncate", "fallocate"])
def test_a_system_call_that_fails_is_told_and_repaired(
    tmp_path: Path, call: str, error: str
) -> None:
    """Call number 3, or every call from number 3 on."""
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    for when in ("3", "3+"):
        folder = tmp_path / when
        command = ["strace", "-f", "-o", "/dev/null", "-e", f"trace={call}"]
        command += ["-e", f"inject={call}:error={error}:when={when}"]
        done = subprocess.run(
            [*command, sys.executable, "-c", RECORD, str(folder)],
            env=ENVIRONMENT,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) <= 1, done.stdout
        assert done.stdout or when == "3"
        if "cannot create" in done.stdout:
            assert list(folder.iterdir()) == []
            continue
        try:
            recover(folder)
        except RecordingDamaged:
            assert done.stdout
            continue
        found = verify(folder)
        assert found.sound, found.false_claims
        assert list(folder.glob("*.reserve")) == []
        assert done.stdout or found.pairs == 40
