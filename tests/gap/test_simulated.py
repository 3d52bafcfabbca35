"""Runs of a simulator as the nominal: a joint stepped here by numpy alone, beside one with an effect more.

The simulator shares no code with leactl: a current loop and a rotor with friction, stepped by Euler.
"""

import json
import shutil
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import leactl as leactl_of_python
from leactl.quantities import ChannelSpec
from leactl.runfile.write.run_info import RunInfo
from leactl.runfile.write.writer import RunWriter
from tests.cli.answers import fits_the_page
from tests.cli.terminal import leactl

RATE, PARTS, SECONDS = 400.0, 8, 6.0
KINDS = ("multisine", "levels", "ramp")
TOP, LOOP, COUNT = 4.0, 90.0, 2.0 * np.pi / 65536
STEPS = np.array([0.8, -0.5, 1.0, 0.35, -0.9, -0.6, 0.7, -1.0])
MODEL = """\
name: joint
torque_constant: 0.5
back_emf_constant: 0.5
rotor_inertia: 0.008
viscous_damping: 0.05
coulomb_friction: 0.15
bench: {current_loop_bandwidth: 90, velocity_filter_bandwidth: 80}
"""


@dataclass(frozen=True)
class Machine:
    """What is stepped; parameters a little off the model file's."""

    constant: float = 0.48
    inertia: float = 0.0072
    damping: float = 0.058
    friction: float = 0.165
    cogging: float = 0.0  # N*m, 7 times a turn
    drag: float = 0.0  # N*m s^2/rad^2
    breakaway: float = 0.0  # of the friction, that fades over 1 rad/s

    def steps(self, asked):
        """Current [A], speed, filtered speed [rad/s] and angle [rad] at the end of every step."""
        step, out = 1.0 / RATE / PARTS, np.empty((4, len(asked) * PARTS))
        follows, filters = -np.expm1(-2.0 * np.pi * np.array([LOOP, 80.0]) * step)
        flowing = speed = reading = angle = 0.0
        for index in range(out.shape[1]):
            flowing += follows * (asked[index // PARTS] - flowing)
            torque = self.constant * flowing - self.damping * speed - self.drag * speed * abs(speed)
            torque += self.cogging * np.cos(7.0 * angle + 0.4)
            ahead = speed + torque * step / self.inertia
            held = self.friction * (1.0 + self.breakaway * np.exp(-abs(speed))) * step / self.inertia
            speed = ahead - min(max(ahead, -held), held)
            angle += speed * step
            reading += filters * (speed - reading)
            out[:, index] = flowing, speed, reading, angle
        return out


def reference(kind, again):
    """Current reference [A] that turns the joint both ways; a repeat has other phases and another order."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    if kind == "multisine":
        phases = np.random.default_rng(again).random(6)
        waves = zip((0.3, 0.7, 1.3, 2.1, 3.7, 6.1), phases, strict=True)
        return TOP / 3.0 * sum(np.sin(2.0 * np.pi * (f * time + phase)) for f, phase in waves)
    if kind == "ramp":
        return TOP * np.sin(2.0 * np.pi * time / SECONDS) * (-1.0) ** again
    return TOP * np.roll(STEPS, 3 * again)[(time / SECONDS * len(STEPS)).astype(int)]


def written(folder, steps, noise=1.0, seed=0, **names):
    """Six runs, two of each kind, of what `steps` makes of a reference; `noise` times what a drive's readings have."""
    random = np.random.default_rng(seed)
    ends = PARTS * np.arange(1, round(SECONDS * RATE) + 1) - 1
    for kind in KINDS:
        for again in (0, 1):
            asked = reference(kind, again)
            current, _, reading, angle = steps(asked)
            means = current.reshape(-1, PARTS).mean(axis=1)
            columns = {
                "q_axis_current_reference": asked,
                "q_axis_current": means + noise * 0.008 * random.standard_normal(len(ends)),
                "velocity": reading[ends] + noise * 0.05 * random.standard_normal(len(ends)),
                "angle": np.round(angle[ends] / COUNT) * COUNT if noise else angle[ends],
            }
            write(folder, f"{kind}-{'ab'[again]}", kind, columns, **names)
    return sorted(folder.glob("*.h5"))


def write(folder, name, kind, columns, mechanical="free", actuator="joint"):
    folder.mkdir(exist_ok=True)
    sampling = {"q_axis_current": "mean"}
    specs = [ChannelSpec(q, q, "test", "drive", sampling=sampling.get(q, "instant"), dtype="f8") for q in columns]
    info = RunInfo(
        run_id=name,
        protocol=kind,
        bench="joint",
        actuator=actuator,
        condition="",
        operator="",
        simulated=True,
        mechanical=mechanical,
        software="a simulator",
        created="2026-01-01T00:00:00Z",
        sources={},
    )
    with RunWriter(folder, info, {"loop": specs}) as writer:
        count = len(next(iter(columns.values())))
        writer.append("loop", np.arange(1, count + 1) / RATE, np.column_stack(list(columns.values())))
    writer.path.rename(folder / f"{name}.h5")


PLAIN = Machine()
WAVY = replace(PLAIN, cogging=0.02)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """Runs of a simulator with a wave of torque, and those of a machine that has drag as well."""
    folder = tmp_path_factory.mktemp("simulated")
    written(folder / "wavy", WAVY.steps, seed=1)
    written(folder / "real", replace(WAVY, drag=0.001).steps, seed=2)
    (folder / "nominal.yaml").write_text(MODEL)
    return folder


def words(folder, real="real", simulated="wavy", *more):
    sides = (sorted((folder / side).glob("*.h5")) for side in (real, simulated))
    return ("gap", "diagnose", *next(sides), "--simulated", *next(sides), "--model", folder / "nominal.yaml", *more)


def named(answer):
    return [cause["effect"] for cause in answer["causes"] if cause["probability"] >= 0.5]


@pytest.fixture(scope="module")
def answered(workshop):
    done = leactl(*words(workshop, "real", "wavy", "--json", "-", "--html", workshop / "page.html"))
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    fits_the_page("A diagnosis", answer)
    return answer


def test_what_the_real_runs_have_beyond_is_named_and_what_both_have_is_not(answered, workshop):
    assert answered["verdict"] == "effect"
    assert named(answered) == ["quadratic_drag"]
    [parameter] = answered["causes"][0]["parameters"]
    # the model's torque constant is held, so torques are told by the ratio of it to the machine's
    assert parameter["value"] == pytest.approx(0.001 * 0.5 / PLAIN.constant, rel=0.03)
    [contained] = answered["simulator"]["effects"]
    assert (contained["effect"], contained["in_real"]) == ("cogging", "alike")
    amplitude = next(item for item in contained["parameters"] if item["name"] == "amplitude")
    assert amplitude["simulated"] == pytest.approx(0.02 * 0.5 / PLAIN.constant, rel=0.03)
    assert amplitude["real"] == pytest.approx(amplitude["simulated"], rel=0.05)
    page = (workshop / "page.html").read_text(encoding="utf-8")
    assert "The real runs have quadratic_drag beyond it." in page


def test_the_nominal_is_the_simulator_with_its_fitted_parameters(answered):
    ratio = 0.5 / PLAIN.constant
    by_name = {item["parameter"]: item for item in answered["simulator"]["parameters"]}
    assert by_name["rotor_inertia"]["simulated"] == pytest.approx(PLAIN.inertia * ratio, rel=0.01)
    assert by_name["viscous_damping"]["simulated"] == pytest.approx(PLAIN.damping * ratio, rel=0.01)
    assert by_name["rotor_inertia"]["start"] == 0.008
    assert not any(item["differs"] for item in by_name.values())
    nominal = {item["parameter"]: item["nominal"] for item in answered["calibration"]}
    assert nominal == pytest.approx({name: by_name[name]["simulated"] for name in nominal})
    [speed] = [item for item in answered["simulator"]["floors"] if item["quantity"] == "velocity"]
    [gap] = [item for item in answered["shrinkage"] if item["quantity"] == "velocity"]
    assert gap["floor_rms"] > np.hypot(speed["floor_rms"], 0.9 * speed["left_rms"])
    assert gap["augmented_rms"] < 1.1 * gap["floor_rms"] < 0.1 * gap["nominal_rms"]


def test_each_real_run_has_its_simulated_run_by_name(answered, workshop):
    pairs = answered["simulator"]["runs"]
    assert len(pairs) == 6
    assert all(Path(pair["real"]).name == Path(pair["simulated"]).name for pair in pairs)
    assert {pair["paired_by"] for pair in pairs} == {"name"}


@pytest.mark.long
def test_identical_runs_are_sound(workshop, tmp_path):
    shutil.copytree(workshop / "wavy", tmp_path / "real")
    answer = leactl_diagnose(tmp_path / "real", workshop / "wavy", workshop)
    assert answer.verdict == "none"
    assert not [cause for cause in answer.causes if cause.probability >= 0.5]
    assert [effect.in_real for effect in answer.simulator.effects] == ["alike"]


def leactl_diagnose(real, simulated, workshop):
    """The same from Python, the last run of each kind held out."""
    sides = [[str(path) for path in sorted(folder.glob("*.h5"))] for folder in (real, simulated)]
    return leactl_of_python.diagnose(sides[0], [], workshop / "nominal.yaml", simulated=sides[1])


@pytest.mark.long
def test_an_effect_of_the_simulator_that_the_machine_lacks_is_calibrated_away(workshop, tmp_path):
    written(tmp_path / "real", PLAIN.steps, seed=2)
    answer = leactl_diagnose(tmp_path / "real", workshop / "wavy", workshop)
    assert answer.verdict == "calibration"
    assert [(effect.effect, effect.in_real) for effect in answer.simulator.effects] == [("cogging", "absent")]
    [speed] = [line for line in answer.shrinkage if line.quantity == "velocity"]
    assert speed.calibrated_rms < 1.1 * speed.floor_rms < 0.9 * speed.nominal_rms
    assert "The real runs lack cogging of it." in str(answer)


MJCF = """\
<mujoco>
  <option timestep="0.0003125" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="joint" axis="0 0 1" damping="{damping}" frictionloss="{friction}" armature="{armature}"/>
    <geom type="box" size="0.01 0.01 0.01" mass="0.001"/>
  </body></worldbody>
  <actuator><motor joint="joint" gear="{constant}"/></actuator>
</mujoco>
"""


def test_mujoco_is_a_nominal_like_any_other(workshop, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="simulates in leactl[mujoco]")
    about = {"damping": PLAIN.damping, "friction": PLAIN.friction, "constant": PLAIN.constant}
    model = mujoco.MjModel.from_xml_string(MJCF.format(armature=PLAIN.inertia, **about))
    written(tmp_path / "sim", partial(stepped_by_mujoco, mujoco, model), noise=0.0)
    answer = leactl_diagnose(workshop / "real", tmp_path / "sim", workshop)
    assert {cause.effect for cause in answer.causes if cause.probability >= 0.5} == {"quadratic_drag", "cogging"}
    by_name = {item.parameter: item for item in answer.simulator.parameters}
    assert by_name["rotor_inertia"].simulated == pytest.approx(PLAIN.inertia * 0.5 / PLAIN.constant, rel=0.02)
    assert not by_name["viscous_damping"].differs


def stepped_by_mujoco(mujoco, model, asked):
    """The same signals as `Machine.steps`, the rotor by MuJoCo, current and velocity through their filters."""
    follows, filters = -np.expm1(-2.0 * np.pi * np.array([LOOP, 80.0]) * model.opt.timestep)
    state, out, flowing, reading = mujoco.MjData(model), [], 0.0, 0.0
    for value in np.repeat(asked, PARTS):
        flowing += follows * (value - flowing)
        state.ctrl[0] = flowing
        mujoco.mj_step(model, state)
        reading += filters * (state.qvel[0] - reading)
        out.append((flowing, state.qvel[0], reading, state.qpos[0]))
    return np.array(out).T
