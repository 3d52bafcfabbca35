"""A page as PDF, printed by a Chromium that is installed."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from leactl.bench.host_checks import HostFinding
from leactl.errors import DeviceError, InputError
from leactl.runfile.publish import replacement

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
# no network, no first-start traffic, nothing of the user's own profile
FLAGS = (
    "--headless",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--no-pdf-header-footer",
)
LONGEST_S = 120.0


def examine() -> HostFinding:
    """Whether a page can be printed on this machine."""
    browser_path = installed()
    text = browser_path or "none in PATH; `leactl report --pdf` prints by one"
    return HostFinding(
        "Chromium", browser_path is not None, False, text, "" if browser_path else "sudo apt install chromium"
    )


def installed() -> str | None:
    """Path of the first browser that is installed; None where there is none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def browser() -> str:
    """Path of the first browser that is installed.

    Raises
    ------
    InputError : there is none.
    """
    browser_path = installed()
    if browser_path is None:
        raise InputError(
            f"--pdf: needs a Chromium to print with, and none of {', '.join(BROWSERS)} is in PATH; install one"
            " (sudo apt install chromium), or print the page from any browser"
        )
    return browser_path


def print_pdf(html: Path, out: Path) -> None:
    """Print a page to a PDF; an earlier one is replaced at once or not at all.

    Raises
    ------
    InputError : no browser.
    DeviceError : the browser failed.
    """
    command = [browser(), *FLAGS]
    # as root Chromium does not start inside its sandbox; the page is our own and has no script
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--no-sandbox")
    with tempfile.TemporaryDirectory() as profile, replacement(out) as path:
        # Chromium may leave by status 0 without a file, so that the file is what counts
        command += [f"--user-data-dir={profile}", f"--print-to-pdf={path}", html.resolve().as_uri()]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
        except subprocess.TimeoutExpired:
            raise DeviceError(f"{out}: {command[0]} did not print within {LONGEST_S:g} s") from None
        if done.returncode or not path.exists():
            last = (done.stderr.strip().splitlines() or ["no word"])[-1]
            raise DeviceError(f"{out}: {command[0]} did not print: {last}")
