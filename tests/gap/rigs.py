"""Rigs drawn at random: any channels, any rate, models that lack what many lack, records as bad as they come.

One in twenty runs for minutes or hours: what a joint does in a few thousand samples again and again, in files.
"""

from dataclasses import replace

import h5py
import numpy as np

from leactl.gap.diagnose import Case, hold_out_runs
from leactl.gap.replay.long_runs import read_records
from leactl.gap.signals.record import build_record
from leactl.model.nominal import BenchModel, Model
from leactl.runfile import layout
from tests.gap import joints

RATES = (20.0, 50.0, 100.0, 250.0, 400.0, 1000.0, 2000.0, 5000.0, 20000.0)  # Hz
LENGTHS = (0.2, 2.0, 6.0, 20.0, 60.0)  # s
MOST = 8000  # samples of a run that is simulated
LONG, LONG_LENGTHS, LONGEST = 0.05, (120.0, 1200.0, 7200.0), 1_000_000  # share of the rigs, s, samples of a run
KINDS = ("multisine", "levels", "ramp")
QUANTITIES = ("q_axis_current", "q_axis_current_reference", "velocity", "angle")
DAMAGES = ("none", "nan", "gap", "jitter", "coarse", "constant", "wrapped", "clipped", "short", "repeated")
PARAMETERS = ("torque_constant", "rotor_inertia", "viscous_damping", "coulomb_friction", "back_emf_constant")


def drawn_rig(seed, folder):
    """A case of one to six runs; long ones are written into a folder and read again.

    Raises
    ------
    InputError : a run that holds too little, as its file would be refused.
    """
    random = np.random.default_rng([77, seed])
    joint = joints.drawn_joint(random)
    rate = float(random.choice(RATES))
    loop, filtered = rate * random.uniform(0.05, 0.6, 2)
    joint = replace(joint, rate=rate, loop=loop, filter=filtered)
    seconds = float(np.clip(min(random.choice(LENGTHS), MOST / rate), 3.0 / rate, None))
    log = joints.Log() if random.random() < 0.3 else joints.drawn_log(random)
    lacking = {quantity for quantity in QUANTITIES if random.random() < 0.25}
    damage, mechanical = random.choice(DAMAGES), random.choice(["free", "free", "free", "locked", "coupled"])
    again, lasts = np.random.default_rng([78, seed]), 0.0
    if again.random() < LONG:
        seconds, lasts = MOST / 2 / rate, float(again.choice(LONG_LENGTHS))
    made, rows = round(seconds * rate), min(round(lasts * rate), LONGEST)
    records, written = [], []
    for index, kind in enumerate(random.choice(KINDS, int(random.choice([1, 2, 3, 6])))):
        whole = joints.channels(joint, log, str(kind), random, seconds=seconds)
        whole = [lengthened(channel, rows, rate) for channel in whole] if rows > made else whole
        kept = [channel for channel in whole if channel.quantity not in lacking]
        kept += more_channels(kept, joint, mechanical, random)
        spoilt = [damaged(channel, damage, joint, random) for channel in kept]
        path = folder / f"{kind}-{index}.h5"
        if rows > made:
            write(path, str(kind), str(mechanical), spoilt)
            written.append(path)
        else:
            records.append(build_record(path, str(kind), str(mechanical), spoilt, {}))
    records += [record for several in read_records(written, BenchModel()).values() for record in several]
    fitted, held_out = hold_out_runs(records)
    return Case(poor_model(joint, mechanical, random), fitted, held_out)


def lengthened(channel, rows, rate):
    """A channel that goes on and on; an angle from where it is."""
    times = -(-rows // len(channel.values))
    values = np.tile(channel.values, times)[:rows]
    if channel.quantity == "angle":
        further = channel.values[-1] - channel.values[0]
        values = values + np.repeat(np.arange(times) * further, len(channel.values))[:rows]
    return replace(channel, time=(np.arange(rows) + 1) / rate, values=values)


def write(path, kind, mechanical, channels):
    """A run file with a stream for every clock."""
    with h5py.File(path, "w", libver=layout.HDF5_FORMAT) as file:
        file.attrs.update({"format": layout.FORMAT, "format_version": layout.VERSION, "protocol": kind})
        file.create_group("setup").attrs["mechanical"] = mechanical
        streams = file.create_group("streams")
        for channel in channels:
            stream = next((value for value in streams.values() if np.array_equal(value["time"][:], channel.time)), None)
            if stream is None:
                stream = streams.create_group(f"clock{len(streams)}")
                stream["time"] = channel.time
            column = stream.create_dataset(channel.quantity, data=channel.values)
            told = ("quantity", "role", "units", "device", "long_name", "sampling")
            column.attrs.update({name: getattr(channel, name) for name in told if getattr(channel, name)})


def more_channels(channels, joint, mechanical, random):
    """Torque, voltage and temperatures as some rigs have them, true to nothing."""
    if not channels:
        return []
    first, found = channels[0], []
    if mechanical != "free" and random.random() < 0.8:
        torque = joint.constant * joint.top * np.sin(first.time) + 0.01 * random.standard_normal(len(first.time))
        found.append(replace(first, values=torque, quantity="torque", units="N*m"))
    if random.random() < 0.3:
        found.append(replace(first, values=10.0 * np.sin(first.time), quantity="q_axis_voltage", units="V"))
    if random.random() < 0.2:
        time = np.linspace(first.time[0], first.time[-1], 80)
        for quantity in ("winding_temperature", "housing_temperature"):
            warm = 25.0 + 0.01 * time + 0.05 * random.standard_normal(len(time))
            found.append(
                replace(first, time=time, values=warm, quantity=quantity, units="degC", sampling="", stream="camera")
            )
    return found


def damaged(channel, damage, joint, random):
    """A channel as a bad record has it; not every channel of it is hit."""
    time, values, hit = channel.time, channel.values.copy(), random.random() < 0.6
    if damage == "gap" and len(values) > 20:
        keep = np.r_[: len(values) // 3, len(values) // 2 : len(values)]
        return replace(channel, time=time[keep], values=values[keep])
    if damage == "jitter":
        late = 0.4 / joint.rate * np.random.default_rng(len(values)).standard_normal(len(time))
        return replace(channel, time=np.sort(time + late) + 1e-9 * np.arange(len(time)))
    if damage == "short":
        return replace(channel, time=time[:3], values=values[:3])
    if damage == "wrapped" and channel.quantity == "angle":
        return replace(channel, values=np.mod(values + np.pi, 2.0 * np.pi) - np.pi)
    if not hit:
        return channel
    if damage == "nan":
        values[random.random(len(values)) < random.choice([0.01, 0.5])] = np.nan
    elif damage == "coarse":
        step = max(np.ptp(values), 1e-9) / random.choice([4, 64, 4096])
        values = np.round(values / step) * step
    elif damage == "constant":
        values[:] = random.choice([0.0, values[0]])
    elif damage == "clipped":
        values = np.clip(values, -0.5 * np.max(np.abs(values)), 0.5 * np.max(np.abs(values)))
    elif damage == "repeated":
        values[1::2] = values[::2][: len(values[1::2])]
    return replace(channel, values=values)


def poor_model(joint, mechanical, random):
    """The joint's model without some of what a model may have."""
    document = joint.model(random).model_dump(exclude_none=True)
    for name in PARAMETERS:
        if random.random() < 0.12:
            document.pop(name)
    for name in ("velocity_filter_bandwidth", "current_loop_bandwidth"):
        if random.random() < 0.3:
            document["bench"].pop(name)
    if mechanical != "free":
        document["bench"]["shaft_stiffness"] = 1000.0 * joint.constant * joint.top
    if random.random() < 0.3:
        document["phase_resistance"] = 0.5
    return Model.model_validate(document)
