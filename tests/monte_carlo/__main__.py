"""`python -m tests.monte_carlo`: random protocols on random plants; status 1 where the guard, a stop or a file failed.

Results are kept as a line of JSON each: the command given again goes on where it was interrupted.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests.monte_carlo.report import report
from tests.monte_carlo.trial import Campaign, violations
from tests.monte_carlo.working import one_batch, own_state

BATCH = 40  # trials that share the lanes of their true temperatures


def main() -> int:
    """Parse, try, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.monte_carlo", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="trials of plants inside the tolerances")
    parser.add_argument("--wire", type=int, default=500, help="of these, run whole over the emulated wire")
    parser.add_argument("--outside", type=int, help="further trials outside the guard's model; default half of --count")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--results", type=Path, default=Path("monte-carlo.jsonl"), help="goes on after its lines")
    parser.add_argument("--report", type=Path, help="write the report to this .md as well")
    asked = parser.parse_args()
    outside = asked.count // 2 if asked.outside is None else asked.outside
    campaign = Campaign(asked.count, min(asked.wire, asked.count), outside, asked.seed)
    told = [json.loads(line) for line in asked.results.read_text().splitlines()] if asked.results.exists() else []
    known = {item["number"] for item in told}
    left = [number for number in campaign.numbers if number not in known]
    began = time.monotonic()
    for batch in _batches(campaign, left, asked.processes):
        with asked.results.open("a") as results:
            results.writelines(json.dumps(item) + "\n" for item in batch)
        told += batch
        done = len(told) - len(known)
        seconds = (time.monotonic() - began) * (len(left) - done) / done
        bad = [item for item in batch if violations(item)]
        for item in bad:
            print(f"VIOLATION {'; '.join(violations(item))}: {json.dumps(item)}", file=sys.stderr)
        line = f"{len(told)} of {len(campaign.numbers)} trials; about {seconds / 60:.0f} min left"
        print(line, file=sys.stderr, flush=True)
    told = [item for item in told if item["number"] in campaign.numbers]
    text = report(told, campaign)
    print(text)
    if asked.report:
        asked.report.write_text(text)
    return 1 if any(violations(item) for item in told) else 0


def _batches(campaign: Campaign, numbers: list[int], processes: int) -> Iterator[list[dict[str, Any]]]:
    """Results as they come, from processes with states of their own."""
    size = max(1, min(BATCH, len(numbers) // processes))
    work = [(campaign, numbers[first : first + size]) for first in range(0, len(numbers), size)]
    with (
        tempfile.TemporaryDirectory(prefix="leactl-monte-carlo-") as place,
        multiprocessing.get_context("spawn").Pool(processes, own_state, [place], maxtasksperchild=20) as pool,
    ):
        yield from pool.imap_unordered(one_batch, work)


if __name__ == "__main__":
    sys.exit(main())
