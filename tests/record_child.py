"""Records in processes of its own and sends them signals at moments drawn from a seed.

Called with JSON {folder, seeds, signals, parts}; prints one JSON line a process: its folder, how
it ended, how long after the last signal, and how many triggers were in the file's chunks before.
"""

from __future__ import annotations

import itertools
import json
import os
import random
import signal
import struct
import sys
import time
from pathlib import Path
from typing import Any

from record_samples import HEADER, record

from rig.cli.interrupt import stop_on_signal
from rig.record import sink
from rig.record.writer import RecordWriter

RECORDS = [record(trigger) for trigger in range(3_000)]
COUNT = struct.Struct("<I")


def drive(folder: Path, told: int) -> int:
    """Record until told to stop, as `rig race` does; tell each trigger that is in a chunk."""
    take = sink.Sink.take

    def take_and_tell(self: sink.Sink, record: Any) -> None:
        take(self, record)
        os.write(told, COUNT.pack(self.triggers))

    sink.Sink.take = take_and_tell  # type: ignore[method-assign]
    with (
        stop_on_signal() as stop,
        RecordWriter(folder, HEADER, real_time=True) as recorder,
    ):
        for number in itertools.count():
            if stop.requested or number == len(RECORDS):
                return 130
            recorder.write(RECORDS[number])
            time.sleep(0.001)


def run(folder: Path, seed: int, signals: list[int]) -> dict[str, Any]:
    draw = random.Random(seed)
    heard, told = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(heard)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            code = drive(folder, told)
        except KeyboardInterrupt:
            code = 130
        sys.exit(code)
    os.close(told)
    os.read(heard, COUNT.size)
    time.sleep(draw.uniform(0.0, 0.25))
    for number in signals:
        os.kill(pid, number)
        sent_s = time.monotonic()
        time.sleep(draw.uniform(0.0, 0.02))
    kept = COUNT.pack(1)
    while data := os.read(heard, 1 << 16):
        kept = data[-COUNT.size :]
    _, status = os.waitpid(pid, 0)
    os.close(heard)
    code = os.waitstatus_to_exitcode(status)
    seconds = time.monotonic() - sent_s
    return {"folder": str(folder), "seed": seed, "code": code, "seconds": seconds,
            "kept": COUNT.unpack(kept)[0]}  # fmt: skip


def main() -> None:
    asked = json.loads(sys.argv[1])
    sink.CHUNK_BYTES = 1
    sink.PART_BYTES = asked["part_bytes"]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for seed in asked["seeds"]:
        folder = Path(asked["folder"]) / str(seed)
        sys.stdout.write(json.dumps(run(folder, seed, asked["signals"])) + "\n")


if __name__ == "__main__":
    main()
