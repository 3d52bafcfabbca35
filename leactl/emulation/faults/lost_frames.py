"""Frames that do not arrive."""

from leactl.emulation.faults.contract import OfFrames


class LostFrames(OfFrames):
    """Frames are lost: a bad termination, a full receive buffer, or, where it is all of them, a cable that is off."""

    example = "{fault: lost_frames, at_s: 2, for_s: 1, bus: can0, share: 0.5}"

    @property
    def fate(self) -> float | None:
        """They never arrive."""
        return None
