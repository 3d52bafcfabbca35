"""A pendulum on a servo in MuJoCo, by patched file and callbacks, against `leactl gap simulate`: the same motion."""

import importlib.util

import numpy as np
import pytest
import yaml

from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Run
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.cli.terminal import leactl
from tests.exchange.robots import leg

mujoco = pytest.importorskip("mujoco", reason="what is written is simulated by leactl[mujoco]")

INTERVAL_S, TIMESTEP_S, SECONDS = 0.005, 1e-4, 4.0
CHANNELS = [
    ChannelSpec("position", "angle", "test", "servo", dtype="f8"),
    ChannelSpec("goal", "angle_reference", "test", "servo", dtype="f8"),
]
STRIBECK = ("stribeck", {"breakaway_ratio": 0.7, "stribeck_velocity": 0.4, "shape": 2.0})
DELAY = ("transport_delay", {"delay": 0.01})
COGGING = ("cogging", {"amplitude": 0.8, "order": 4.0, "phase": 0.4})
WEAK = ("saturation", {"loss": 0.2, "current": 4.4})
CASES = {  # effects, and the part of the gap that they make by which the two motions may differ
    "three": ((STRIBECK, DELAY, COGGING), 0.01),
    "profile": ((("reference_rate_limit", {"speed": 2.0, "acceleration": 12.0}),), 0.01),
    "pace": ((("reference_rate_limit", {"speed": 2.0}),), 0.01),
    "band": ((("servo_dead_band", {"band": 0.05}),), 0.05),
    "inverter": ((("dead_time", {"voltage": 3.0, "current": 0.3}), WEAK), 0.02),
    "load": ((("load_dependent_friction", {"coefficient": 0.2}),), 0.05),
    "bristles": ((("presliding", {"displacement": 0.1}),), 0.05),
}


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A robot, its nominal model, a run of which the goals count, and that run by the nominal model."""
    folder = tmp_path_factory.mktemp("round-trip")
    leg(folder, timestep=TIMESTEP_S)
    words = ("model", "import", folder / "robot.xml", "--joint", "knee", "--supply", "24")
    assert leactl(*words, "--out", folder / "nominal.yaml").returncode == 0
    time = INTERVAL_S * np.arange(round(SECONDS / INTERVAL_S))
    goal = 0.5 * np.sin(2.1 * time) + 0.4 * (np.sin(5.3 * time + 1.0) - np.sin(1.0))
    goal += 0.3 * np.sign(np.sin(1.7 * time)) * (time > 1.0)
    named = dict.fromkeys(("protocol", "bench", "actuator", "condition", "operator", "software"), "goals")
    info = RunInfo(
        run_id="20261121T100000Z-goals-0001",
        created="2026-11-21T10:00:00Z",
        simulated=False,
        mechanical="free",
        sources={},
        setup={},
        **named,
    )
    writer = RunWriter(folder, info, {"loop": CHANNELS})
    writer.append("loop", time, np.stack([np.zeros_like(time), goal], axis=1))
    writer.close("complete")
    writer.path.rename(folder / "goals.h5")
    return folder, by_leactl(folder, folder / "nominal.yaml")


def by_leactl(folder, model):
    out = folder / f"{model.stem}.h5"
    done = leactl("gap", "simulate", model, folder / "goals.h5", "--out", out)
    assert done.returncode == 0, done.stderr
    with Run.open(out) as run:
        return run.channel("angle").values


def by_mujoco(folder, robot, callbacks=None):
    """Angle at every sample of the goals, `ctrl` being held from one to the next."""
    with Run.open(folder / "goals.h5") as run:
        goals = run.channel("angle_reference").values
    model = mujoco.MjModel.from_xml_path(str(robot))
    state, angles, effects = mujoco.MjData(model), [], None
    if callbacks is not None:
        spec = importlib.util.spec_from_file_location("callbacks", callbacks)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        effects = module.install(model)
    for goal in goals:
        angles.append(float(state.qpos[0]))
        state.ctrl[0] = goal
        mujoco.mj_step(model, state, nstep=round(INTERVAL_S / TIMESTEP_S))
    if effects is not None:
        effects.remove()
    return np.array(angles)


def rms(values):
    return float(np.sqrt(np.nanmean(values**2)))


@pytest.mark.parametrize("case", CASES)
def test_mujoco_with_the_export_moves_as_the_augmented_model_does(workshop, case):
    (effects, most), (folder, nominal) = CASES[case], workshop
    document = yaml.safe_load((folder / "nominal.yaml").read_text())
    document["effects"] = [{"effect": name, "parameters": values} for name, values in effects]
    model, robot, callbacks = (folder / f"{case}{end}" for end in (".yaml", ".xml", ".py"))
    model.write_text(yaml.safe_dump(document))
    words = ("model", "export", model, "--to", "mjcf", "--into", folder / "robot.xml", "--out", robot)
    done = leactl(*words, "--callbacks", callbacks)
    assert done.returncode == 0, done.stderr
    augmented = by_leactl(folder, model)
    gap = rms(augmented - nominal)
    assert gap > 0.005
    assert rms(by_mujoco(folder, robot, callbacks) - augmented) < most * gap
