"""Loads and runs an ONNX file from standard input once, with memory and time limited.

    python -m rig.controllers.onnx_trial BYTES SECONDS < MODEL

Ends with 1 and one line on stderr when that fails; the system ends it when it takes too much.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np
import onnxruntime

_MAX_INPUT = 1 << 22
_TYPES = {"tensor(float)": np.float32, "tensor(int64)": np.int64, "tensor(uint8)": np.uint8}
_PAGE_FIELD = 5


def limit(room_bytes: int, cpu_s: int) -> None:
    """Let this process have `room_bytes` and `cpu_s` more than it has taken already."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[_PAGE_FIELD])
    data = pages * resource.getpagesize() + room_bytes
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(spent.ru_utime + spent.ru_stime) + cpu_s
    resource.setrlimit(resource.RLIMIT_DATA, (data, data))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def run_once(content: bytes) -> None:
    """Run the network on zeros, one for each dimension that it leaves open."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(
        content, sess_options=options, providers=["CPUExecutionProvider"]
    )
    inputs = {}
    for node in session.get_inputs():
        shape = [size if isinstance(size, int) else 1 for size in node.shape]
        if np.prod(shape, dtype=np.float64) > _MAX_INPUT or node.type not in _TYPES:
            raise ValueError(f"input {node.name} is {node.type} {node.shape}")
        inputs[node.name] = np.zeros(shape, _TYPES[node.type])
    session.run(None, inputs)


def main() -> int:
    """Return 0 when the network answers."""
    content = sys.stdin.buffer.read()
    limit(int(sys.argv[1]), int(sys.argv[2]))
    try:
        run_once(content)
    except Exception as problem:  # the library's errors share no base of their own
        sys.stderr.write(f"{(str(problem) or type(problem).__name__).splitlines()[0]}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
