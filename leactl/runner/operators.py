"""Who confirms a prompt: a person at the terminal, or nobody where the bench is emulated."""

import select
import sys
from collections.abc import Callable


def at_the_terminal(text: str) -> Callable[[], bool]:
    """Ask on stderr; an Enter on stdin confirms, and the loop goes on meanwhile."""
    print(f"{text}  [Enter to go on]", file=sys.stderr, flush=True)

    def confirmed() -> bool:
        ready, _, _ = select.select([sys.stdin], [], [], 0.0)
        if ready:
            sys.stdin.readline()
        return bool(ready)

    return confirmed


def granted(_text: str) -> Callable[[], bool]:
    """Confirm at once: nobody has to touch an emulated bench."""
    return lambda: True
