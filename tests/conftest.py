"""What every test starts from: processes that heed Ctrl-C."""

import signal


def pytest_configure():
    # a script's background job begins with SIGINT ignored, and so would every process that a test starts
    signal.signal(signal.SIGINT, signal.default_int_handler)
