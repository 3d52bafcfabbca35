"""A closed loop in words: what was named, and each held-out run before and after in the user's simulator."""

from leactl.exchange.loop import ClosedLoop, Played
from leactl.report.gap_words import listed
from leactl.report.listing import row
from leactl.report.terminal import aligned

HEADINGS = ["held out, rms of the angle [rad]", "as it was", "patched", "with callbacks", "closed"]


def lines(loop: ClosedLoop) -> list[str]:
    """For the terminal."""
    named = f"Named: {listed(list(loop.named))}." if loop.named else "No effect was named."
    rows = [_cells(run) for run in (*loop.runs, loop.whole)]
    lost = [f"{one.entry.effect}: left out, {one.reason}" for one in loop.patched.effects if one.reason]
    notes = [row("note: ", note) for note in loop.notes]
    written = [f"wrote {path}" for path in loop.written]
    return [named, "", aligned(HEADINGS, rows), "", *lost, *written, *([""] if notes else []), *notes]


def _cells(run: Played) -> list[str]:
    closed = "" if run.before <= 0.0 else f"{100.0 * (1.0 - run.after / run.before):.0f} %"
    return [run.run, f"{run.before:.4g}", f"{run.file:.4g}", f"{run.after:.4g}", closed]
