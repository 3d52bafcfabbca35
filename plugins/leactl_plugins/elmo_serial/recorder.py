"""Upload the drive's own recorder, which samples all signals at the same instants; data are hexadecimal digits.

SimplIQ Software Manual, 7.4: RR says whether valid data are there, each bit of RC is a signal that RV names by number,
RG is the number of sampling times from sample to sample, WS[29] the sampling time in us, and BH=n uploads the signal of
one bit of RC.
"""

import math
import re
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from leactl.driver.contract import OwnRecording
from leactl.driver.conversation import Unreadable
from leactl.errors import DeviceError
from leactl_plugins.elmo_serial.interpreter import UPLOAD_COMMAND, Interpreter

SIGNALS = {  # by the number in RV; unit in brackets
    1: "VX (counts/s)",
    2: "PX (counts)",
    3: "DV[3] (counts)",
    5: "PE (counts)",
    6: "DV[1] (A)",
    7: "DC bus (V)",
    8: "PY (counts)",
    9: "VY (counts/s)",
    10: "IQ (A)",
    11: "ID (A)",
    12: "AN[1] (V)",
    14: "AN[3] (A)",
    15: "AN[4] (A)",
    16: "DV[2] (counts/s)",
}
# of the digits, 2 are the type, 2 the width, 4 the length, 4 the gap and 8 the factor (a big-endian float)
HEAD_DIGITS = 20
ITEM_FORMATS = {4: ">i2", 8: ">i4"}  # by the number of digits of an item
RC_BITS = 16
SHORTEST_US, LONGEST_US = 10, 10_000  # range in which WS[29] is a time in microseconds
LONGEST_UPLOAD_S = 30.0  # 4096 items of 8 digits take 17 s at 19200 baud


class Upload(NamedTuple):
    """One uploaded signal."""

    values: NDArray[np.float64]  # shape (items,), in the signal's unit
    gap: int  # between two items, in sampling times of the recorder


def parse_upload(text: str) -> Upload:
    """Parse the answer to BH.

    Raises
    ------
    Unreadable : the text is no hexadecimal upload, or its head contradicts its length or has an impossible width,
        factor or gap.
    """
    if len(text) < HEAD_DIGITS or not re.fullmatch(r"[0-9A-Fa-f]+", text, re.ASCII):
        raise Unreadable(
            f"a recording of {len(text)} characters; at least {HEAD_DIGITS} hexadecimal digits were expected"
        )
    width, length, gap = int(text[2:4], 16), int(text[4:8], 16), int(text[8:12], 16)
    (factor,) = struct.unpack(">f", bytes.fromhex(text[12:HEAD_DIGITS]))
    if width not in ITEM_FORMATS:
        raise Unreadable(f"a recording of items of {width} digits; 4 or 8 were expected")
    if len(text) != HEAD_DIGITS + width * length:
        raise Unreadable(f"a recording of {(len(text) - HEAD_DIGITS) / width:g} items where its head says {length}")
    if not math.isfinite(factor) or gap < 1:
        raise Unreadable(f"a recording with the factor {factor:g} and a gap of {gap}")
    items = np.frombuffer(bytes.fromhex(text[HEAD_DIGITS:]), ITEM_FORMATS[width])
    return Upload(items.astype(np.float64) * factor, gap)


def upload_recording(interpreter: Interpreter, answer_s: float) -> OwnRecording:
    """Upload all signals of the recorder.

    Parameters
    ----------
    answer_s : longest time for the reply to a query; an upload may take `LONGEST_UPLOAD_S`.

    Raises
    ------
    DeviceError : it has no recording, is busy, or its answer cannot be parsed.
    """
    replies = interpreter.ask("RR", "RC", "RG", "WS[29]", within_s=answer_s)
    state, signal_mask, gap, sampling_us = (replies.integer(name) for name in ("RR", "RC", "RG", "WS[29]"))
    if state != 0:
        state_text = "holds nothing" if state < 0 else "waits for its trigger, or records"
        raise DeviceError(f"its recorder {state_text} (RR is {state}); a complete recording, RR of 0, was expected")
    if not SHORTEST_US <= sampling_us <= LONGEST_US:
        raise DeviceError(
            f"its recorder samples every {sampling_us} us (WS[29]); {SHORTEST_US} to {LONGEST_US} us were expected"
        )
    uploads: dict[str, Upload] = {}
    for signal_slot in range(1, RC_BITS + 1):
        if (signal_mask >> (signal_slot - 1)) & 1:
            number = interpreter.ask(f"RV[{signal_slot}]", within_s=answer_s).integer(f"RV[{signal_slot}]")
            command = f"{UPLOAD_COMMAND}{1 << (signal_slot - 1)}"
            answer = interpreter.ask(command, within_s=LONGEST_UPLOAD_S, attempts=1).text(command)
            uploads[SIGNALS.get(number, f"signal {number}")] = upload = parse_upload(answer)
            if upload.gap != gap:
                raise Unreadable(f"{command} was answered by a gap of {upload.gap} where RG is {gap}")
    lengths = {len(upload.values) for upload in uploads.values()}
    if len(lengths) != 1:
        listed = ", ".join(map(str, sorted(lengths)))
        fault = f"signals of different lengths: {listed} items" if lengths else "no signal"
        raise Unreadable(f"its recorder gives {fault}")
    values = np.stack([upload.values for upload in uploads.values()], axis=1)
    return OwnRecording(tuple(uploads), 1e-6 * gap * sampling_us, values)
