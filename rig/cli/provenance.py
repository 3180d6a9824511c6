"""What is needed to repeat a run: versions, commit, and the words it was called with."""

from __future__ import annotations

import shlex
import subprocess
import sys
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

PACKAGES = (
    "exposure-rig",
    "numpy",
    "numba",
    "scipy",
    "opencv-python-headless",
    "onnxruntime",
    "mcap",
)


def versions() -> dict[str, str]:
    """Return the version of Python and of each package that can change a result."""
    python = ".".join(map(str, sys.version_info[:3]))
    return {"python": python} | {name: version(name) for name in PACKAGES}


def git_commit() -> str:
    """Return the commit of the source tree, `-dirty` when it was changed; empty without one."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    folder = Path(__file__).resolve().parent
    try:
        result = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return result.stdout.strip() if result.returncode == 0 else ""


def command_line() -> str:
    """Return the command line as a person can type it again."""
    return shlex.join(["rig", *sys.argv[1:]])


def file_sha256(path: Path) -> str:
    """Return the hash that names a file's bytes."""
    return sha256(path.read_bytes()).hexdigest()
