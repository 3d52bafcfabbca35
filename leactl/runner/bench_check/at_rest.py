"""Check a bench without any current: which devices answer, and what each channel reads while every drive is off."""

from collections.abc import Iterator, Mapping

import numpy as np

from leactl.analysis.quality.channel_plausibility import CONSTANT_AT_REST, MOST_MISSING_SHARE, NEVER_ZERO, NOT_MEASURED
from leactl.analysis.quality.repeated_readings import FEWEST_REPEATS
from leactl.runfile.read.reader import Channel, Run
from leactl.runner.bench_check.statement import Statement, StatementVerdict
from leactl.runner.request import Request

SINGLE_IN_ROLE = ("torque", "velocity", "angle", "q_axis_current")  # analyses take one channel of a role
# A constant channel counts as frozen if its `stuck_s` is at most this multiple of the time that was read: 0.8 s of
# readings judge a `stuck_s` of 1 s.
MOST_STUCK_TIME_OVER_SPAN = 1.5


def opening_statements(failures: Mapping[str, str]) -> list[Statement]:
    """Return a statement for each device on whether it answers.

    Parameters
    ----------
    failures : by device, why it could not be opened; empty if it was opened.
    """
    return [
        Statement(
            name, "answers", StatementVerdict.WRONG if text else StatementVerdict.OK, why=text.removeprefix(f"{name}: ")
        )
        for name, text in failures.items()
    ]


def statements_at_rest(run: Run, request: Request, reported: Mapping[str, Mapping[str, str]]) -> list[Statement]:
    """Judge identities, notices and channels of a run with every drive off.

    Parameters
    ----------
    reported : what each device reports of itself, as `Outcome.reported`.
    """
    channels = [*_channels(run, request), *_measured_twice(run, request)]
    return [*_identities(request, reported), *_notices(run, request), *channels]


def _identities(request: Request, reported: Mapping[str, Mapping[str, str]]) -> Iterator[Statement]:
    """Yield statements on each device: that it answers, and whether serial and firmware are those of the bench file."""
    for device in request.devices:
        identity, stated = reported[device.name], device.entry.facts
        yield Statement(
            device.name, "answers", StatementVerdict.OK, why=", ".join(f"{key} {identity[key]}" for key in identity)
        )
        for key in ("serial", "firmware"):
            if key in identity and key in stated:  # a device with another serial number has failed to open
                same = key == "serial" or identity[key] == stated[key]
                verdict, why = (
                    (StatementVerdict.OK, "")
                    if same
                    else (StatementVerdict.WRONG, f"the bench file says {stated[key]}")
                )
            elif key in stated:
                verdict, why = StatementVerdict.UNDECIDED, f"the bench file says {stated[key]}, the device reports none"
            elif key in identity and key == "serial":
                verdict, why = (
                    StatementVerdict.UNDECIDED,
                    "the bench file states none: another device would not be noticed",
                )
            else:
                continue
            text = "; ".join(filter(None, (identity.get(key, ""), why)))
            change = f'state {key}: "{identity[key]}"' if key in identity and verdict is not StatementVerdict.OK else ""
            line = request.bench_document.fault(("devices", device.name, key), change) if change else ""
            yield Statement(device.name, key, verdict, why=text, change=line)


def _notices(run: Run, request: Request) -> Iterator[Statement]:
    """Yield the warnings and errors that devices gave during the run.

    Those on firmware are left out: `_identities` judges the firmware.
    """
    names = {device.name for device in request.devices}
    for event in run.events:
        if event.source in names and event.level in ("warning", "error") and not event.message.startswith("firmware "):
            yield Statement(event.source, "notice", StatementVerdict.UNDECIDED, why=event.message)


def _channels(run: Run, request: Request) -> Iterator[Statement]:
    """Yield a statement on the readings of each measured channel."""
    measured = dict.fromkeys((spec.quantity, spec.role) for specs in run.streams.values() for spec in specs)
    for quantity, role in measured:
        if not quantity.endswith("_reference") and quantity not in NOT_MEASURED:
            yield from (_channel(channel, request) for channel in run.channels(quantity, role))


def _measured_twice(run: Run, request: Request) -> Iterator[Statement]:
    """Yield a statement for each channel after the first where analyses take one channel of a quantity and role."""
    settings = {device.name: device.settings for device in request.devices}
    for quantity, role in ((quantity, role) for quantity in SINGLE_IN_ROLE for role in ("test", "load")):
        channels = run.channels(quantity, role)
        for channel in channels[1:]:
            locations = [shown.place for shown in settings[channel.device].shown() if shown.quantity == quantity]
            line = request.bench_document.fault(
                ("devices", channel.device, "settings", *(locations[-1][:2] if locations else ())),
                f"leave it out, or leave {channels[0].device} out, or give it another role",
            )
            why = f"{channels[0].device} measures it too; `--move` and the analyses take one channel only"
            yield Statement(channel.device, f"{quantity} of {role}", StatementVerdict.WRONG, why=why, change=line)


def _channel(channel: Channel, request: Request) -> Statement:
    """Judge the readings of one channel at rest."""
    quantity, role = channel.quantity, channel.role
    values = channel.values[np.isfinite(channel.values)]
    about = " ".join(filter(None, (quantity, "of", role, channel.location and f"at {channel.location}")))
    if not len(values):
        text = f"none of {len(channel)} readings is a number: is it connected?"
        return Statement(channel.device, about, StatementVerdict.WRONG, why=text)
    mean, std = float(values.mean()), float(values.std())
    low, high = request.bench.limits.of(quantity) or (np.nan, np.nan)
    interlocks = request.bench.interlocks.of(quantity, role)
    shortest_stuck_s = min((interlock.stuck_s for interlock in interlocks if interlock.stuck_s), default=np.inf)
    verdict, why = StatementVerdict.OK, ""
    missing_share = 1.0 - len(values) / len(channel)
    constant = len(values) >= FEWEST_REPEATS and np.ptp(values) == 0.0
    span = channel.time[-1] - channel.time[0]  # s
    if mean < low or mean > high:
        verdict, why = StatementVerdict.WRONG, "beyond the bench's limits"
    elif quantity in NEVER_ZERO and not values.any():
        verdict, why = StatementVerdict.WRONG, "exactly 0, which it never is: is it connected?"
    elif constant and quantity in CONSTANT_AT_REST:
        verdict, why = (
            StatementVerdict.UNDECIDED,
            "constant, as expected at rest; `leactl bench check --move` tests it",
        )
    elif constant and shortest_stuck_s <= MOST_STUCK_TIME_OVER_SPAN * span:
        verdict, why = (
            StatementVerdict.WRONG,
            f"frozen: the same in {len(values)} readings, although stuck_s says that noise changes it",
        )
    elif constant:
        verdict, why = (
            StatementVerdict.UNDECIDED,
            f"the same in {len(values)} readings: frozen, or coarser than its noise",
        )
    elif missing_share > MOST_MISSING_SHARE:
        verdict, why = StatementVerdict.UNDECIDED, f"{missing_share:.1%} of its readings are missing"
    return Statement(channel.device, about, verdict, mean, std, channel.units, float(low), float(high), why)
