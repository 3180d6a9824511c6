"""`rig`: finds the command, runs it, and turns every problem into one line and an exit code."""

from __future__ import annotations

import sys
from importlib.metadata import version

from cyclopts import App, CycloptsError

from rig.cli.exits import FAILED, INTERRUPTED, OK, USAGE
from rig.core.errors import RigError, UsageError

COMMANDS = {
    "race": "Drive each camera by its own controller, record, judge, and report.",
    "collect": "Record training drives: a leader on one camera, perturbed settings on the other.",
    "targets": "Turn recordings into training targets.",
    "train": "Train a network on targets and export it to ONNX.",
    "evaluate": "Judge recordings, a video, or a folder of pictures.",
    "report": "Write summary.json and report.html of a recording anew.",
    "verify": "Recompute every claim that a recording makes.",
    "info": "Show what a recording holds.",
    "recover": "Repair a recording that was cut short.",
}


def build_app() -> App:
    """Return the command line; a command's module is imported only when it is called."""
    app = App(
        name="rig",
        help="Find out which exposure and gain control gives a robot the best eyes.",
        help_epilogue="Example: rig race ours shin --cameras sim:tunnel --frames 120",
        help_format="plaintext",
        version=lambda: version("exposure-rig"),
        result_action="return_value",
    )
    for name, text in COMMANDS.items():
        app.command(f"rig.cli.{name}:{name}", name=name, help=text)
    return app


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code; problems are printed as one line."""
    try:
        code = build_app()(arguments, exit_on_error=False, print_error=False)
    except (CycloptsError, UsageError) as error:
        _complain(error)
        return USAGE
    except RigError as error:
        _complain(error)
        return FAILED
    except KeyboardInterrupt:
        print("rig: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return OK
    return code if isinstance(code, int) else OK


def _complain(error: Exception) -> None:
    print(f"rig: {' '.join(str(error).split())}", file=sys.stderr)


def main() -> None:
    """Entry point of the `rig` command."""
    sys.exit(run(sys.argv[1:]))
