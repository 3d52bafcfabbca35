"""Trials that run whole: the session, its file, and the emulated bench behind real protocols on the wire."""

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml

from leactl.bench import benchfile
from leactl.emulation.bench.emulated_bench import observed
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner import thermal_admission
from leactl.runner.drill.power_watch import DrivePowerWatch
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute
from leactl.runner.thermal_admission import motors_of
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.foresight import Foresight
from tests.monte_carlo.plants import LEA, ROLES, Truth, drawn
from tests.monte_carlo.protocols import Protocol
from tests.monte_carlo.supervised import AFTER_S, SCALED, MakeGuard, run_free, shipped

LONGEST_S = 45.0
LESS = 0.8  # of its current, where a protocol is refused: a refused one would show nothing of the wire
FAULTS: dict[str, list[dict[str, Any]]] = {
    "lost_frames": [{"bus": "can0", "direction": way} for way in ("both", "to_devices", "to_host")],
    "late_frames": [{"bus": "can0", "direction": way} for way in ("both", "to_devices", "to_host")],
    "bus_off": [{"bus": "can0"}],
    "stuck_sensor": [
        {"device": f"drive_{role}", "quantity": quantity}
        for role in ROLES
        for quantity in ("q_axis_current", "velocity", "angle")
    ],
    "disconnected_sensor": [{"device": f"drive_{role}", "quantity": "q_axis_current"} for role in ROLES],
    "noisy_sensor": [{"device": f"drive_{role}", "quantity": "q_axis_current", "unit": "A"} for role in ROLES],
    "frozen_drive": [{"device": f"drive_{role}"} for role in ROLES],
    "drive_fault": [{"device": f"drive_{role}", "code": 0x7121} for role in ROLES],
    "heartbeat_loss": [{"device": f"drive_{role}"} for role in ROLES],
    "under_voltage": [{"bus_voltage_V": 12.0}],
    "clock_jump": [{}],
}
MOMENTS = ("frozen_drive", "drive_fault", "heartbeat_loss", "clock_jump")  # that have no end of their own


def trial(draw: np.random.Generator, number: int, guard_of: MakeGuard) -> dict[str, Any]:
    """One protocol as `leactl run` runs it, in a directory of its own."""
    protocol = Protocol(draw, LONGEST_S)
    text, times = _accepted(protocol)
    truth = drawn(draw, "", protocol.duration)
    fault = _fault(draw, protocol.duration) if draw.random() < 0.5 else None
    with _own_place() as place, patch.object(thermal_admission, "ThermalGuard", guard_of):
        (place / "trial.yaml").write_text(text)
        (place / "bench.yaml").write_text(yaml.safe_dump(_bench(truth, fault)))
        request = prepare(
            str(place / "trial.yaml"), str(place / "bench.yaml"), [f"seed={number}"], "", "", "", place, realtime=False
        )
        plant = DrivePowerWatch()
        with observed(plant.see):
            outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
        time = plant.bench.time
        time.sleep_until(time.now() + AFTER_S)
        energised = [role for role in ROLES if plant.powered(role)]
        peak = max(plant.bench.rig.hottest_phase(role).highest for role in ROLES)
        faults = [*verify(outcome.path), *_unreadable(outcome.path)]
    scaled = any(SCALED in note for note in outcome.notes)
    undisturbed = peak
    if fault is None and (scaled or outcome.status != "complete"):
        from tests.monte_carlo.truth import History, hottest

        undisturbed = hottest([History(truth, [run_free(request.plan, truth, number)])])[0][1]
    return {
        "number": number,
        "kind": "wire",
        "outside": "",
        "setup": request.plan.setup,
        "rate_Hz": request.plan.rate_Hz,
        "duration_s": round(request.plan.duration_s, 2),
        "most_A": round(protocol.current, 3),
        "lowered": times,
        "corner": truth.corner,
        "start": "cold",
        "fault": fault["fault"] if fault else "",
        "fault_told": fault,
        "forecast": "accepted",
        "status": outcome.status,
        "reason": outcome.reason,
        "scaled": scaled,
        "energised": energised,
        "peak_degC": round(peak, 3),
        "undisturbed_degC": round(undisturbed, 3),
        "file_faults": faults,
    }


def _accepted(protocol: Protocol) -> tuple[str, int]:
    """The protocol with as much current as the forecast lets through, and how often it was lowered."""
    from tests.protocol.writing import read

    file, settings = shipped()
    start = {role: np.full(3, settings.ambient + Box.of(LEA).ambient_rise) for role in ROLES}
    foresight, times = Foresight(motors_of(file), settings, start), 0
    text = protocol.text()
    while foresight.forecast(read(text)).passing is not None:
        text, times = protocol.text(LESS), times + 1
    return text, times


def _fault(draw: np.random.Generator, duration_s: float) -> dict[str, Any]:
    kind = str(draw.choice(list(FAULTS)))
    entry = {"fault": kind, "at_s": round(float(draw.uniform(0.0, duration_s)), 4)}
    entry |= FAULTS[kind][draw.integers(len(FAULTS[kind]))]
    if kind not in MOMENTS and draw.random() < 0.5:
        entry["for_s"] = round(float(np.exp(draw.uniform(np.log(0.02), np.log(5.0)))), 4)
    if kind in ("lost_frames", "late_frames"):
        entry["share"] = round(float(draw.uniform(0.05, 1.0)), 3)
    if kind == "late_frames":
        entry["delay_s"] = round(float(draw.uniform(0.005, 0.2)), 4)
    if kind == "noisy_sensor":
        entry["spread"] = round(float(draw.uniform(0.5, 3.0)), 3)
    if kind == "clock_jump":
        entry["jump_s"] = round(float(draw.choice([-1.0, 1.0]) * np.exp(draw.uniform(np.log(0.02), np.log(600.0)))), 4)
    return entry


def _bench(truth: Truth, fault: Mapping[str, Any] | None) -> dict[str, Any]:
    """The shipped bench with this plant behind it."""
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    bench["name"] = "trial"
    emulated = bench["emulated"]
    emulated.pop("conditions")
    for role in ROLES:
        emulated[role] = _plain(asdict(truth.actuators[role]))
    emulated["bench"] = {"phase_resolved": True, "friction_heat": True, "ambient_temperature": truth.ambient}
    emulated["effects"] = [
        {"name": "current_sensor_gain", "gain": 1.0 / truth.factors[role], "role": role} for role in ROLES
    ]
    if fault is not None:
        emulated["faults"] = [dict(fault)]
    return bench


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _plain(value) if isinstance(value, dict) else value for name, value in values.items()}


def _unreadable(path: Path) -> list[str]:
    try:
        with Run.open(path) as run:
            run.channel("q_axis_current", role="test")
    except Exception as error:
        return [f"{type(error).__name__}: {error}"]
    return []


@contextmanager
def _own_place() -> Iterator[Path]:
    """A directory with latches and states of its own, gone afterwards."""
    before, place = os.environ.get("LEACTL_STATE"), Path(tempfile.mkdtemp(prefix="leactl-trial-"))
    os.environ["LEACTL_STATE"] = str(place / "state")
    try:
        yield place
    finally:
        shutil.rmtree(place)
        if before is None:
            del os.environ["LEACTL_STATE"]
        else:
            os.environ["LEACTL_STATE"] = before
