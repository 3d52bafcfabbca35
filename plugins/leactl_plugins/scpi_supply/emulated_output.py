"""One regulated output of an emulated supply: levels, switch, two protections, and its load."""

from leactl.driver.far_end import SupplyLoad

INITIAL_PROTECTION_OVER_RATING = 1.1  # initial level of a protection, over the highest rating


class NothingConnected:
    """Terminals without a load."""

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Hold the voltage [V]; no current flows."""
        return voltage, 0.0


class ProtectionState:
    """State of a protection: its level [V or A], whether it is armed, and whether it has tripped."""

    def __init__(self, level: float) -> None:
        self.level, self.armed, self.tripped = level, True, False


class EmulatedOutput:
    """One output with its protections and its load; `ratings` has one range or two, `range` is the present one."""

    def __init__(self, number: int, ratings: tuple[tuple[float, float], ...], load: SupplyLoad) -> None:
        self.number, self.ratings, self._load = number, ratings, load
        self.range = 0
        highest_voltage, highest_current = max(v for v, _ in ratings), max(a for _, a in ratings)
        self.set_volts, self.set_amperes = 0.0, self.rating[1]
        self.on = False
        self.volts = self.amperes = 0.0  # V and A at the terminals
        self.over_voltage = ProtectionState(INITIAL_PROTECTION_OVER_RATING * highest_voltage)
        self.over_current = ProtectionState(INITIAL_PROTECTION_OVER_RATING * highest_current)
        self.trips_in_regulation = False  # whether the over-current protection trips once the current is regulated
        self.stuck = False  # whether the output stays on in spite of its switch
        self.share = 1.0  # of the set levels that is put out
        self.regulate()

    @property
    def rating(self) -> tuple[float, float]:
        """Voltage [V] and current [A] of the present range."""
        return self.ratings[self.range]

    @property
    def tripped(self) -> bool:
        """Whether a protection has switched the output off."""
        return self.over_voltage.tripped or self.over_current.tripped

    @property
    def condition(self) -> int:
        """Condition register: 1 if the current is regulated, 2 if the voltage is, 0 if neither is."""
        if not self.on or self.share != 1.0 or self.tripped:
            return 0
        return 1 if self.volts < self.set_volts - 1e-6 else 2

    def regulate(self) -> None:
        """Regulate the terminals to the levels; an armed protection whose level is exceeded trips."""
        is_live = self.stuck or (self.on and not self.tripped)
        demanded = (self.set_volts * self.share, self.set_amperes * self.share) if is_live else (0.0, 0.0)
        self.volts, self.amperes = self._load.feed(*demanded)
        exceeded = self.volts > self.over_voltage.level, self.amperes > self.over_current.level
        if self.trips_in_regulation:
            exceeded = exceeded[0], self.condition == 1
        for protection, is_exceeded in zip((self.over_voltage, self.over_current), exceeded, strict=True):
            if protection.armed and is_exceeded and not protection.tripped:
                protection.tripped = True
                self.regulate()
