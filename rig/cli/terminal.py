"""What a person sees: results on stdout, everything else on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from cyclopts import Parameter


class Advance(Protocol):
    """Tells a progress bar how far the work is."""

    def __call__(self, done: int, total: int | None = None, /) -> None:
        """Show `done` of `total` steps; the last total holds when none is given."""
        ...


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Terminal:
    """How much to print, and in which form."""

    json: Annotated[bool, Parameter(negative="")] = False
    """Print the result as JSON on stdout; logs stay on stderr."""
    verbose: Annotated[bool, Parameter(alias="-v", negative="")] = False
    """Say more about what is being done."""
    quiet: Annotated[bool, Parameter(alias="-q", negative="")] = False
    """Say nothing but the result and problems."""

    def say(self, text: str) -> None:
        """Print one line about what is happening."""
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)

    def detail(self, text: str) -> None:
        """Print one line that only `--verbose` asks for."""
        if self.verbose:
            self.say(text)

    def result(self, text: str, values: Mapping[str, Any]) -> None:
        """Print the result: as words, or as JSON where that was asked for."""
        print(json.dumps(values, indent=2) if self.json else text, flush=True)

    @contextmanager
    def progress(self, what: str, total: int | None) -> Iterator[Advance]:
        """Show a bar while the body runs; nothing when stderr is not a terminal."""
        if self.quiet or not sys.stderr.isatty():
            yield _no_bar
            return
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

        columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
            task = bars.add_task(what, total=total)

            def advance(done: int, total: int | None = None, /) -> None:
                bars.update(task, completed=done, total=total)

            yield advance


def _no_bar(done: int, total: int | None = None, /) -> None:
    """Show nothing."""


DEFAULT_TERMINAL = Terminal()
