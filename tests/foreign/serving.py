"""An emulated far end served by a thread of the test's own process, in step with the wall clock."""

import threading
import time
from contextlib import contextmanager


@contextmanager
def served(bridge, clock):
    """Carry what arrives on either side of a bridge until the block is left."""
    ended, began = threading.Event(), time.monotonic()

    def serve():
        while not ended.wait(1e-3):
            clock.sleep_until(time.monotonic() - began)
            bridge.carry()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        bridge.close()
