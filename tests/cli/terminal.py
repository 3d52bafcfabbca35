"""Run the installed command as a person's shell would."""

import subprocess
import sys

COMMAND = [sys.executable, "-c", "from leactl.cli.main import main; main()"]


def leactl(*arguments, input=None, **environment):
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, input=input, env=environment or None, check=False)
