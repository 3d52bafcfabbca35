"""Run the installed command as a person's shell would."""

import subprocess
import sys


def leactl(*arguments, **environment):
    command = [sys.executable, "-c", "from leactl.cli.main import main; main()", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment or None, check=False)
