"""A run's page in a browser: `leactl run --web`. What stands here is agreed between the run and the page's process."""

from typing import Final

STOP: Final = b"!"  # what the run's process reads of a STOP
LAST_LOOK_S: Final = 1.5  # that an open page has to ask for the end of the run
