"""Measure the null of a case: simulate sound machines, which have no effect, through its runs, and fit them alike.

Each run is simulated again without any effect, in one piece. A torque keeps it near the measured motion and is added to
its current, so that the model explains the simulated run exactly. Its channels get the noise and rounding of the
measured ones and pass through the same regression. The sizes fitted there are the floors of the effects, the residuals
are the floors of the equations, and the changes of the parameters are their errors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import mul

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from leactl.effects import library
from leactl.effects.hysteresis_and_lags import delayed
from leactl.gap.diagnosis import CalibratedParameter
from leactl.gap.replay import replay_all
from leactl.gap.replay.bearing import TRIED_GIVES
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.drive import means_over_samples
from leactl.gap.replay.job import Job
from leactl.gap.replay.readings import replayed_angle, replayed_current, replayed_velocity
from leactl.gap.search.effect_regression import MOST_PRIOR_CHANGE, PINNED_PRIOR, PRIORS, Evidence, Null, bias_error
from leactl.gap.search.effect_sets import (
    ENTRY_HEIGHT,
    EffectSet,
    FurtherEffect,
    describe,
    exchange,
    fit_each_alone,
    fit_further_effect,
    refine,
    sizes_beyond_noise,
    standard_errors,
)
from leactl.gap.search.parameters import (
    UNITS,
    calibrated_parameters,
    effect_parameters,
    nominal_value,
    with_calibration,
    with_effects,
)
from leactl.gap.search.regression import Candidate, Fit
from leactl.gap.search.ringing import highest_lines
from leactl.gap.signals.derived import moved_by_a_servo
from leactl.gap.signals.noise import coloured_noise, quantum_of
from leactl.gap.signals.record import WINDING, Clocked, Key, Record
from leactl.gap.signals.rig import voltage_feed
from leactl.gap.signals.smoothing import BASE_WIDTH, smooth
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
SOUND_MACHINES = 3  # number of simulated machines without an effect
LEAST_COMMON_STDS = 2.0  # standard errors of the mean over all machines above which they show a common size
TORQUE_CONSTANT = "torque_constant"
VOLTAGE = ("q_axis_voltage", "test")
MOST_STAMP_ERROR = 1.0  # samples, largest error of a stamp whose meaning the file does not give
SLOW_WIDTH = 8.0  # samples, smoothing of temperatures that drive a simulation


def measure(
    records: Sequence[Record],
    model: Model,
    machines: int = SOUND_MACHINES,
    only: Sequence[Candidate] | None = None,
    seed: int = 0,
) -> Null:
    """Return the null of a case: the values that fits to its runs, simulated with sound machines, give.

    A voltage or a torque sensor determines the torque constant. Where such a channel is too noisy, the constant and all
    torques are biased towards zero together: then the machines are simulated again with constants on either side of the
    model's, and fits hold the model's constant. Where no such channel is logged, `Evidence` holds the constant in all
    fits.

    machines : number of sound machines.
    only : forms of effects to fit; all if not given.
    """
    random = np.random.default_rng(seed)
    runs_of_machines = sound_runs(records, [model] * machines, random)
    torque_constant_change, held_parameters = unidentifiable_torque_constant(runs_of_machines, model)
    if held_parameters:
        runs_of_machines = sound_runs(records, machines_with_spread(model, TORQUE_CONSTANT, machines), random)
    null_values = NullValues()
    for runs in runs_of_machines:
        null_values.add_machine(Evidence(runs, model, only, held_parameters))
    return null_values.null(null_values.parameters() | torque_constant_change, held_parameters)


def unidentifiable_torque_constant(
    runs_of_machines: Sequence[Sequence[Record]], model: Model
) -> tuple[dict[str, tuple[float, float]], tuple[str, ...]]:
    """Return the torque constant's relative change (mean, scatter) and its name where the runs do not determine it.

    Both are empty otherwise. No effect is fitted: columns of effects take most of the time of a null, and a calibration
    needs none of them.
    """
    null_values = NullValues()
    for runs in runs_of_machines:
        evidence = Evidence(runs, model, only=())
        if evidence.tells_nothing_of(TORQUE_CONSTANT):  # no channel could determine it
            return {}, ()
        if evidence.stack.rows:
            null_values.add_calibration(evidence)
    if TORQUE_CONSTANT not in null_values.unidentifiable():
        return {}, ()
    return {TORQUE_CONSTANT: null_values.parameters()[TORQUE_CONSTANT]}, (TORQUE_CONSTANT,)


def with_simulator_runs(null: Null, records: Sequence[Record], model: Model) -> Null:
    """Return the null raised by the runs of the simulator whose nominal the model is.

    The larger residual variance of both counts. The ratio to the noise stays, since a simulator may write no noise.
    The size of each effect in the simulator's runs is combined with its floor in quadrature. Waves over the angle are
    excepted: they have one floor for all orders, and a simulator's wave of one order says nothing of another order.
    """
    null_values = NullValues()
    null_values.add_machine(Evidence(records, model, held_parameters=null.held_parameters))
    simulator_null = null_values.null(null.parameter_changes, null.held_parameters)
    residual_variances = {
        key: max(variance, simulator_null.residual_variances.get(key, 0.0))
        for key, variance in null.residual_variances.items()
    }
    floors = {
        effect: np.hypot(sizes, simulator_null.floors[effect]).tolist()
        if len(simulator_null.floors.get(effect, ())) == len(sizes) and not library()[effect].periodic
        else list(sizes)
        for effect, sizes in null.floors.items()
    }
    loud_equations = {
        key[0]
        for key, variance in simulator_null.residual_variances.items()
        if variance > null.residual_variances.get(key, math.inf)
    }
    line_heights = {
        channel: max(height, simulator_null.lines.get(channel, 0.0)) if channel[0] in loud_equations else height
        for channel, height in null.lines.items()
    }
    return replace(null, residual_variances=residual_variances, floors=floors, lines=line_heights)


def set_floors(evidence: Evidence, null: Null) -> None:
    """Set the floors of the evidence from the null.

    The floor of a form of a shaped effect is multiplied by the ratio of its standard errors in the case and in the runs
    of sound machines, if that is below one: their drive follows the reference where the real one is at a limit. So is
    the size that all machines have in common, of limits of the current alone: a limit that few of their samples would
    meet fits whatever these samples have in common. A floor stays whose error is infinite, since no run shows the form,
    or zero, since runs without noise show it exactly.
    """
    evidence.compare_with(null)
    for effect, fits in fit_each_alone(evidence).items():
        if not library()[effect].shaped or (sizes := null.floors.get(effect)) is None:
            continue
        shares = [
            min(case_error / sound_error, 1.0) if 0.0 < sound_error < math.inf else 1.0
            for case_error, sound_error in zip(standard_errors(effect, fits), null.errors[effect], strict=True)
        ]
        common_sizes: Sequence[float] = null.common_sizes.get(effect, ())
        if library()[effect].limits_current:
            common_sizes = list(map(mul, common_sizes, shares))
        evidence.by_form[effect] = evidence.floors_of(effect, list(map(mul, sizes, shares)), common_sizes)


@dataclass
class NullValues:
    """Values fitted to sound machines, collected machine by machine."""

    unrest: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    residual_variances: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    noise_variances: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    sizes: dict[str, list[list[float]]] = field(default_factory=dict)  # by effect: for each machine, by form
    errors: dict[str, list[list[float]]] = field(default_factory=dict)  # standard errors of the sizes
    fits: dict[str, list[list[FurtherEffect | None]]] = field(default_factory=dict)  # of effects that are not periodic
    lines: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)
    parameter_changes: dict[str, list[float]] = field(default_factory=dict)
    priors: dict[str, float] = field(default_factory=dict)

    def add_calibration(self, evidence: Evidence) -> Fit:
        """Add the relative changes of one machine's parameters in a fit without effects; return the fit."""
        fit = evidence.settle([])
        self.priors = evidence.priors
        for column, value in zip(fit.columns, fit.values, strict=True):
            name = evidence.stack.names[column]
            if name[0] == "calibration":
                self.parameter_changes.setdefault(name[1], []).append(float(value))
        return fit

    def add_machine(self, evidence: Evidence) -> None:
        """Add the values of one machine; its evidence is not stored, since the columns take much memory."""
        if not evidence.stack.rows:
            return
        fit = self.add_calibration(evidence)
        for key, value in evidence.unrest().items():
            self.unrest.setdefault(key, []).append(value)
        for key, value in evidence.residual_variances().items():
            self.residual_variances.setdefault(key, []).append(value)
        for key, value in evidence.noise_variances().items():
            self.noise_variances.setdefault(key, []).append(value)
        for effect, fits_of_forms in fit_each_alone(evidence).items():
            if not library()[effect].periodic:
                self.fits.setdefault(effect, []).append(fits_of_forms)
            if sizes := sizes_beyond_noise(effect, fits_of_forms):
                self.sizes.setdefault(effect, []).append(sizes)
                self.errors.setdefault(effect, []).append(standard_errors(effect, fits_of_forms))
        for channel, line in highest_lines(evidence, fit, [True] * len(evidence.stack.rows)).items():
            self.lines.setdefault(channel, []).append(line.height)

    def null(self, parameter_changes: Mapping[str, tuple[float, float]], held_parameters: Sequence[str]) -> Null:
        """Return the null of all machines together.

        parameter_changes : by parameter, mean and scatter of its relative change.
        held_parameters : parameters that every fit holds.
        """
        return Null(
            {key: float(np.mean(values)) for key, values in self.unrest.items()},
            {key: float(np.mean(values)) for key, values in self.residual_variances.items()},
            {key: float(np.mean(values)) for key, values in self.noise_variances.items()},
            {effect: np.sqrt(np.mean(np.square(sizes), axis=0)).tolist() for effect, sizes in self.sizes.items()},
            {effect: common_sizes(self.fits.get(effect, ())) for effect in self.sizes},
            {effect: np.mean(errors, axis=0).tolist() for effect, errors in self.errors.items()},
            {channel: float(np.mean(heights)) for channel, heights in self.lines.items()},
            parameter_changes,
            (*held_parameters, *self.unidentifiable()),
            tuple(held_parameters),
        )

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return the mean and scatter of each parameter's relative change in the fits."""
        return {
            name: (float(np.mean(values)), float(np.std(values))) for name, values in self.parameter_changes.items()
        }

    def unidentifiable(self) -> tuple[str, ...]:
        """Return the parameters whose relative change in sound machines exceeds `MOST_PRIOR_CHANGE` times their prior.

        A bias common to all machines counts in full for the torque constant, and as in `bias_error` for the others.
        A parameter that every fit holds is not among them.
        """
        return tuple(
            name
            for name, change in self.parameters().items()
            if self.priors.get(name) != PINNED_PRIOR
            and (math.hypot(*change) if name == TORQUE_CONSTANT else bias_error(*change))
            > MOST_PRIOR_CHANGE * self.priors.get(name, math.inf)
        )


def common_sizes(machines: Sequence[Sequence[FurtherEffect | None]]) -> list[float]:
    """Return the size of an effect that all sound machines have in common, by form; empty for fewer than two machines.

    machines : for each machine, the effect fitted alone in each of its forms; None where its runs do not show the form.

    It is the length of the mean of the signed sizes, less noise. It is zero where noise explains it, or where a machine
    does not show the form. A coarse encoder, whose accelerations are noise alone, makes every machine look as if a part
    of its inertia were loosely coupled.
    """

    def common_size(fits: Sequence[FurtherEffect | None]) -> float:
        """Return the common size in one form from the fits of all machines."""
        shown_fits = [item for item in fits if item is not None]
        if len(shown_fits) < len(fits):
            return 0.0
        mean = np.mean([item.directed for item in shown_fits], axis=0)
        noise_variance = float(np.mean([item.directed_variance for item in shown_fits])) / len(shown_fits)
        squared_mean = float(mean @ mean)
        return math.sqrt(squared_mean - noise_variance) if squared_mean > LEAST_COMMON_STDS**2 * noise_variance else 0.0

    return [common_size(fits) for fits in zip(*machines, strict=True)] if len(machines) > 1 else []


def without_imitated_members(evidence: Evidence, effect_set: EffectSet, seed: int = 0) -> EffectSet:
    """Return a set without the members that also show in a machine which has only the other members.

    The equations' error for a large effect (its course within a sample, where friction reverses) may look like a
    smaller effect. For each member a machine with the other members is fitted and simulated through the same runs, and
    the member is fitted there. Its size there is combined in quadrature with the member's floor and standard error. The
    member with the largest gain is not tested.
    """
    random = np.random.default_rng(seed)
    hypothesis = list(effect_set.hypothesis)
    for item in sorted(effect_set.members, key=lambda item: item.gain)[:-1]:
        others = [candidate for candidate in hypothesis if candidate != item.candidate]
        if item.size <= ENTRY_HEIGHT * math.hypot(item.std, item.floor, size_beside(evidence, others, item, random)):
            hypothesis = others
    if hypothesis == effect_set.hypothesis:
        return effect_set
    return describe(evidence, refine(evidence, exchange(evidence, hypothesis)))


def size_beside(
    evidence: Evidence, others: Sequence[Candidate], item: FurtherEffect, random: np.random.Generator
) -> float:
    """Return the size beyond noise of an effect fitted to a machine with only the others; zero if no run is left."""
    # calibrated with the whole set: without the effect a similar parameter, as the shaft's stiffness, would replace it
    calibration = calibrated_parameters(evidence, evidence.settle([*others, item.candidate]))
    fit = evidence.settle(others)
    effects_of_others = [
        (other[0], {p.name: p.value for p in effect_parameters(evidence, fit, other)}) for other in others
    ]
    machine = with_effects(with_calibration(evidence.model, calibration), effects_of_others)
    (simulated_runs,) = sound_runs(evidence.records, [machine], random)
    sound_evidence = Evidence(
        simulated_runs, evidence.model, only=[*others, item.candidate], held_parameters=evidence.held_parameters
    )
    if not sound_evidence.stack.rows:
        return 0.0
    sound_evidence.settle([*others, item.candidate])
    imitation = fit_further_effect(
        sound_evidence, sound_evidence.normal(), sound_evidence.stack.columns_of(others), item.candidate, any_size=True
    )
    return math.sqrt(max(imitation.size**2 - imitation.std**2, 0.0)) if imitation is not None else 0.0


def machines_with_spread(model: Model, parameter: str, count: int) -> list[Model]:
    """Return models whose parameter differs from the nominal one by its prior as a root mean square.

    The reciprocals are spread symmetrically around the nominal reciprocal, so that an error common to all machines
    comes from the fits. For an odd count above one, one model is the nominal one.
    """
    nominal = nominal_value(model, parameter)
    if nominal is None:
        return [model] * count
    offset = PRIORS[parameter] * math.sqrt(count / max(2 * (count // 2), 1))
    steps = [offset, -offset] * (count // 2) + ([0.0] if count > 1 else [offset]) * (count % 2)
    units = UNITS.get(parameter, "")
    return [
        with_calibration(model, [CalibratedParameter(parameter, nominal, nominal / (1.0 + step), 0.0, units)])
        for step in steps
    ]


def sound_runs(records: Sequence[Record], machines: Sequence[Model], random: np.random.Generator) -> list[list[Record]]:
    """Return the runs of a case simulated with each of some sound machines, without runs that cannot be simulated."""
    jobs_of_machines: list[list[Job]] = []
    for machine in machines:
        plant = plant_of(machine)
        plant.give = float(random.choice(TRIED_GIVES))  # a model file does not contain it
        jobs_of_machines.append([Job(with_smooth_inputs(record), plant, tracked=True) for record in records])
    replay_all([job for jobs in jobs_of_machines for job in jobs])
    for jobs in jobs_of_machines:
        delay_unknown_stamps(jobs, random)
    noise_shares = voltage_noise_shares(jobs_of_machines[0], records, machines[0], random)
    return [
        [
            simulated
            for job, record in zip(jobs, records, strict=True)
            if (simulated := simulated_record(job, record, random, noise_shares.get(record.run, 1.0)))
        ]
        for jobs in jobs_of_machines
    ]


def voltage_noise_shares(
    jobs: Sequence[Job], records: Sequence[Record], machine: Model, random: np.random.Generator
) -> dict[str, float]:
    """Return the share of a voltage's apparent noise that is noise, by run; empty where no run is driven by voltage.

    Such a voltage may be a reading or the command itself, and its spectrum does not tell noise from quick commands.
    Noise that the rotor does not feel would stand in the torque balance from row to row. What stands there in the
    measured run, in the simulated run with an exact voltage, and in that with all of the noise, gives the share.

    jobs : the simulated runs of one machine.
    """
    driven = [(job, record) for job, record in zip(jobs, records, strict=True) if is_driven_by_voltage(record)]
    if not driven:
        return {}
    measured = Evidence([record for _, record in driven], machine, only=()).noise_variances()
    simulated_of_shares = [
        [simulated for job, record in driven if (simulated := simulated_record(job, record, random, share)) is not None]
        for share in (0.0, 1.0)
    ]
    exact, noisy = (Evidence(runs, machine, only=()).noise_variances() for runs in simulated_of_shares)
    shares: dict[str, float] = {}
    for key in measured.keys() & exact.keys() & noisy.keys():
        if noisy[key] > exact[key]:
            noise_share = float(np.clip((measured[key] - exact[key]) / (noisy[key] - exact[key]), 0.0, 1.0))
            shares[key[1]] = max(math.sqrt(noise_share), shares.get(key[1], 0.0))
    return shares


def is_driven_by_voltage(record: Record) -> bool:
    """Return whether a run logs the voltage of its machine and no current."""
    fast = record.fast
    return fast is not None and VOLTAGE in fast.values and ("q_axis_current", "test") not in fast.values


def delay_unknown_stamps(jobs: Sequence[Job], random: np.random.Generator) -> None:
    """Delay the channels of a machine's runs at random where the files do not say what a stamp means."""
    current_delay, reference_delay, velocity_delay = random.uniform(-MOST_STAMP_ERROR, MOST_STAMP_ERROR, 3)
    ramped_reference = bool(random.integers(2))  # whether a reference ramps to its next value
    for job in jobs:
        unstamped = job.record.fast.unstamped if job.record.fast is not None else set()
        if job.current is not None and job.current_mean is not None and ("q_axis_current", "test") in unstamped:
            delay = float(current_delay + reference_delay) * job.parts
            job.current, job.current_mean = (
                delayed(
                    uniform_filter1d(values, job.parts, origin=(job.parts - 1) // 2) if ramped_reference else values,
                    delay,
                    1.0,
                )
                for values in (job.current, job.current_mean)
            )
        if job.current is None and job.angle is not None and ("q_axis_voltage", "test") in unstamped:
            # only the delay between a voltage and the motion that it makes can be observed
            job.angle = delayed(job.angle, -float(current_delay + reference_delay) * job.parts, 1.0)
        if job.velocity is not None and ("velocity", "test") in job.fast and ("velocity", "test") in unstamped:
            job.velocity = delayed(job.velocity, float(velocity_delay) * job.parts, 1.0)
            job.fast["velocity", "test"] = replayed_velocity(job)


def with_smooth_inputs(record: Record) -> Record:
    """Return a run with smoothed inputs: rotors would creep under input noise, and the noise would count twice."""
    fast, slow = record.fast, record.slow
    if fast is not None:
        driving_quantity = "q_axis_current" if ("q_axis_current", "test") in fast.values else "q_axis_voltage"
        fast = replace(fast, values=with_smooth_channels(fast.values, driving_quantity, BASE_WIDTH))
    if slow is not None:
        fed = smooth(slow.fed, SLOW_WIDTH) if slow.fed is not None else None
        slow = replace(slow, values=with_smooth_channels(slow.values, "_temperature", SLOW_WIDTH), fed=fed)
    return replace(record, fast=fast, slow=slow)


def with_smooth_channels(values: Mapping[Key, Array], ending: str, width: float) -> dict[Key, Array]:
    """Return channels, smoothed where the quantity ends with `ending`.

    width : samples, Gaussian width of the smoothing.
    """
    return {key: smooth(column, width) if key[0].endswith(ending) else column for key, column in values.items()}


def simulated_record(
    job: Job, record: Record, random: np.random.Generator, voltage_noise_share: float
) -> Record | None:
    """Return a simulated run with channels, noise and rounding of the measured one; None if nothing was simulated.

    voltage_noise_share : of the noise that the voltage of a voltage-driven machine seems to have.
    """
    if not job.fast and not job.slow:
        return None
    fast, slow = record.fast, record.slow
    if fast is not None:
        simulated_channels = fast_channels(job)
        values = channels_as_measured(fast, simulated_channels, random)
        if is_driven_by_voltage(record) and VOLTAGE in simulated_channels:
            # not rounded: the levels of a command are no steps of a converter
            noise = coloured_noise(fast.values[VOLTAGE], 0.0, random)
            exact = np.where(np.isfinite(simulated_channels[VOLTAGE]), simulated_channels[VOLTAGE], values[VOLTAGE])
            values[VOLTAGE] = exact + voltage_noise_share * noise
        fast = replace(fast, values=values)
    if slow is not None:
        fed = slow.fed
        if fed is not None and WINDING in job.slow and job.record.slow is not None and job.record.slow.fed is not None:
            simulated = job.record.slow.fed + job.slow[WINDING] - job.record.slow.values[WINDING]
            fed = with_noise(simulated, fed, random)
        slow = replace(slow, values=channels_as_measured(slow, job.slow, random), fed=fed)
    return replace(record, fast=fast, slow=slow, notes=[])


def fast_channels(job: Job) -> dict[Key, Array]:
    """Return the simulated channels of the fast clock, without noise."""
    channels, values = dict(job.fast), job.clock.values
    if job.angle is not None:
        channels["angle", "test"] = replayed_angle(job)
    if (current_reading := replayed_current(job)) is not None:
        channels["q_axis_current", "test"] = current_reading
    if (load_current := values.get(("q_axis_current", "load"))) is not None:
        channels["q_axis_current", "load"] = load_current  # the replay takes it as measured
    if job.pull is not None:
        for key, change in tracking_references(job, job.pull).items():
            if key in values:
                channels[key] = values[key] + change
    return channels


def tracking_references(job: Job, pull: Array) -> dict[Key, Array]:
    """Return by key what is added to the measured references so that the drive makes the tracking torque.

    pull : tracking torque [N*m] at the instants of the sub-steps.
    """
    torque_constant = job.plant.model.torque_constant or 1.0
    instant_count = (len(job.clock.time) - 1) * job.parts + 1
    if (feed := voltage_feed(job.record, job.plant.model)) is not None:
        pull_at_samples = means_over_samples(0.5 * (pull[1:instant_count] + pull[: instant_count - 1]), job.parts)
        return {("q_axis_voltage", "test"): pull_at_samples / feed.gain}
    if job.current is None:
        quantity = "torque_reference" if ("torque_reference", "test") in job.clock.values else "torque"
        return {
            (quantity, "test"): means_over_samples(0.5 * (pull[1:instant_count] + pull[: instant_count - 1]), job.parts)
        }
    reference_change = reference_before_lead(
        reference_reaching(pull[: instant_count : job.parts] / torque_constant, job), job
    )
    return {("q_axis_current_reference", "test"): reference_change}


def reference_reaching(currents_at_ends: Array, job: Job) -> Array:
    """Return the reference [A] with which a first-order current loop reaches given currents at the intervals' ends."""
    bandwidth = job.plant.model.bench.current_loop_bandwidth
    decay = float(np.exp(-2.0 * np.pi * bandwidth * job.clock.interval)) if bandwidth else 0.0
    return (currents_at_ends - decay * np.concatenate([currents_at_ends[:1], currents_at_ends[:-1]])) / (1.0 - decay)


def reference_before_lead(followed: Array, job: Job) -> Array:
    """Return the reference [A] that, after the drive's setpoint lead, equals the given one."""
    bench, interval = job.plant.model.bench, job.clock.interval
    if not bench.setpoint_lead or moved_by_a_servo(job.clock):
        return followed
    decay = float(np.exp(-interval / bench.setpoint_lead_time))
    lead_share = bench.setpoint_lead * (bench.setpoint_lead_time / interval) * (1.0 - decay)
    memory, input_gain = decay + (1.0 - decay) * lead_share / (1.0 + lead_share), (1.0 - decay) / (1.0 + lead_share)
    lead_state = lfilter([0.0, input_gain], [1.0, -memory], followed - followed[0]) + followed[0]
    return np.asarray((followed + lead_share * lead_state) / (1.0 + lead_share), np.float64)


def channels_as_measured(
    clock: Clocked, simulated: Mapping[Key, Array], random: np.random.Generator
) -> dict[Key, Array]:
    """Return the channels of a clock: simulated ones with the noise of the measured ones, the others unchanged."""
    references = {key for key in simulated if key[0].endswith("_reference")}
    return {
        key: values
        if key not in simulated
        else np.where(np.isfinite(simulated[key]), simulated[key], values)
        if key in references
        else channel_as_measured(clock, key, simulated[key], random)
        for key, values in clock.values.items()
    }


def channel_as_measured(clock: Clocked, key: Key, simulated: Array, random: np.random.Generator) -> Array:
    """Return a simulated channel with noise and rounding, added at the channel's own stamps if it has its own."""
    values = clock.values[key]
    if key not in clock.between:
        return with_noise(simulated, values, random)
    stamps, measured = clock.between[key]
    filled = np.where(np.isfinite(simulated), simulated, values)
    return np.interp(clock.time, stamps, with_noise(np.interp(stamps, clock.time, filled), measured, random))


def with_noise(simulated: Array, measured: Array, random: np.random.Generator) -> Array:
    """Return a simulated channel with noise of the measured one's size and colour, rounded to the same quantum."""
    filled = np.where(np.isfinite(simulated), simulated, measured)
    quantum = quantum_of(measured) or quantum_of(np.diff(measured))  # a swift channel may take every level only once
    noisy = filled + coloured_noise(measured, quantum, random)
    return np.asarray(np.round(noisy / quantum) * quantum if quantum > 0.0 else noisy, np.float64)
