"""The exit codes that scripts rely on."""

from __future__ import annotations

OK = 0
FAILED = 1
USAGE = 2
LOSSES = 3
"""Finished, with losses that the recording names."""
INTERRUPTED = 130
