"""`rig serve sim:tunnel`: the simulated pair as two GigE Vision cameras, for any client."""

from __future__ import annotations

from contextlib import closing

from rig.cli.exits import INTERRUPTED
from rig.cli.interrupt import stop_on_signal
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import UsageError
from rig.core.types import SIDES, Pair
from rig.drivers.registry import open_source
from rig.drivers.simulated.gige.plan import plan_of
from rig.drivers.simulated.gige.server import Server
from rig.drivers.simulated.source import SimulatedSource


def serve(
    cameras: str = "sim:tunnel",
    /,
    *,
    at: str | None = None,
    seed: int = 0,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Serve a simulated pair as GigE Vision cameras, wired to each other, until Ctrl-C.

    Parameters
    ----------
    cameras:
        What to serve, such as sim:tunnel?size=320x240.
    at:
        Two addresses of this computer, PRIMARY,SECONDARY; two free loopback addresses when absent.
    seed:
        Seeds the world and the noise.
    """
    if not cameras.startswith("sim:"):
        raise UsageError(f"rig serve {cameras}: only simulated cameras are served; try sim:tunnel")
    with (
        closing(open_source(cameras, seed=seed, split="test")) as source,
        stop_on_signal("leaving") as stop,
    ):
        assert isinstance(source, SimulatedSource)
        plan = plan_of(source)
        with closing(Server(plan, None if at is None else read_addresses(at))) as server:
            places = dict(zip(SIDES, server.addresses, strict=True))
            lines = [
                f"{side}: {plan.serials[number]} at {place}"
                for number, (side, place) in enumerate(places.items())
            ]
            terminal.say(f"SIMULATED: {source.address}; Ctrl-C ends")
            terminal.result("\n".join(lines), {"cameras": source.address, **places})
            server.run(lambda: not stop.requested)
    return INTERRUPTED


def read_addresses(text: str) -> Pair[str]:
    """Return two addresses that are written with a comma between them; raises UsageError."""
    words = [word.strip() for word in text.split(",")]
    if len(words) != 2 or not all(words) or words[0] == words[1]:
        raise UsageError(f"--at {text!r}: write two different addresses, as 127.0.0.5,127.0.0.6")
    return Pair(*words)
