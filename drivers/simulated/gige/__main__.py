"""The server as a process: `python -m rig.drivers.simulated.gige ADDRESS SEED SPLIT`.

It prints its two network addresses when clients can come, and ends with its standard input.
"""

from __future__ import annotations

import select
import signal
import sys
import threading

from rig.core.errors import RigError
from rig.drivers.registry import open_source
from rig.drivers.simulated.gige.plan import plan_of
from rig.drivers.simulated.gige.server import Server
from rig.drivers.simulated.source import SimulatedSource


def serve(address: str, seed: int, split: str) -> None:
    """Serve a simulated pair until nobody holds the standard input any more."""
    source = open_source(address, seed=seed, split=split)
    assert isinstance(source, SimulatedSource)
    server = Server(plan_of(source))
    sys.stdout.write(" ".join(server.addresses) + "\n")
    sys.stdout.flush()
    ended = threading.Event()
    threading.Thread(target=_wait_for_end, args=(ended,), daemon=True).start()
    server.run(lambda: not ended.is_set())
    server.close()


def _wait_for_end(ended: threading.Event) -> None:
    select.select([sys.stdin], [], [])
    ended.set()


def main() -> int:
    """Serve what the command line names; Ctrl-C is left to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    address, seed, split = sys.argv[1:]
    try:
        serve(address, int(seed), split)
    except RigError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
