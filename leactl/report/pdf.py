"""Print a page as PDF with an installed Chromium."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from leactl.bench.host_checks import HostFinding
from leactl.errors import DeviceError, InputError
from leactl.runfile.publish import replacement

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
# no network traffic, also not at a first start; the profile is a new folder, not the user's (see print_pdf)
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
PRINT_TIMEOUT_S = 120.0


def examine() -> HostFinding:
    """Return the finding for `leactl doctor` on whether a browser is installed that prints pages."""
    browser_path = installed_browser()
    text = browser_path or "none in PATH; `leactl report --pdf` needs one"
    return HostFinding(
        "Chromium", browser_path is not None, False, text, "" if browser_path else "sudo apt install chromium"
    )


def installed_browser() -> str | None:
    """Return the path of the first installed browser; None if none is installed."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def required_browser() -> str:
    """Return the path of the first installed browser.

    Raises
    ------
    InputError : no browser is installed.
    """
    browser_path = installed_browser()
    if browser_path is None:
        raise InputError(
            f"--pdf: needs a Chromium to print with, and none of {', '.join(BROWSERS)} is in PATH; install one"
            " (sudo apt install chromium), or print the page from any browser"
        )
    return browser_path


def print_pdf(html: Path, out: Path) -> None:
    """Print a page to a PDF file; an earlier file is replaced atomically, once the PDF is complete.

    Raises
    ------
    InputError : no browser is installed.
    DeviceError : the browser failed, or took longer than PRINT_TIMEOUT_S.
    """
    command = [required_browser(), *FLAGS]
    # Chromium does not start in its sandbox as root; the page is from this program and has no script
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.append("--no-sandbox")
    # Chromium's helper processes may still write to the profile while it is removed
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile, replacement(out) as path:
        command += [f"--user-data-dir={profile}", f"--print-to-pdf={path}", html.resolve().as_uri()]
        try:
            completed = subprocess.run(command, capture_output=True, text=True, timeout=PRINT_TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired:
            raise DeviceError(f"{out}: {command[0]} did not print within {PRINT_TIMEOUT_S:g} s") from None
        if completed.returncode or not path.exists():  # Chromium may end with status 0 and without a file
            last_line = (completed.stderr.strip().splitlines() or ["no message"])[-1]
            raise DeviceError(f"{out}: {command[0]} did not print: {last_line}")
