"""A server in a process of its own, so that pictures are made beside the run and not within it."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from typing import IO

from rig.core.errors import CameraError
from rig.core.types import Pair

_GOODBYE_S = 3.0


class ServerProcess:
    """Starts serving at once; `addresses` waits until clients can come."""

    def __init__(self, address: str, *, seed: int, split: str) -> None:
        self._address = address
        self._complaints: IO[str] = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rig.drivers.simulated.gige", address, str(seed), split],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._complaints,
            text=True,
        )

    def addresses(self) -> Pair[str]:
        """Return where the cameras are; raises CameraError when the server could not start."""
        assert self._process.stdout is not None
        words = self._process.stdout.readline().split()
        if len(words) != 2:
            self._process.wait()
            self._complaints.seek(0)
            lines = self._complaints.read().strip().splitlines() or ["it says nothing"]
            self.close()
            raise CameraError(f"{self._address}: the camera server did not start: {lines[-1]}")
        return Pair(*words)

    def close(self) -> None:
        """End the server; closing twice is harmless."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(_GOODBYE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._complaints.close()
