"""Rigs drawn at random: any channels, any rate, models that lack what many lack, records as bad as they come."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from leactl.gap.diagnose import Case, split
from leactl.gap.record import build
from leactl.model.nominal import Model
from tests.gap import joints

RATES = (20.0, 50.0, 100.0, 250.0, 400.0, 1000.0, 2000.0, 5000.0, 20000.0)  # Hz
LENGTHS = (0.2, 2.0, 6.0, 20.0, 60.0)  # s
MOST = 8000  # samples of a run
KINDS = ("multisine", "levels", "ramp")
QUANTITIES = ("q_axis_current", "q_axis_current_reference", "velocity", "angle")
DAMAGES = ("none", "nan", "gap", "jitter", "coarse", "constant", "wrapped", "clipped", "short", "repeated")
PARAMETERS = ("torque_constant", "rotor_inertia", "viscous_damping", "coulomb_friction", "back_emf_constant")


def drawn_rig(seed):
    """A case of one to six runs.

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
    records = []
    for index, kind in enumerate(random.choice(KINDS, int(random.choice([1, 2, 3, 6])))):
        whole = joints.channels(joint, log, str(kind), random, seconds=seconds)
        kept = [channel for channel in whole if channel.quantity not in lacking]
        kept += more_channels(kept, joint, mechanical, random)
        spoilt = [damaged(channel, damage, joint, random) for channel in kept]
        records.append(build(Path(f"{kind}-{index}.h5"), str(kind), str(mechanical), spoilt, {}))
    fitted, held_out = split(records)
    return Case(poor_model(joint, mechanical, random), fitted, held_out)


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
