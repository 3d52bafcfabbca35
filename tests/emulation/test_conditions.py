"""Parameters of the emulated actuators under a condition: motor file, then `test` or `load`, then the condition."""

import pytest
import yaml

from leactl.bench import benchfile
from leactl.emulation.bench.emulated_bench import EmulatedBench


@pytest.fixture
def parameters(tmp_path):
    """Parameters of an actuator of the emulated bench with this `emulated:` block, by role and condition."""

    def parameters(role, condition, **emulated):
        bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        bench["emulated"] |= emulated
        path = tmp_path / "bench.yaml"
        path.write_text(yaml.safe_dump(bench))
        file, _devices, _ = benchfile.load(str(path))
        return EmulatedBench(file, (), "free", condition).rig.actuators[role].parameters

    return parameters


@pytest.mark.parametrize("role", ["test", "load"])
def test_a_condition_overrides_the_parameters_of_its_actuator(parameters, role):
    changes = {role: {"coulomb_friction": 0.1, "rotor_inertia": 0.01}}
    assert parameters(role, "", **changes).coulomb_friction == 0.1
    loaded = parameters(role, "loaded", **changes)
    assert (loaded.coulomb_friction, loaded.viscous_damping, loaded.rotor_inertia) == (0.3037, 0.0255, 0.01)


def test_a_condition_changes_only_the_thermal_parameters_that_it_names(parameters):
    test = {"thermal": {"winding_capacitance": 30.0, "housing_capacitance": 500.0}}
    conditions = {"wet": {"thermal": {"housing_capacitance": 900.0}}}
    thermal = parameters("test", "wet", test=test, conditions=conditions).thermal
    assert (thermal.winding_capacitance, thermal.housing_capacitance) == (30.0, 900.0)
