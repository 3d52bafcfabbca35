"""A run's page in a browser: `leactl run --web`. What stands here the command, the run and the page's process share."""

from typing import Final

FREE_PORT_HERE: Final = "127.0.0.1:0"  # the address of a page for which none is given
STOP: Final = b"!"  # what the run's process reads of a STOP
LAST_LOOK_S: Final = 1.5  # that an open page has to ask for the end of the run
