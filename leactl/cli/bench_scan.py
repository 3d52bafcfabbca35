"""`leactl bench scan`: list the devices that answer on the wires of this machine, by reads alone."""

import json
import sys
from functools import partial

import typer

from leactl.cli import print_answer

AS_JSON = typer.Option(False, "--json", help="Print JSON on stdout.")


def scan(
    can: list[str] = typer.Option(
        [], "--can", metavar="CHANNEL", help="A CAN bus, as can0 or slcan:/dev/ttyACM0; repeatable."
    ),
    i2c: list[int] = typer.Option([], "--i2c", min=0, max=255, help="An I2C bus by its number; repeatable."),
    serial: list[str] = typer.Option([], "--serial", metavar="PORT", help="A serial port; repeatable."),
    lan: list[str] = typer.Option(
        [], "--lan", metavar="ADDRESS[:PORT]", help="An instrument on the network, IPv4; repeatable."
    ),
    bitrate: int = typer.Option(
        1_000_000, min=10_000, max=1_000_000, help="Bit rate of a CAN adapter that is not set up by the system."
    ),
    as_yaml: bool = typer.Option(False, "--yaml", help="Print the buses and devices of a bench file."),
    as_json: bool = AS_JSON,
) -> None:
    """Ask who is on CAN, I2C, serial and LAN, by reads alone: nothing moves and no setting changes.

    Without an option, every CAN interface, I2C bus and serial port of this machine is asked; LAN where it is named.
    What is asked is what each driver's probe reads. A CAN bus on which another host is at work is only listened to.
    The status is 0 as well where nothing answers.
    """
    from leactl.bench.scan import Watcher, WireReport
    from leactl.errors import DeviceError, InputError, Stopped
    from leactl.report import scan as scan_report
    from leactl.runner.scan import ScannedWire, named_wires, scan, wires_of_this_machine
    from leactl.runner.stop_requests import handled_signals

    if as_json and as_yaml:
        raise InputError("--json and --yaml are both given; one was expected")
    wires_are_named = can or i2c or serial or lan
    wires = named_wires(can, i2c, serial, lan, bitrate) if wires_are_named else wires_of_this_machine()
    scan_results: list[tuple[ScannedWire, WireReport]] = []
    end_error: DeviceError | Stopped | None = None
    with handled_signals() as stop:
        try:
            for wire in wires:
                scan_results.append((wire, WireReport(wire.shown)))
                scan(wire, scan_results[-1][1], Watcher(partial(_show, wire.shown), stop.check))
        except Stopped as error:
            end_error = error
    lines = list(scan_report.lines(scan_results))
    if not wires:
        lines = ["this machine has no CAN interface, I2C bus or serial port; see: leactl doctor"]
    if as_yaml:
        print("\n".join(lines), file=sys.stderr)
    answer = scan_report.bench_file_part(scan_results) if as_yaml else "\n".join(lines)
    if as_json:
        answer = json.dumps(scan_report.as_json(scan_results))
    stdout_error = print_answer(answer.rstrip("\n")) if answer else None
    faults = [report.fault for _wire, report in scan_results if report.fault]
    end_error = end_error or (DeviceError(faults.pop()) if faults else None)
    if end_error is not None:
        for fault in faults:
            end_error.add_note(fault)
        raise end_error
    if stdout_error is not None:
        raise stdout_error


def _show(wire: str, text: str) -> None:
    """Print on stderr what is asked on a wire."""
    print(f"{wire}: {text} ...", file=sys.stderr, flush=True)
