"""The ADS1115 driver against the converter's far end: registers, waits, saturation, zero, on every transport."""

import errno
import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.ads1115.driver import LONGEST_START_S
from leactl_plugins.ads1115.settings import Ads1115Settings
from pydantic import ValidationError

from leactl.errors import DeviceError, NoAnswer

from .adc_bench import TORQUE, AdcBench
from .failing import FailingConverter
from .transports import I2cInProcess

MARK = 0x04  # what the far end changes in the low byte of the config register of a store, to know the next start


@pytest.fixture
def bench(make_adc):
    bench = make_adc()
    bench.adc.open()
    bench.bus.tape.clear()
    return bench


def transfers(bench):
    """What went over the wire but for polls that found the conversion running, and without the mark of a store."""
    seen = []
    for kind, address, register, (high, low) in bench.bus.tape:
        if kind == "write" or register == 0:
            seen.append((kind, address, register, [high, low]))
        elif high & 0x80:
            seen.append((kind, address, register, [high, low & ~MARK]))
    return seen


def test_one_reading_is_start_poll_read_most_significant_byte_first(bench):
    bench.far.apply(1.0, -0.5)
    (row,) = bench.rows(1, period=0.002)
    assert transfers(bench) == [
        ("write", 0x48, 1, [0x83, 0xE3]),
        ("read", 0x48, 1, [0x83, 0xE3]),
        ("read", 0x48, 0, [0x2E, 0xE0]),
        ("write", 0x48, 1, [0x83, 0xE3]),
    ]
    assert row.values == (pytest.approx(4.5),)


def test_the_stamp_is_the_middle_of_the_conversion_not_the_time_of_reading(bench):
    before = bench.clock.now()
    assert bench.adc.take() == ()
    after = bench.clock.now()
    (row,) = bench.rows(1, period=0.050)
    started = row.time - (1 / 860 + 25e-6) / 2
    assert before - 1e-9 <= started <= after + 1e-9


class Stalling(I2cInProcess):
    """A bus at which the host is held up before and after transfers, in turn by these times [s]."""

    def __init__(self, times):
        super().__init__()
        self._times = itertools.cycle(times)

    def connect(self):
        return self

    def _between(self, transfer):
        self.clock.sleep_until(self.clock.now() + next(self._times))
        answer = transfer()
        self.clock.sleep_until(self.clock.now() + next(self._times))
        return answer

    def read_word_data(self, *arguments):
        return self._between(lambda: self.bus.read_word_data(*arguments))

    def write_word_data(self, *arguments):
        self._between(lambda: self.bus.write_word_data(*arguments))

    def close(self):
        self.bus.close()


PER_SECOND = 0.1  # V/s, of a pin whose voltage tells when it was sampled


@settings(max_examples=60)
@given(
    st.lists(
        st.one_of(st.just(0.0), st.just(0.0), st.floats(0.0, 0.001), st.floats(0.0005, 0.05)), min_size=7, max_size=40
    ),
    st.sampled_from([0.001, 0.002, 0.01, 0.02]),
)
def test_no_course_of_stalls_puts_a_reading_at_another_time(times, period):
    bench = AdcBench(wire=Stalling(times))
    far = bench.far
    far._pins = lambda number: PER_SECOND * far.due if number == 0 else 0.0
    bench.adc.open()
    conversion, count, rows = 1 / 860 + 25e-6, 4.096 / 32768, 0
    apart = conversion + count / PER_SECOND + LONGEST_START_S
    while bench.clock.now() < 3.0:
        for row in bench.adc.take():
            sampled = row.values[0] / 3.0 / PER_SECOND
            assert abs(row.time - sampled) <= apart
            rows += 1
        bench.clock.sleep_until(bench.clock.now() + period)
    assert rows > 10 or sum(times) > 0.1


def test_a_bus_on_which_no_start_is_known_in_time_is_told():
    bench = AdcBench(wire=Stalling([0.004]))
    bench.adc.open()
    with pytest.raises(NoAnswer, match=r"20 starts of a conversion .* took more than 6.19 ms, the last 8 ms"):
        bench.rows(1)


def test_an_adapter_that_is_slower_than_a_conversion_is_read_all_the_same():
    bench = AdcBench(wire=Stalling([0.0015]))  # 3 ms a transfer, as over USB
    bench.adc.open()
    assert len(bench.rows(20)) >= 20


def test_a_slow_converter_is_waited_for_and_nothing_is_read_twice(make_adc):
    bench = make_adc(clock_error=-0.10)
    bench.adc.open()
    count, seen = 4.096 / 32768, []
    bench.far.climb(count)
    while len(seen) < 100:
        seen += [round(row.values[0] / 3.0 / count) for row in bench.adc.take()]
        bench.clock.sleep_until(bench.clock.now() + 0.0005)
    assert seen == [*range(seen[0], seen[0] + len(seen))]


@pytest.mark.parametrize(("volts", "sign"), [(4.2, "+"), (-4.2, "-")])
def test_saturation_is_a_fault_not_a_value(bench, volts, sign):
    bench.far.apply(volts)
    (row,) = bench.rows(1)
    assert math.isnan(row.values[0])
    assert row.fault == f"input torque is saturated at {sign}4.096 V"


@pytest.mark.parametrize("range_v", [6.144, 4.096, 2.048, 1.024, 0.512, 0.256])
@pytest.mark.parametrize("sign", [-1, 1])
def test_gain_and_sign_of_every_range(make_adc, range_v, sign):
    bench = make_adc({**TORQUE, "range_V": range_v, "sign": sign, "offset_V": 0.1})
    bench.adc.open()
    bench.far.apply(0.0, 0.0625)
    (row,) = bench.rows(1)
    assert row.values == (pytest.approx(sign * 3.0 * (-0.0625 - 0.1), abs=3.0 * range_v / 32768 / 2),)


def test_tare_makes_the_present_torque_zero(bench):
    bench.far.apply(0.1)
    readings = [row.values[0] for row in bench.rows(8)]
    assert bench.adc.tare({"torque_sensor": sum(readings) / 8}) == {"torque": pytest.approx(0.3, abs=2e-4)}
    assert bench.rows(2)[-1].values[0] == pytest.approx(0.0, abs=1e-6)


RAILED = {**TORQUE, "scale_per_V": 10.8, "offset_V": 1.6667, "low_V": 0.05, "high_V": 3.27, "pins": "A0"}


@pytest.mark.parametrize("volts", [3.3, 3.2702, 0.0498, 0.0, -0.2])
def test_a_sensor_at_its_rail_is_a_fault_not_a_value(make_adc, volts):
    bench = make_adc(RAILED)
    bench.adc.open()
    bench.far.apply(volts)
    (row,) = bench.rows(1)
    assert math.isnan(row.values[0])
    assert (
        row.fault
        == f"input torque at {round(volts * 8000) / 8000:.4g} V is outside the 0.05 to 3.27 V that its sensor tells"
    )


@pytest.mark.parametrize("volts", [3.2699, 1.6667, 0.0501])
def test_a_sensor_inside_its_rails_is_read(make_adc, volts):
    bench = make_adc(RAILED)
    bench.adc.open()
    bench.far.apply(volts)
    (row,) = bench.rows(1)
    assert row.values == (pytest.approx(10.8 * (volts - 1.6667), abs=10.8 / 8000),)


def test_a_tare_under_load_is_refused_with_its_value_and_moves_nothing(bench):
    bench.far.apply(0.25)
    with pytest.raises(DeviceError, match=r"by \+0.25 V \(\+0.75 N\*m\); tare_limit_V is 0.2048 V"):
        bench.adc.tare({"torque_sensor": bench.rows(1)[0].values[0]})
    assert bench.rows(2)[-1].values[0] == pytest.approx(0.75, abs=1e-3)


def test_tares_do_not_creep_past_the_limit(make_adc):
    bench = make_adc({**TORQUE, "tare_limit_V": 0.1})
    bench.adc.open()
    bench.adc.tare({"torque_sensor": -0.2})
    with pytest.raises(DeviceError, match=r"by -0.1333 V \(-0.4 N\*m\); tare_limit_V is 0.1 V"):
        bench.adc.tare({"torque_sensor": -0.2})
    with pytest.raises(DeviceError, match="nan V"):
        bench.adc.tare({"torque_sensor": math.nan})


def test_several_inputs_take_turns_each_with_its_own_stream(make_adc):
    voltage = {"name": "line", "quantity": "line_voltage", "role": "test", "pins": "A2", "scale_per_V": 1.0}
    bench = make_adc(TORQUE, voltage)
    bench.adc.open()
    bench.far.apply(0.5, 0.0, 2.0)
    rows = bench.rows(4)
    assert [row.stream for row in rows] == ["torque_sensor_torque", "torque_sensor_line"] * 2
    assert [round(row.values[0], 3) for row in rows] == [1.5, 2.0, 1.5, 2.0]


def test_an_absent_converter_is_named(make_adc):
    bench = make_adc(address=0x4B)
    with pytest.raises(NoAnswer, match="0x4B: not acknowledged"):
        bench.adc.open()


def test_a_converter_that_was_reset_is_a_fault_not_a_value():
    bench = AdcBench()
    bench.adc.open()
    bench.far.apply(1.0)
    assert bench.rows(1)[0].values == (pytest.approx(3.0),)
    bench.far.reset()
    faulty, after = bench.rows(2)
    assert math.isnan(faulty.values[0])
    assert faulty.fault == (
        "input torque was converted by config 0x8583, 0x83E3 was written; was the converter reset, or is there"
        " another program on the bus?"
    )
    assert (after.values, after.fault) == ((pytest.approx(3.0),), "")


@pytest.mark.parametrize("waited", [0.0, 0.0012])
def test_a_conversion_that_another_program_asked_for_is_a_fault_not_a_value(waited):
    bench = AdcBench()
    bench.adc.open()
    bench.far.apply(1.0, 0.0, 2.0)
    bench.adc.take()
    bench.clock.sleep_until(bench.clock.now() + waited)
    bench.port.write(0x48, 1, 0xE3E3)  # A2
    faulty, after = bench.rows(2)
    assert math.isnan(faulty.values[0])
    assert faulty.fault.startswith("input torque was converted by config 0xE3E3, 0x83E3 was written")
    assert (after.values, after.fault) == ((pytest.approx(3.0),), "")


def test_a_conversion_that_never_ends_is_no_answer(bench):
    bench.far.stall()
    with pytest.raises(NoAnswer, match="has not ended"):
        bench.rows(1)


def test_settings_are_checked():
    for change in (
        {"pins": "A1-A0"},
        {"range_V": 5.0},
        {"quantity": "torqe"},
        {"rate_sps": 900},
        {"scale_per_V": 0},
        {"scale_per_V": math.inf},
        {"low_V": 2.0, "high_V": 1.0},
    ):
        with pytest.raises(ValidationError):
            Ads1115Settings(inputs=({**TORQUE, **change},))


def test_a_plain_store_shows_every_start_and_its_own_result():
    class Store(dict):
        read = dict.__getitem__
        write = dict.__setitem__

    store, far = Store(), FailingConverter()
    far.keep(store, 0.0)
    assert store == {0: 0x0000, 1: 0x8583, 2: 0x8000, 3: 0x7FFF}
    for second, volts in enumerate((1.0, -1.0, 0.5), start=1):
        far.apply(volts)
        store[1] = 0x83E3  # the same word each time
        far.keep(store, float(second))
        assert not store[1] & 0x8000
        far.keep(store, second + 0.0011)
        assert not store[1] & 0x8000
        far.keep(store, second + 0.0012)
        assert store[1] == 0x83E3 ^ MARK
        assert store[0] == round(volts * 8000) & 0xFFFF
    store[1] = 0x0583  # power down starts nothing, and reads back as it was written
    far.keep(store, 5.0)
    assert store[1] == 0x0583


# -- in process only: the kernel's stub fails in no way but absence, and hundreds of benches take minutes there -------


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        (errno.EREMOTEIO, NoAnswer, "0x48: not acknowledged"),
        (errno.ENXIO, NoAnswer, "not acknowledged"),
        (errno.ETIMEDOUT, NoAnswer, "timed out"),
        (errno.EBUSY, DeviceError, "kernel driver"),
        (errno.EIO, DeviceError, "injected"),
    ],
)
def test_errors_of_the_bus_are_named(code, kind, words):
    bench = AdcBench()
    bench.adc.open()
    bench.bus.error = code
    with pytest.raises(kind, match=words):
        bench.adc.take()


def test_a_transfer_that_is_not_acknowledged_once_or_twice_is_made_again_and_told(monkeypatch):
    bench = AdcBench()
    bench.adc.open()
    read, refusals = bench.bus.read_word_data, [errno.EREMOTEIO, errno.EREMOTEIO]

    def noisy(address, register):
        if refusals:
            raise OSError(refusals.pop(), "Remote I/O error")
        return read(address, register)

    monkeypatch.setattr(bench.bus, "read_word_data", noisy)
    rows = []
    while not rows:
        rows += bench.adc.take()
        bench.clock.sleep_until(bench.clock.now() + 0.001)
    assert refusals == []
    [told] = bench.adc.notices()
    assert "a transfer went through only when it was repeated, 2 so far" in told
    assert bench.adc.notices() == []


def test_a_transfer_that_is_never_acknowledged_is_made_three_times(monkeypatch):
    bench = AdcBench()
    bench.adc.open()
    attempts = []

    def deaf(address, register, value):
        attempts.append(register)
        raise OSError(errno.EREMOTEIO, "Remote I/O error")

    monkeypatch.setattr(bench.bus, "write_word_data", deaf)
    with pytest.raises(NoAnswer, match="0x48: not acknowledged"):
        bench.adc.take()
    assert len(attempts) == 3


@given(
    volts=st.floats(-0.25, 0.25),
    pins=st.sampled_from(["A0-A1", "A0-A3", "A1-A3", "A2-A3", "A0", "A1", "A2", "A3"]),
    range_v=st.sampled_from([6.144, 4.096, 2.048, 1.024, 0.512, 0.256]),
    rate=st.sampled_from([8, 16, 32, 64, 128, 250, 475, 860]),
    sign=st.sampled_from([-1, 1]),
    offset=st.floats(-1, 1),
)
def test_every_input_range_and_rate_reads_within_half_a_count(volts, pins, range_v, rate, sign, offset):
    bench = AdcBench({**TORQUE, "pins": pins, "range_V": range_v, "rate_sps": rate, "sign": sign, "offset_V": offset})
    bench.adc.open()
    bench.far.apply(*[volts if pin == int(pins[1]) else 0.0 for pin in range(4)])
    (row,) = bench.rows(1)
    count = range_v / 32768
    if volts <= range_v - 1.5 * count:
        assert row.values[0] == pytest.approx(sign * 3.0 * (volts - offset), abs=3.0 * count * 0.5001)
