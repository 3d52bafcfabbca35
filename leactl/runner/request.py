"""Requests to run, resolved from command-line arguments and checked before a device is touched."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from leactl.bench import benchfile
from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.bench.wire_trace import WireTrace
from leactl.errors import InputError
from leactl.protocol import by_hand, protocolfile
from leactl.protocol.plan import Plan
from leactl.runner import latch
from leactl.runner.acceptance import check_analysis
from leactl.runner.checked_bench import load_checked
from leactl.runner.event_lines import EventLines
from leactl.runner.latch import Latch
from leactl.runner.thermal_admission import check_label
from leactl.safety.plan_checks import check_rate
from leactl.yamlfile import Document

MOST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Request:
    """One run to be made: its plan, bench, output directory and options, all of them checked."""

    plan: Plan
    bench: BenchFile
    devices: Sequence[CheckedDevice]
    bench_document: Document
    directory: Path
    actuator: str = ""
    operator: str = ""
    seed: int | None = None
    realtime: bool = False
    served: bool = False  # the bench is emulated by another process, on real buses
    cold: bool = False  # a person says that nothing has heated the actuators
    insert_cooldown: bool = False  # wait where a winding would otherwise pass its limit
    record_every_s: float = 0.0  # at most one row of a stream is recorded in this time; 0 records every row
    run_id: str = ""  # if it has to be known before the run; empty: the run makes one
    part_of: Mapping[str, str] = field(default_factory=dict)  # name of its campaign, key of the run there, and more
    lines: EventLines | None = None  # receives what happens in the run while it goes on
    trace: WireTrace | None = None  # receives every byte on its wires

    @property
    def in_process(self) -> bool:
        """Whether the bench is emulated in this process."""
        return self.bench.emulated is not None and not self.served

    @property
    def keeps_wall_time(self) -> bool:
        """Whether the run takes as long as it says: not on a bench emulated in this process, unless asked for."""
        return self.realtime or not self.in_process

    @property
    def latch(self) -> Latch:
        """The trip latch of the bench."""
        return latch.of(self.bench, self.bench_document.name, self.in_process)

    @property
    def noise_seed(self) -> int | None:
        """Seed of the noise of a bench that is emulated in this process; None for another bench."""
        if not self.in_process or self.bench.emulated is None:
            return None
        return self.bench.emulated.seed if self.seed is None else self.seed


def prepare(
    protocol: str,
    bench: str,
    settings: Sequence[str],
    actuator: str,
    condition: str,
    operator: str,
    directory: Path,
    realtime: bool,
    served: bool = False,
    buses: Sequence[str] = (),
) -> Request:
    """Resolve and check a protocol and a bench, each by its name or path, with the options of their run.

    Parameters
    ----------
    settings : `name=value` for a parameter of the protocol, or `seed=value` for the seed of the request.
    served : whether another process emulates the bench, on real buses.
    buses : changes of buses, as `changed_buses` takes them.

    Raises
    ------
    InputError : a name, a file or a setting that cannot be used; one line for each fault.
    """
    for option, label in (("--actuator", actuator), ("--condition", condition), ("--operator", operator)):
        check_label(option, label)
    overrides = _settings(settings)
    seed = _seed(overrides.pop("seed", None))
    loaded = _loaded_bench(bench, buses, served)
    plan = protocolfile.load(protocol, overrides, condition)
    check_analysis(plan, str(protocolfile.locate(protocol)))
    request = _request(plan, loaded, directory, realtime, served)
    return replace(request, actuator=actuator, operator=operator, seed=seed)


def prepare_by_hand(
    name: str,
    steps: Sequence[str],
    bench: str,
    setup: str,
    directory: Path,
    realtime: bool,
    served: bool = False,
    buses: Sequence[str] = (),
    everything: bool = False,
) -> Request:
    """Resolve and check a plan of protocol steps in YAML, without a protocol file.

    Parameters
    ----------
    setup : set-up of the plan; empty: that of the bench file, or `coupled` if it has none.
    served, buses : as for `prepare`.
    everything : whether devices that are `on_demand` are opened too.

    Raises
    ------
    InputError : as `prepare`.
    """
    loaded = _loaded_bench(bench, buses, served)
    plan = by_hand.plan_of(name, setup or loaded[0].setup or "coupled", steps)
    return _request(plan, loaded, directory, realtime, served, everything)


LoadedBench = tuple[BenchFile, list[CheckedDevice], Document]


def _loaded_bench(bench: str, buses: Sequence[str], served: bool) -> LoadedBench:
    """Return a checked bench with changed buses, all its devices and its document."""
    file, devices, document = load_checked(bench)
    if buses and file.emulated is not None and not served:
        raise InputError(
            f"--bus {buses[0]}: bench '{file.name}' has its buses in this process;"
            " --served meets one that another process serves"
        )
    return file.model_copy(update={"buses": file.buses | benchfile.changed_buses(file, buses)}), devices, document


def _request(
    plan: Plan, loaded: LoadedBench, directory: Path, realtime: bool, served: bool, everything: bool = False
) -> Request:
    """Check the rate of a plan with the devices of its run, and return the request."""
    file, all_devices, document = loaded
    devices = all_devices if everything else benchfile.devices_of_run(all_devices, {*plan.needs, *plan.wants})
    check_rate(plan.rate_Hz, benchfile.host_silences(devices), benchfile.supplies_of(devices))
    return Request(
        plan=plan,
        bench=file,
        devices=devices,
        bench_document=document,
        directory=directory,
        realtime=realtime,
        served=served,
    )


def _settings(words: Sequence[str]) -> dict[str, str]:
    """Return values by name from words `name=value`."""
    overrides: dict[str, str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals):
            raise InputError(f"--set {word}: name=value was expected")
        if name in overrides:
            raise InputError(f"--set {name}: given twice")
        overrides[name] = value
    return overrides


def _seed(text: str | None) -> int | None:
    """Return the value of `--set seed=...` as a number; None if it is not given."""
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) <= MOST_SEED):
        raise InputError(f"--set seed={text}: a whole number from 0 to {MOST_SEED} was expected")
    return int(text)
