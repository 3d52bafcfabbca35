"""A recording in its own process: `python -m runfile.recording <directory> <rows per flush> <limit in bytes or 0>`.

Writes rows until it is killed or the disk refuses; prints `flushed <rows>` after each flush that returned. Row i has
stamp i ms and the values i, i + 0.25 and -i.
"""

import resource
import sys
from pathlib import Path

import numpy as np

from leactl.runfile.write.writer import RecordingFailed, RunWriter

from .specimen import STREAMS, info


def main(directory: Path, rows_per_flush: int, limit: int) -> None:
    writer = RunWriter(directory, info(), STREAMS)
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    print("started", flush=True)
    total = 0
    try:
        while True:
            rows = np.arange(total, total + rows_per_flush, dtype="f8")
            writer.append("loop", rows * 1e-3, np.column_stack([rows, rows + 0.25, -rows]))
            writer.append_row("camera", total * 1e-3, [20.0, 30.0])
            writer.step("hold", total * 1e-3, rows[-1] * 1e-3, 0.0, {"first_row": total, "long": "ü" * 100})
            writer.event(total * 1e-3, "info", "test", "größer")
            writer.flush()
            total += rows_per_flush
            print(f"flushed {total}", flush=True)
    except RecordingFailed as fault:
        print(f"failed {fault}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
