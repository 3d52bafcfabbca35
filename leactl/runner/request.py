"""From the words of a command line to a checked request: every fault is found before a device is touched."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from leactl.bench import benchfile
from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.errors import InputError
from leactl.protocol import by_hand, protocolfile
from leactl.protocol.plan import Plan
from leactl.runner.acceptance import check_analysis
from leactl.runner.checked_bench import load_checked
from leactl.runner.session import Request
from leactl.runner.thermal_admission import check_label
from leactl.safety.refusals import check_rate
from leactl.yamlfile import Document

MOST_SEED = 2**63 - 1


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
    """Resolve and check what is to be run.

    Raises
    ------
    InputError : a name, a file or a setting that cannot be used; one line a fault.
    """
    for option, label in (("--actuator", actuator), ("--condition", condition), ("--operator", operator)):
        check_label(option, label)
    overrides = _settings(settings)
    seed = _seed(overrides.pop("seed", None))
    placed = _placed(bench, buses, served)
    plan = protocolfile.load(protocol, overrides, condition)
    check_analysis(plan, str(protocolfile.locate(protocol)))
    made = _request(plan, placed, directory, realtime, served)
    return replace(made, actuator=actuator, operator=operator, seed=seed)


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
    """Resolve and check steps that are given by hand, for the bench's own set-up, or `coupled`, where none is named.

    `everything` opens devices that are `on_demand` too.

    Raises
    ------
    InputError : as `prepare`.
    """
    placed = _placed(bench, buses, served)
    plan = by_hand.plan_of(name, setup or placed[0].setup or "coupled", steps)
    return _request(plan, placed, directory, realtime, served, everything)


Placed = tuple[BenchFile, list[CheckedDevice], Document]


def _placed(bench: str, buses: Sequence[str], served: bool) -> Placed:
    file, devices, document = load_checked(bench)
    if buses and file.emulated is not None and not served:
        raise InputError(
            f"--bus {buses[0]}: bench '{file.name}' has its buses in this process;"
            " --served meets one that another process serves"
        )
    return file.model_copy(update={"buses": file.buses | benchfile.changed_buses(file, buses)}), devices, document


def _request(
    plan: Plan, placed: Placed, directory: Path, realtime: bool, served: bool, everything: bool = False
) -> Request:
    file, every, document = placed
    devices = every if everything else benchfile.devices_of_run(every, {*plan.needs, *plan.wants})
    check_rate(plan.rate_Hz, benchfile.host_silences(devices))
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
    if text is None:
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) <= MOST_SEED):
        raise InputError(f"--set seed={text}: a whole number from 0 to {MOST_SEED} was expected")
    return int(text)
