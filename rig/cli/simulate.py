"""`rig simulate WORLD`: pictures of one moment over exposure and gain, to look at a world."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from pathlib import Path

from rig.cli.exits import OK
from rig.cli.options import run_folder
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.errors import UsageError


def simulate(
    world: str = "sim:tunnel",
    /,
    *,
    exposure_us: str = "75,300,1200,5000,30000",
    gain_db: str = "0,10,20,30",
    pair: str = "60",
    seed: int = 0,
    out: Path | None = None,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Write pictures of a simulated world and a contact sheet over exposure and gain.

    The pictures are the camera's own bytes in colour; the contact sheet is brightened for the eye.

    Parameters
    ----------
    world:
        A world, such as tunnel, or a whole address, such as sim:door?seed=3&size=1024x768.
    exposure_us:
        Exposure times in microseconds, with commas between them.
    gain_db:
        Gains in decibels, with commas between them.
    pair:
        Which moments of the drive, counted from 0, with commas between them.
    seed:
        Seeds the world and the noise.
    out:
        Folder to make; runs/<time>-simulate when absent.
    """
    from rig.experiments.looks import take_looks

    exposures = numbers("--exposure-us", exposure_us)
    gains, pairs = numbers("--gain-db", gain_db), wholes("--pair", pair)
    folder = run_folder(out, "simulate")
    total = len(exposures) * len(gains) * len(pairs)
    address = world if ":" in world else f"sim:{world}"
    with terminal.progress("taking pictures", total) as advance:
        found = take_looks(address, folder, exposures, gains, pairs, seed=seed, progress=advance)
    sheets = ", ".join(str(folder / name) for name in found.contact_sheets)
    terminal.result(
        f"SIMULATED: {found.cameras}\n{len(found.pictures)} pictures; look at {sheets}",
        {"folder": str(folder), **asdict(found)},
    )
    return OK


def numbers(option: str, text: str) -> list[float]:
    """Return numbers that are written with commas between them; raises UsageError."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        raise UsageError(f"{option} {text!r}: write numbers with commas, such as 0,10,20") from None
    if not all(map(isfinite, found)):
        raise UsageError(f"{option} {text!r}: write numbers with commas, such as 0,10,20")
    if len(set(found)) < len(found):
        raise UsageError(f"{option} {text!r}: a number is there twice; keep one")
    return found


def wholes(option: str, text: str) -> list[int]:
    """Return whole numbers that are written with commas between them; raises UsageError."""
    found = numbers(option, text)
    if any(number != int(number) for number in found):
        raise UsageError(f"{option} {text!r}: write whole numbers with commas, such as 0,60")
    return [int(number) for number in found]
