"""`python -m tests.kills`: strike runs over a real bus at random moments; status 1 where one did not end as it must.

Results are kept as a line of JSON each: the command given again goes on where it was interrupted.
"""

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests.kills.report import report
from tests.kills.strikes import STRIKES
from tests.kills.trial import ServedBench, strike_once

TWO_AT_ONCE = 0.2


def drawn_strikes(drawn: random.Random, struck: int) -> list[str]:
    """Each strike as often as any other, and in a fifth of the trials a second one with it."""
    first = list(STRIKES)[struck % len(STRIKES)]
    second = [drawn.choice([name for name in STRIKES if name != first])] if drawn.random() < TWO_AT_ONCE else []
    return [first, *second]


def main() -> int:
    """Parse, strike, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--consumer-ms", type=int, default=200, help="consumer heartbeat time of both drives")
    parser.add_argument("--bus", choices=("udp_multicast", "pty"), default="udp_multicast", help="pty: slcan on one")
    parser.add_argument(
        "--results", type=Path, default=Path("kills.jsonl"), help="one line a trial; goes on after them"
    )
    parser.add_argument("--report", type=Path, help="write the report to this .md as well")
    asked = parser.parse_args()
    done = [json.loads(line) for line in asked.results.read_text().splitlines()] if asked.results.exists() else []
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # signals that dump core are among what strikes
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a run heeds none that was ignored when it began, as by nohup
    directory = Path(tempfile.mkdtemp(prefix="leactl-kills-"))
    served = ServedBench(directory, asked.bus, asked.consumer_ms)
    try:
        while (struck := sum("void" not in item for item in done)) < asked.count:
            number = len(done)
            drawn = random.Random(f"{asked.seed} {number}")
            after_s, names = drawn.uniform(0.0, 1.5), drawn_strikes(drawn, struck)
            result = strike_once(served, number, names, after_s)
            done.append(result)
            with asked.results.open("a") as results:
                results.write(json.dumps(result) + "\n")
            print(f"{struck + 1} of {asked.count}: {json.dumps(result)}", file=sys.stderr, flush=True)
            if not result.get("faults"):
                shutil.rmtree(directory / str(number))
    finally:
        served.close()
    text = report(done, asked.consumer_ms * 1e-3)
    print(text)
    if asked.report:
        asked.report.write_text(text)
    if any(result.get("faults") for result in done):
        return 1
    shutil.rmtree(directory)
    return 0


if __name__ == "__main__":
    sys.exit(main())
