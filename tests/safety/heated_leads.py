"""Many actuators side by side whose two leads a supply feeds for ever: three phases and a housing each, step by step.

Written down from the balance of heat, without a line of the bound that it is held against.
"""

import numpy as np

STEP_S = 1.0  # a phase follows with 7 s


class HeatedActuators:
    """Actuators anywhere inside the tolerances of a motor file, the corners first."""

    def __init__(self, motor, ambient, random, count=200):
        kept = motor.tolerances

        def drawn(value, tolerance):
            at = np.sign(random.uniform(-1, 1, count))
            at[count // 2 :] = random.uniform(-1, 1, count - count // 2)
            return value * (1.0 + tolerance * at)

        thermal = motor.thermal
        self.resistance = drawn(motor.phase_resistance, kept.phase_resistance)
        self.rise = drawn(motor.resistance_coefficient, kept.resistance_coefficient)
        self.reference = motor.reference_temperature
        self.to_air = 1.0 / (3.0 * drawn(thermal.winding_ambient_resistance, kept.winding_ambient_resistance))
        self.across = 1.0 / (3.0 * drawn(thermal.winding_housing_resistance, kept.winding_housing_resistance))
        self.housing_to_air = 1.0 / drawn(thermal.housing_ambient_resistance, kept.housing_ambient_resistance)
        self.phase_capacity = drawn(thermal.winding_capacitance, kept.winding_capacitance) / 3.0
        self.housing_capacity = drawn(thermal.housing_capacitance, kept.housing_capacitance)
        # the worst of its sensor, its supply and the air: what the motor file and the supply's driver allow for
        self.current_gain = np.where(random.uniform(size=count) < 0.7, 1.0 + kept.current, 1.0 - kept.current)
        self.air = ambient + kept.ambient_K * np.where(random.uniform(size=count) < 0.7, 1.0, -1.0)
        self.count = count

    def begin(self, phases, housing):
        """Start with these temperatures of the three phases and the housing [degC]."""
        self.phases = np.repeat(np.array(phases, float)[:, None], self.count, axis=1)
        self.housing = np.full(self.count, float(housing))

    def leave_on(self, voltage, current, seconds, trips_at=np.inf, watts=None):
        """Feed leads of the first two phases; highest temperature of any phase, and whether the supply has tripped.

        `watts` go into the leads whatever their resistance, where they are given.
        """
        highest, tripped = self.phases.max(axis=0), np.zeros(self.count, bool)
        for _ in range(round(seconds / STEP_S)):
            ohms = self.resistance * (1.0 + self.rise * (self.phases[:2] - self.reference))
            amperes = np.minimum(current * self.current_gain, voltage / ohms.sum(axis=0))
            if watts is not None:
                amperes = np.sqrt(watts / ohms.sum(axis=0))
            tripped |= amperes * ohms.sum(axis=0) > trips_at
            amperes = np.where(tripped, 0.0, amperes)
            gained = (self.phases - self.housing) * self.across
            heat = -gained - (self.phases - self.air) * self.to_air
            heat[:2] += ohms * amperes**2
            into_housing = gained.sum(axis=0) - (self.housing - self.air) * self.housing_to_air
            self.phases = self.phases + heat * STEP_S / self.phase_capacity
            self.housing = self.housing + into_housing * STEP_S / self.housing_capacity
            highest = np.maximum(highest, self.phases.max(axis=0))
        return highest, tripped
