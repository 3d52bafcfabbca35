"""Channels that are turned or scaled: against what other channels, and the model, make of them.

A factor that an effect or a wrong parameter may have is left to these. One of a fault is far beyond that, alike in
every run, and explains nearly all of what the channel is off by.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.record import Key, Record
from leactl.gap.rig import fed_by_voltage
from leactl.gap.setup.contract import SetUpFault, with_values
from leactl.gap.signals import fast_signals
from leactl.gap.smoothing import smooth
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
SIGN, SCALE, COUNTS, POLES = "channel_sign", "channel_scale", "encoder_counts", "pole_pairs"
CONVENTIONS = {
    "2/3": 2.0 / 3.0,
    "3/2": 1.5,
    "sqrt(3/2)": math.sqrt(1.5),
    "sqrt(2/3)": math.sqrt(2.0 / 3.0),
    "sqrt(2)": math.sqrt(2.0),
    "1/sqrt(2)": math.sqrt(0.5),
    "sqrt(3)": math.sqrt(3.0),
    "1/sqrt(3)": math.sqrt(1.0 / 3.0),
    "1000": 1000.0,
    "1/1000": 1e-3,
    "pi/180": math.pi / 180.0,
    "180/pi": 180.0 / math.pi,
    "60/(2 pi)": 30.0 / math.pi,
    "2 pi/60": math.pi / 30.0,
    "1/(2 pi)": 0.5 / math.pi,
    "2 pi": 2.0 * math.pi,
}
MEASURED, MODELLED = (
    0.06,
    0.3,
)  # logarithm of a factor, up to which a sound channel may be off one measured, or modelled
EXPLAINS = 0.8  # of what a channel is off by
FITS = 0.8  # of a channel's variance, that its companion has to explain
ALIKE = 0.1  # logarithm, by which the factors of two runs may differ
MOST_POLES = 64
FEWEST = 50  # samples


@dataclass(frozen=True)
class Pair:
    """One channel of one run beside what it should be."""

    key: Key
    against: str
    usual: float  # logarithm of a factor, up to which it may be a wrong parameter or an effect
    reads: Array
    expected: Array

    @property
    def factor(self) -> float:
        """Reading over what it should be; NaN where the one does not follow the other."""
        reads, expected = self.reads - self.reads.mean(), self.expected - self.expected.mean()
        power, both = float(expected @ expected), float(reads @ expected)
        if len(reads) < FEWEST or both**2 <= FITS * power * float(reads @ reads):  # zero where one of them stands still
            return math.nan
        return both / power

    def explained(self, factor: float) -> float:
        """Share of what the channel is off by that goes once its factor is undone."""
        reads, expected = self.reads - self.reads.mean(), self.expected - self.expected.mean()
        before, after = np.sum((reads - expected) ** 2), np.sum((reads / factor - expected) ** 2)
        return float(1.0 - after / before) if before > 0.0 else 0.0


def misscaled(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """The channel that is turned or scaled most clearly, if one is."""
    pairs: dict[Key, list[Pair]] = {}
    for record in records:
        for pair in pairs_of(record, model):
            pairs.setdefault(pair.key, []).append(pair)
    found = {key: common for key, group in pairs.items() if (common := common_factor(group)) is not None}
    if not found:
        return None
    # a turned current turns the torque that an angle is compared with, and a turned angle the speed: these go first
    first = (key for quantity in ("q_axis_current", "angle") for key in found if key[0] == quantity)
    key = next(first, max(found, key=lambda key: found[key][1]))
    return fault_of(
        key, pairs[key], *found[key], also=[("velocity", key[1])] if ("velocity", key[1]) not in found else []
    )


def pairs_of(record: Record, model: Model) -> Iterator[Pair]:
    """Channels of a run beside what others, or the model, make of them."""
    clock, s = record.fast, fast_signals(record, model, None)
    if clock is None or s is None:
        return
    for role in ("test", "load"):
        velocity, angle = clock.get("velocity", role), clock.get("angle", role)
        if velocity is not None and angle is not None:
            valid = clock.all_valid(("velocity", role), ("angle", role))
            turning = np.diff(angle, prepend=angle[0]) / clock.interval
            yield Pair(("velocity", role), "the angle", MEASURED, smooth(velocity)[valid], smooth(turning)[valid])
        current, reference = clock.get("q_axis_current", role), clock.get("q_axis_current_reference", role)
        if current is not None and reference is not None:
            valid = clock.all_valid(("q_axis_current", role), ("q_axis_current_reference", role))
            yield Pair(
                ("q_axis_current", role), "its reference", MEASURED, smooth(current)[valid], smooth(reference)[valid]
            )
    torque = clock.get("torque")
    if torque is not None and s.torque is not None:
        valid = clock.all_valid(("torque", "test"), ("q_axis_current", "test"), ("angle", "test"))
        yield Pair(("torque", "test"), "current and motion", MODELLED, smooth(torque)[valid], s.torque[valid])
    if s.voltage is not None and s.current is not None and s.velocity is not None and model.phase_resistance:
        constant = model.back_emf_constant or model.torque_constant or 0.0
        volts = model.phase_resistance * s.current + constant * s.velocity
        valid = clock.all_valid(("q_axis_voltage", "test"), ("q_axis_current", "test"), ("angle", "test"))
        yield Pair(("q_axis_voltage", "test"), "current and speed", MODELLED, s.voltage[valid], volts[valid])
    if (fed := fed_by_voltage(record, model)) is not None and s.voltage is not None and s.velocity is not None:
        # how many volts a speed takes is what such runs are to tell: only their sense says something
        volts = (fed.damping * s.velocity + (model.coulomb_friction or 0.0) * np.sign(s.velocity)) / fed.gain
        valid = clock.all_valid(("q_axis_voltage", "test"), ("angle", "test"), ("velocity", "test"))
        # each with its mirror image: a step holds one voltage, whose sense is in its mean
        reads, takes = (np.concatenate([values[valid], -values[valid]]) for values in (s.voltage, volts))
        yield Pair(("q_axis_voltage", "test"), "the motion", math.inf, reads, takes)
    if s.mechanical == "free" and s.current is not None and s.velocity is not None and model.load.type == "none":
        parts = (model.rotor_inertia, model.viscous_damping, model.coulomb_friction)
        if model.torque_constant and None not in parts and s.acceleration is not None and s.sliding is not None:
            inertia, damping, friction = (float(part or 0.0) for part in parts)
            takes = inertia * s.acceleration + damping * s.velocity + friction * s.sliding
            valid = clock.all_valid(("q_axis_current", "test"), ("angle", "test"))
            drives = model.torque_constant * s.current
            # noise of an angle twice differentiated is in what motion takes: the current is the clean side of the two
            yield Pair(("angle", "test"), "the current's torque", math.inf, takes[valid], drives[valid])


def common_factor(group: Sequence[Pair]) -> tuple[float, float] | None:
    """The factor that all runs of a channel agree on, and the share it explains; None where it is usual."""
    factors = np.array([pair.factor for pair in group])
    known = factors[np.isfinite(factors)]
    if len(known) == 0 or (np.sign(known) != np.sign(known[0])).any():
        return None
    sizes = np.log(np.abs(known))
    middle = float(np.median(sizes))
    if known[0] > 0.0 and abs(middle) <= group[0].usual:
        return None
    if math.isfinite(group[0].usual) and float(np.ptp(sizes)) > 2.0 * ALIKE:  # else the sense alone says something
        return None
    factor = math.copysign(math.exp(middle), float(known[0]))
    explained = float(np.median([pair.explained(factor) for pair in group if math.isfinite(pair.factor)]))
    return (factor, explained) if explained >= EXPLAINS else None


def fault_of(key: Key, group: Sequence[Pair], factor: float, explained: float, also: Sequence[Key]) -> SetUpFault:
    """A channel's factor as a fault with its convention, its evidence and the line that undoes it.

    Where an angle is turned, the channels that agree with it are turned as well.
    """
    quantity, against = key[0], group[0].against
    evidence = f"reads {factor:.4g} times what {against} {'make' if ' and ' in against else 'makes'} of it"
    spread = float(np.std([pair.factor for pair in group if math.isfinite(pair.factor)]))
    parameters = (EffectParameter("factor", factor, spread / math.sqrt(len(group)), "1"),)
    if factor < 0.0 and abs(math.log(-factor)) <= group[0].usual:
        change = f"give it `sign: -1` in the mapping, or turn its {quantity} in the bench file"
        turned = [key]
        if quantity == "angle":
            turned += also
            names = " and ".join(name for name, _ in turned)
            change = f"give {names} `sign: -1`, or current and reference: these runs cannot tell which"
        return SetUpFault(SIGN, key, explained, evidence, change, partial(divided, keys=turned, by=-1.0), parameters)
    if name := convention(factor):
        evidence += f" ({name})"
    change = f"multiply its `scale` in the mapping, or in the bench file, by {1.0 / factor:.6g}"
    peers: tuple[str, ...] = (COUNTS,) if quantity == "velocity" else ()
    poles = round(1.0 / factor)
    if quantity == "velocity" and 2 <= poles <= MOST_POLES and abs(poles * factor - 1.0) < MEASURED:
        peers = (COUNTS, POLES)
    mend = partial(divided, keys=[key], by=factor)
    return SetUpFault(SCALE, key, explained, evidence, change, mend, parameters, peers)


def divided(record: Record, keys: Sequence[Key], by: float) -> Record:
    """A record whose channels are divided by a factor."""
    for key in keys:
        if record.fast is not None and key in record.fast.values:
            record = with_values(record, key, record.fast.values[key] / by)
    return record


def convention(factor: float) -> str:
    """The convention that a factor equals within its error; empty where none does."""
    size = abs(factor)
    near = min(CONVENTIONS, key=lambda name: abs(math.log(size / CONVENTIONS[name])))
    return ("-" if factor < 0.0 else "") + near if abs(math.log(size / CONVENTIONS[near])) < MEASURED else ""
