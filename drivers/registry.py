"""From the words after `--cameras` to an opened pair of cameras.

    sim:WORLD?OPTION=VALUE&...      simulated cameras in a simulated world, on a virtual clock
    gige:sim:WORLD?OPTION=VALUE&... the same in real time, behind GigE Vision and Aravis
    aravis:SERIAL,SERIAL            two real cameras, the primary first (docs/hardware.md)
    replay:FILE                     the frames of a recording, as they were taken

Options of `sim:` are those of `rig.drivers.simulated.options` and those that only one world has.
The address of an opened source has every option resolved, in alphabetical order, so opening it
again repeats the same drive.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rig.core.errors import UsageError
from rig.core.protocols import Source
from rig.drivers.addresses import parse_address


def open_source(address: str, *, seed: int, split: str = "test") -> Source:
    """Open the cameras that `address` names.

    `seed` makes the noise, and the world unless the address names its own seed; `split` is the
    split unless the address names one. Raises UsageError for a word in the address that is not
    known or a value that cannot be meant, and ConfigError for a bad camera file.
    """
    if address.startswith("replay:"):
        from rig.drivers.replay import open_replay

        return open_replay(Path(address.removeprefix("replay:")))
    parsed = parse_address(address)
    if parsed.scheme == "gige":
        return _open_gige(address.removeprefix("gige:"), seed=seed, split=split)
    if parsed.scheme == "aravis":
        from rig.drivers.aravis.address import open_aravis

        return open_aravis(parsed.name, parsed.options)
    from rig.drivers.simulated.opening import open_simulation

    return open_simulation(parsed, seed=seed, split=split)


def _open_gige(address: str, *, seed: int, split: str) -> Source:
    from rig.drivers.aravis.address import read_mode
    from rig.drivers.simulated.gige.opening import SCHEME, open_over_gige
    from rig.drivers.simulated.opening import open_simulation

    inner = parse_address(address)
    if inner.scheme != "sim":
        raise UsageError(f"gige:{address}: only simulated cameras are served; try gige:sim:tunnel")
    mode = read_mode(SCHEME, inner.options.get("mode", "next-frame"))
    others = {name: word for name, word in inner.options.items() if name != "mode"}
    served = replace(inner, options=others)
    return open_over_gige(
        lambda: open_simulation(served, seed=seed, split=split),
        str(served),
        mode,
        seed=seed,
        split=split,
    )
