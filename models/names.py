"""Names that the command line knows without loading torch."""

from __future__ import annotations

SCORE_MAPS = ("map-small",)
"""Networks that learn from path targets; the others learn from recordings' targets."""
