"""What the doctor says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["good", "warning", "problem"]
"""A `problem` keeps cameras from working; a `warning` may cost pictures."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at: what it is, what was found, and what to do about it."""

    level: Level
    what: str
    found: str
    fix: str = ""


def good(what: str, found: str) -> Finding:
    """Return that something is as it must be."""
    return Finding("good", what, found)


def warning(what: str, found: str, fix: str) -> Finding:
    """Return that something may cost pictures."""
    return Finding("warning", what, found, fix)


def problem(what: str, found: str, fix: str) -> Finding:
    """Return that something keeps cameras from working."""
    return Finding("problem", what, found, fix)
