"""`gige:sim:WORLD`: serve a simulated pair on loopback and open it as real cameras are opened."""

from __future__ import annotations

from collections.abc import Callable

from rig.core.protocols import Source
from rig.core.types import Pair
from rig.drivers.aravis.session import Mode, PairSpec
from rig.drivers.aravis.source import Surroundings, open_pair
from rig.drivers.simulated.gige.process import ServerProcess
from rig.drivers.simulated.source import SimulatedSource

SCHEME = "gige"


def open_over_gige(
    open_simulated: Callable[[], SimulatedSource],
    address: str,
    mode: Mode = "next-frame",
    *,
    seed: int,
    split: str,
) -> Source:
    """Open the simulated pair at `address` (`sim:...`) through GigE Vision and Aravis.

    `open_simulated` opens it in this process as well, for what only a simulation knows; both
    are made at the same time.
    """
    server = ServerProcess(address, seed=seed, split=split)
    try:
        simulated = open_simulated()
        spec = PairSpec(server.addresses(), mode=mode, rate_hz=simulated.rate_hz)
        return open_pair(spec, _surroundings(simulated, mode), server.close)
    except BaseException:
        server.close()
        raise


def _surroundings(simulated: SimulatedSource, mode: Mode) -> Surroundings:
    """Return what is known of the drive; not where a camera at its own pace was when."""
    known = {} if mode == "free-run" else {"truth": simulated.truth}
    return Surroundings(
        address=f"{SCHEME}:{simulated.address}" + ("" if mode == "next-frame" else f"&mode={mode}"),
        intrinsics=Pair(*simulated.intrinsics),
        drive_triggers=simulated.drive_triggers,
        world_version=simulated.world_version,
        pose_index=simulated.pose_index,
        **known,
    )
