"""A supervised supply on an emulated serial line, taken from and judged as the loop does it."""

from leactl.safety.interlocks import Interlocks
from leactl.safety.limits import LEADS
from leactl.safety.supervisor import Supervisor
from tests.driver.supply_bench import Bk1688bBench, SupplyBench
from tests.safety.guards import guard_of
from tests.safety.rig import LIMITS

PERIOD = 1 / 30


class Supervised:
    """A supply at the leads of `test` under supervision; a resistor of 0.6 ohm is its load."""

    read_every_s = 0.02

    def __init__(self, start=28.0, limits=LIMITS, **settings):
        super().__init__(period_s=self.read_every_s, **settings)
        self.supply.open()
        self.guard = guard_of(start=start)
        self.supervisor = Supervisor(limits, {}, [self.supply], self.clock, self.guard, Interlocks())
        self.supplies = self.supervisor.supplies
        self.supervisor.begin(PERIOD)
        self.said.clear()

    @property
    def heating(self):
        """Direct current that the guard takes to flow [A]."""
        return (self.guard.leads.get(0, 0.0) / LEADS) ** 0.5

    def cycle(self, count=1):
        for _ in range(count):
            began = self.clock.now()
            for row in self.supply.take():
                self.supervisor.receive(row)
            self.supervisor.check(self.clock.now())
            self.clock.sleep_until(began + PERIOD)

    def heat(self, volts=8.0, amperes=9.0):
        """Switch on and go on until it is reported."""
        self.supplies.put_out("test", volts, amperes)
        while not self.supplies.supplying("test"):
            self.cycle()
        self.cycle(4)


class SupplyRig(Supervised, Bk1688bBench):
    """A supply without a protection of its own."""


class ProtectedSupplyRig(Supervised, SupplyBench):
    """A supply with an over-voltage protection."""

    read_every_s = 0.2
