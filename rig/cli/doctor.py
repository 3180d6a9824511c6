"""`rig doctor`: what stands between this computer and its cameras, and what to do about it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from cyclopts import Parameter

from rig.cli.exits import FAILED, OK
from rig.cli.terminal import DEFAULT_TERMINAL, Terminal
from rig.drivers.doctor.findings import Finding

_MARKS = {"good": "ok", "warning": "warning", "problem": "PROBLEM"}


def doctor(
    *,
    install_udev: Annotated[bool, Parameter(negative="")] = False,
    terminal: Terminal = DEFAULT_TERMINAL,
) -> int:
    """Look at everything that keeps cameras from working; exit 1 when something does.

    Parameters
    ----------
    install_udev:
        First install the rule by which every user may open USB cameras; needs root.
    """
    from rig.drivers.doctor.examination import examine
    from rig.drivers.doctor.udev import install

    if install_udev:
        terminal.say(f"installed {install()}; plug USB cameras out and in")
    findings = list(examine())
    words = "\n".join(line for finding in findings for line in _lines(finding))
    terminal.result(words, {"findings": [asdict(finding) for finding in findings]})
    return FAILED if any(finding.level == "problem" for finding in findings) else OK


def _lines(finding: Finding) -> list[str]:
    lines = [f"{_MARKS[finding.level]:<8} {finding.what}: {finding.found}"]
    return [*lines, f"         -> {finding.fix}"] if finding.fix else lines
