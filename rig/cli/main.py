"""`rig`: finds the command, runs it, and turns every problem into one line and an exit code."""

from __future__ import annotations

import logging
import sys
from importlib.metadata import version
from typing import NamedTuple

from cyclopts import App, CycloptsError

from rig.cli.exits import FAILED, INTERRUPTED, LOSSES, OK, USAGE
from rig.core.errors import DiskFull, RigError, UsageError


class Told(NamedTuple):
    """What the help says of a command."""

    help: str
    example: str


COMMANDS = {
    "race": Told(
        "Drive each camera by its own controller, record, judge, and report.",
        "rig race ours shin:tolerance=mid --cameras 'sim:tunnel?seed=3' --frames 120",
    ),
    "collect": Told(
        "Record a training drive: a leader on the primary, perturbed settings on the secondary.",
        "rig collect --perturb cycle --cameras 'sim:tunnel?seed=7' --out data/tunnel-7",
    ),
    "targets": Told(
        "Find the settings to aim for at every pose of recordings (thesis eq. 4.11 to 4.13).",
        "rig targets data/tunnel-* --metric hybrid --out data/hybrid.npz",
    ),
    "train": Told(
        "Train a network on target files and export it to ONNX with a model card.",
        "rig train --net dual-small data/hybrid.npz --out mine.onnx",
    ),
    "evaluate": Told(
        "Judge recordings, videos, or folders of pictures, and rank the controllers.",
        "rig evaluate runs/*-race --json",
    ),
    "bound": Told(
        "Work out the best median and minimum of inliers that a grid of settings allows.",
        "rig bound 'sim:tunnel?seed=3' --json",
    ),
    "match": Told(
        "Match two pictures by the front ends that judge drives.",
        "rig match a.png b.png --front-end viso2 --half --json",
    ),
    "metrics": Told(
        "Score pictures by the image metrics of the field.",
        "rig metrics a.png b.png --json",
    ),
    "reproduce": Told(
        "Run the experiments behind the published tables and figures.",
        "rig reproduce --only rival-tuning --quick",
    ),
    "calibrate-aperture": Told(
        "Make both lenses let the same light through, and prove it (thesis 5.1.1).",
        "rig calibrate-aperture --cameras sim:wall --auto",
    ),
    "calibrate-intrinsics": Told(
        "Measure focal lengths, distortion and the baseline from views of a board.",
        "rig calibrate-intrinsics --board charuco:9x6 --square-mm 30 --cameras "
        "'sim:chessboard?board=charuco'",
    ),
    "simulate": Told(
        "Write pictures of a simulated world and a contact sheet over exposure and gain.",
        "rig simulate doorway --exposure-us 100,1000,10000 --gain-db 0,15,30 --pair 0,60",
    ),
    "calibrate-response": Told(
        "Measure response curve and noise, and write a camera model for the simulation.",
        "rig calibrate-response --cameras sim:wall --out twin",
    ),
    "devices": Told(
        "List the real cameras that are connected.",
        "rig devices --json",
    ),
    "doctor": Told(
        "Find what keeps cameras from working, and say what to do about it.",
        "rig doctor",
    ),
    "latency": Told(
        "Measure how many frames new settings take to have effect.",
        "rig latency --cameras 'sim:tunnel?latency_frames=3'",
    ),
    "dump-genicam": Told(
        "Write the GenICam description of a camera to a file.",
        "rig dump-genicam 18284899 --out blackfly.xml",
    ),
    "serve": Told(
        "Serve a simulated pair as two GigE Vision cameras for any GenICam client.",
        "rig serve 'sim:tunnel?size=320x240'",
    ),
    "report": Told(
        "Write summary.json and report.html of recordings anew.",
        "rig report runs/20260714-101500-race --video drive.mp4",
    ),
    "verify": Told(
        "Recompute every claim that a recording makes: pixels, pairing, order, accounting.",
        "rig verify runs/20260714-101500-race",
    ),
    "info": Told(
        "Show how long a recording is, what it lost, and which settings it used.",
        "rig info runs/20260714-101500-race",
    ),
    "replay": Told(
        "Run a controller over the frames of a recording and compare its decisions.",
        "rig replay runs/20260714-101500-race ours",
    ),
    "export": Told(
        "Write a recording in the format of another tool.",
        "rig export runs/20260714-101500-race --to euroc --out euroc",
    ),
    "recover": Told(
        "Repair a recording in place that was cut short.",
        "rig recover runs/20260714-101500-race",
    ),
}


def build_app() -> App:
    """Return the command line; a command's module is imported only when it is called."""
    app = App(
        name="rig",
        help="Find out which exposure and gain control gives a robot the best eyes.",
        help_epilogue="Example: rig race ours shin",
        help_format="plaintext",
        version=lambda: version("exposure-rig"),
        result_action="return_value",
    )
    for name, told in COMMANDS.items():
        app.command(
            "rig.cli.{0}:{0}".format(name.replace("-", "_")),
            name=name,
            help=told.help,
            help_epilogue=f"Example: {told.example}",
        )
    return app


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code; problems are printed as one line."""
    _listen(verbose=not {"-v", "--verbose"}.isdisjoint(arguments))
    try:
        code = build_app()(arguments, exit_on_error=False, print_error=False)
    except (CycloptsError, UsageError) as error:
        _complain(error)
        return USAGE
    except DiskFull as error:
        _complain(error)
        return LOSSES
    except RigError as error:
        _complain(error)
        return FAILED
    except BrokenPipeError:
        sys.stderr.close()
        return OK
    except OSError as error:
        _complain(RigError(f"{error.filename or 'a file'}: {error.strerror or error}"))
        return FAILED
    except KeyboardInterrupt:
        print("rig: interrupted", file=sys.stderr)
        return INTERRUPTED
    return code if isinstance(code, int) else OK


def _listen(*, verbose: bool) -> None:
    """Print what the rooms log: warnings, or everything, such as each value written to a camera."""
    logging.basicConfig(format="%(message)s")
    logging.getLogger("rig").setLevel(logging.DEBUG if verbose else logging.NOTSET)


def _complain(error: Exception) -> None:
    print(f"rig: {' '.join(str(error).split())}", file=sys.stderr)


def main() -> None:
    """Entry point of the `rig` command."""
    sys.exit(run(sys.argv[1:]))
