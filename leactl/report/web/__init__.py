"""A run's page in a browser: `leactl run --web`.

These constants are shared by the command, the run's process (`feed`) and the process that serves the page (`server`).
"""

from typing import Final

FREE_PORT_HERE: Final = "127.0.0.1:0"  # the default ADDRESS:PORT: loopback, and a port that the system chooses
STOP: Final = b"!"  # the byte that the server writes to the run's process for each press of STOP
LAST_REQUEST_S: Final = 1.5  # after the end of the run, in which an open page can still ask how it ended
