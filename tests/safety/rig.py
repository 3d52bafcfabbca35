"""A supervised drive and a supervised converter on emulated wires of one clock, exchanged as the loop does it."""

from leactl_plugins.ads1115.driver import Ads1115
from leactl_plugins.ads1115.settings import Ads1115Settings

from leactl import yamlfile
from leactl.driver.contract import Mode
from leactl.driver.i2c_port import I2cPort
from leactl.emulation.wires.buses import EmulatedI2cBus
from leactl.safety.interlocks import Interlocks
from leactl.safety.limits import Limits
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.witnesses import TorqueModel
from tests.driver.elmo_bench import ElmoBench
from tests.driver.failing import FailingConverter
from tests.safety.guards import LEA, guard_of

LIMITS = Limits(
    current_A=30,
    velocity_rad_s=40,
    torque_Nm=15,
    bus_voltage_low_V=20,
    bus_voltage_high_V=60,
    age_s=2.5,
    winding_temperature_degC=130,
)
TORQUE = {"name": "torque", "quantity": "torque", "role": "test", "pins": "A0", "scale_per_V": 5.0, "range_V": 6.144}
HOUSING = {"name": "t", "quantity": "housing_temperature", "role": "test", "pins": "A0", "scale_per_V": 100.0}


class Rig(ElmoBench):
    """One drive at node 1 and one sensor; `interlocks` as a person writes them in YAML."""

    def __init__(self, interlocks="{}", sensor=TORQUE, limits=LIMITS, period=0.001, start=28.0, **settings):
        super().__init__(**settings)
        self.drive.open()
        bus = EmulatedI2cBus(self.clock)
        self.converter = bus.devices[0x48] = FailingConverter()
        checked = Ads1115Settings(inputs=(sensor,))
        self.sensor = Ads1115("sensor", "bench", checked, I2cPort(lambda: bus, "i2c-1"), self.clock)
        self.sensor.open()
        block = yamlfile.parse(interlocks).validate(Interlocks)
        axes, models = {"test": Axis(self.drive, self.drive)}, {"test": TorqueModel.of(LEA)}
        self.supervisor = Supervisor(limits, axes, [self.sensor], self.clock, guard_of(start=start), block, models)
        self.supervisor.begin(period)
        self.period = period

    def supervised_cycle(self):
        """Demand, SYNC, answers, judgement, sign of life, and the wait for the next."""
        began = self.clock.now()
        self.drive.begin_cycle()
        self.port.sync()
        self.drive.end_cycle(began + 0.6 * self.period)
        for device in (self.drive, self.sensor):
            for row in device.take():
                self.supervisor.receive(row)
        self.supervisor.check(self.clock.now())
        self.drive.feed()
        self.clock.sleep_until(began + self.period)

    def run(self, seconds, each=lambda: None):
        for _ in range(round(seconds / self.period)):
            each()
            self.supervised_cycle()

    def engage(self, mode=Mode.CURRENT):
        self.supervisor.engage("test", mode)
        while not self.drive.engaged:
            self.supervised_cycle()
