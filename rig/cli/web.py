"""The options of the live page, and the page around a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from rig.cli.options import is_simulated
from rig.cli.terminal import Terminal
from rig.core.protocols import Recorder

if TYPE_CHECKING:
    from rig.web.live import LiveView
    from rig.web.server import Press


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class WebOptions:
    """Whether to show a live page, and to whom."""

    web: Annotated[bool, Parameter(negative="")] = False
    """Show a live page; its address, with a token, is printed on stderr."""
    web_address: str = "127.0.0.1:0"
    """HOST:PORT to serve it at; port 0 takes a free one."""
    web_token: str | None = None
    """The word that opens the page; needed where others can reach it, else drawn at random."""


DEFAULT_WEB = WebOptions()


@contextmanager
def live_page(
    options: WebOptions, terminal: Terminal, address: str, press: Press | None = None
) -> Iterator[LiveView | None]:
    """Serve a live page of the cameras at `address` while the body runs; None when none is wanted.

    It says where the cameras are simulated.
    """
    if not options.web:
        yield None
        return
    from rig.web.guard import parse_listen
    from rig.web.live import LiveView

    banner = "SIMULATED" if is_simulated(address) else ""
    listen = parse_listen(options.web_address, options.web_token)
    with LiveView.open(*listen, press, banner) as view:
        terminal.say(f"live page: {view.url}")
        yield view


@contextmanager
def watched(
    recorder: Recorder,
    options: WebOptions,
    terminal: Terminal,
    address: str,
    folder: Path,
    triggers: int | None,
) -> Iterator[Recorder]:
    """Give the open `recorder`, watched by a live page where one was asked for."""
    with live_page(options, terminal, address) as view:
        if view is None:
            yield recorder
            return
        from rig.web.watch import WatchedRecorder, warm_up

        warm_up()
        yield WatchedRecorder(recorder, view.slot, folder.name, folder, triggers)
