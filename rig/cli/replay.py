"""`rig replay REC CONTROLLER`: the same controller code over recorded frames."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.cli.exits import FAILED, OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.core.types import SIDES, Pair, Side

if TYPE_CHECKING:
    from rig.experiments.replay import Replay


def replay(recording: Path, controller: str, /, *, terminal: Terminal = DEFAULT_TERMINAL) -> int:
    """Run a controller over the frames of a recording and compare its decisions.

    Where the recording was driven by the same controller its decisions must come out the same to
    the last bit: exit code 1 tells that one did not. Of another controller it is shown what it
    would have asked for.

    Parameters
    ----------
    recording:
        A run's folder, its run.mcap, or its metadata.yaml.
    controller:
        A controller as for rig race: ours, shin, aeag, fixed:exposure_us=700,gain_db=0, ...
    """
    from rig.controllers.registry import make_controller
    from rig.experiments.replay import recorded_limits
    from rig.experiments.replay import replay as run
    from rig.models.shipped import shipped_networks
    from rig.record.reader import open_recording

    opened = open_recording(recording)
    header, networks = opened.header, shipped_networks()
    wired = Pair(*(make_controller(controller, seed=header.seed, networks=networks) for _ in SIDES))
    drove: tuple[Side, ...] = tuple(
        side for side, name in zip(SIDES, header.controllers, strict=True) if name == controller
    )
    with terminal.progress("replaying", len(opened)) as advance:
        found = run(opened.records(), wired, recorded_limits(header.options), drove, advance)
    values = as_json(str(opened.path), controller, drove, found)
    terminal.result(words(values), values)
    return FAILED if found.different else OK


def as_json(path: str, controller: str, drove: tuple[Side, ...], found: Replay) -> dict[str, Any]:
    """Return a replay as plain values."""
    from rig.experiments.replay import command_words

    return {
        "recording": path,
        "controller": controller,
        "drove": list(drove),
        "compared": found.compared,
        "different": found.different,
        "identical": found.compared > 0 and found.different == 0,
        "mismatches": [asdict(each) for each in found.mismatches],
        "decisions": {
            side: [
                {"trigger": trigger, **command_words(command)}
                for trigger, command in commands.items()
            ]
            for side, commands in zip(SIDES, found.commands, strict=True)
        },
    }


def words(values: dict[str, Any]) -> str:
    """Return a replay as lines for a person."""
    name, decisions = values["controller"], len(values["decisions"]["primary"])
    if not values["drove"]:
        return (
            f"{name} did not drive this recording: nothing to compare; "
            f"it looked at {decisions} pairs, --json shows what it would have asked for"
        )
    where = " and ".join(values["drove"])
    if values["identical"]:
        return f"{name} on the {where}: all {values['compared']} decisions are the same again"
    lines = [f"{name} on the {where}: {values['different']} of {values['compared']} differ"]
    lines += [
        f"  trigger {each['trigger']} {each['side']}: recorded {each['recorded']}, "
        f"now {each['replayed']}"
        for each in values["mismatches"][:10]
    ]
    return "\n".join(lines)
