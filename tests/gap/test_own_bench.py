"""What `leactl run` records on the emulated bench, `leactl gap diagnose` understands: drives, wires and converter."""

import json

import pytest

from leactl import yamlfile
from leactl.bench import benchfile
from leactl.emulation.plant.parameters import BenchParameters
from leactl.model.motor import load_motor
from leactl.model.nominal import Model
from tests.cli.terminal import leactl

PROTOCOLS = (("separate-by-grid", ()), ("separate-drive-timing", ("--set", "repeats=1")))


@pytest.fixture(scope="module")
def diagnose(tmp_path_factory):
    """Record two protocols twice on a bench with this effect, and diagnose the runs against the model without it."""

    def answer(*effect):
        here = tmp_path_factory.mktemp("own")
        bench = here / "bench.yaml"
        entry = f"  effects: [{{effect: {effect[0]}, parameters: {json.dumps(effect[1])}}}]\n" if effect else ""
        bench.write_text((benchfile.SHIPPED / "emulated.yaml").read_text() + entry)
        nominal = here / "nominal.yaml"
        nominal.write_text(leactl("bench", "model", "emulated").stdout)
        runs = []
        for protocol, settings in PROTOCOLS:
            for seed in (1, 2):
                chosen = ("--bench", bench, "--set", f"seed={seed}", *settings, "--out", here, "--json")
                done = leactl("run", protocol, *chosen, LEACTL_STATE=str(here / "state"))
                assert done.returncode == 0, done.stderr
                runs.append(json.loads(done.stdout)["run"])
        done = leactl("gap", "diagnose", *runs, "--model", nominal, "--json", here / "answer.json")
        assert done.returncode == 0, done.stderr
        return json.loads((here / "answer.json").read_text())

    return answer


def test_the_model_of_the_emulated_bench_is_what_the_bench_is_made_of():
    nominal = yamlfile.parse(leactl("bench", "model", "emulated").stdout, "nominal.yaml").validate(Model)
    file, _, _ = benchfile.load("emulated")
    bench = BenchParameters.from_mapping(file.emulated.bench)
    known = nominal.bench.model_dump()
    assert known == {name: getattr(bench, name) for name in known}
    assert nominal.torque_constant == load_motor("lea")[0].torque_constant


@pytest.mark.long
def test_a_bench_as_its_model_says_has_no_cause(diagnose):
    diagnosis = diagnose()
    assert diagnosis["verdict"] in ("none", "calibration")
    assert all(cause["probability"] < 0.5 for cause in diagnosis["causes"])
    assert [line for line in diagnosis["where"] if line["mechanical"] == "free"] == []
    fitted = {line["parameter"]: line["fitted"] / line["nominal"] for line in diagnosis["calibration"]}
    for name in ("torque_constant", "viscous_damping", "coulomb_friction", "rotor_inertia"):
        assert fitted[name] == pytest.approx(1.0, abs=0.01), name


@pytest.mark.long
def test_an_effect_behind_the_wires_is_named_with_its_size(diagnose):
    diagnosis = diagnose("quadratic_drag", {"coefficient": 4e-4})
    first = diagnosis["causes"][0]
    assert (diagnosis["verdict"], first["effect"]) == ("effect", "quadratic_drag")
    (size,) = first["parameters"]
    assert size["value"] == pytest.approx(4e-4, rel=0.02)
