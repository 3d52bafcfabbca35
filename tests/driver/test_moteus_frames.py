"""Frames of the multiplex protocol: golden bytes, properties, mutated frames, the maker's own package as the peer."""

import asyncio
import math
import random
import struct

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from leactl_plugins.moteus_can.emulator import MoteusEmulator
from leactl_plugins.moteus_can.multiplex import (
    LENGTHS,
    NOP,
    Resolution,
    pad,
    parse,
    poll_for_text,
    read,
    text_to_device,
    varuint,
    write,
)
from leactl_plugins.moteus_can.registers import MODES, SCALES, Register

from leactl.driver.contract import Mode
from leactl.driver.far_end import FdFrame
from leactl.errors import LeactlError

from .failing import Shaft
from .moteus_bench import CONSTANT, NODE, TO_DRIVE, MoteusBench

SCALED = sorted(SCALES)
WHOLE = [Register.MODE, Register.FAULT, Register.MODEL_NUMBER, Register.SERIAL_NUMBER]
HIGHEST = {Resolution.INT8: 127, Resolution.INT16: 32767, Resolution.INT32: 2147483647}
whole_resolutions = st.sampled_from(sorted(HIGHEST))
MUTANTS = 5000


def answer_with(subframe):
    """A written subframe as the reply that tells the same."""
    return bytes((subframe[0] | 0x20,)) + subframe[1:]


def single(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


# -- golden bytes of the maker's documents ---------------------------------------------------------------------------


def test_the_makers_example_of_a_command_with_a_question():
    frame = (
        write(Register.MODE, [10], Resolution.INT8)
        + write(Register.COMMAND_POSITION, [0.0096, 0.072, -1.76], Resolution.INT16)
        + read(Register.MODE, 4, Resolution.INT16)
        + read(Register.VOLTAGE, 3, Resolution.INT8)
    )
    assert frame.hex() == "01000a07206000200150ff140400130d"


def test_the_makers_example_of_an_answer():
    reply = parse(bytes.fromhex("2404000a005000000170ff230d181400"))
    assert reply.values == {
        Register.MODE: 10,
        Register.POSITION: pytest.approx(0.008),
        Register.VELOCITY: pytest.approx(0.064),
        Register.TORQUE: pytest.approx(-1.44),
        Register.VOLTAGE: 12.0,
        Register.TEMPERATURE: 20.0,
        Register.FAULT: 0,
    }
    assert (reply.errors, reply.text) == ({}, None)


def test_the_makers_example_of_a_position_in_single_precision():
    frame = (
        write(Register.MODE, [10], Resolution.INT8)
        + write(Register.COMMAND_POSITION, [1.0, 2.0])
        + read(Register.MODE, 1, Resolution.INT8)
        + read(Register.POSITION, 3)
        + read(Register.VOLTAGE, 3, Resolution.INT8)
    )
    assert frame.hex() == "01000a0e200000803f0000004011001f01130d"


@pytest.mark.parametrize(
    ("frame", "values"),
    [
        ("210180", {0x001: math.nan}),
        ("25010080", {0x001: math.nan}),
        ("290100000080", {0x001: math.nan}),
        ("2d010000c07f", {0x001: math.nan}),
        ("21017f", {0x001: 1.27}),
        ("2a8002000000801e010000", {0x100: -2147483648, 0x101: 286}),  # whole numbers have no code for NaN
    ],
)
def test_the_lowest_code_of_a_physical_value_is_nan_and_of_a_whole_number_itself(frame, values):
    assert parse(bytes.fromhex(frame)).values == {
        key: pytest.approx(value, nan_ok=True) for key, value in values.items()
    }


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        ("2d01000000", "ends within a subframe, at byte 5"),
        ("20", "ends within a subframe, at byte 1"),
        ("20ffffffff", "ends within a subframe, at byte 5"),
        ("20ffffffffff01", "has a number of more than 5 bytes before byte 6"),
        ("01000a", "has 0x01 at byte 0, where a controller's subframe was expected"),
        ("210000210000", "tells register 0x000 twice"),
        ("410105abcd", "ends within a subframe, at byte 5"),
        ("21000020000d", "has no register in the subframe before byte 6"),
        ("250500002d0000000000", "tells register 0x005, whose scale is not known here"),
        ("2d0f0000003f", "tells 0.5 for register 0x00F, which holds whole numbers"),
        ("2d000000c07f", "tells nan for register 0x000, which holds whole numbers"),
        ("5099", "has 0x99 at byte 1"),
    ],
)
def test_a_frame_that_is_none_of_a_controllers_is_refused_with_its_place(frame, text):
    with pytest.raises(ValueError, match=text):
        parse(bytes.fromhex(frame))


@pytest.mark.parametrize(
    ("register", "value", "resolution", "text"),
    [
        (Register.COMMAND_POSITION, 1.28, Resolution.INT8, "register 0x020: 1.28 does not fit into int8"),
        (Register.COMMAND_POSITION, -1.28, Resolution.INT8, "-1.28 does not fit"),  # whose code is that of NaN
        (Register.MODE, 128, Resolution.INT8, "128 does not fit into int8"),
        (Register.COMMAND_POSITION, math.inf, Resolution.INT16, "inf does not fit into int16"),
        (Register.COMMAND_POSITION, 1e39, Resolution.FLOAT, r"1e\+39 is beyond single precision"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_and_not_clipped(register, value, resolution, text):
    with pytest.raises(ValueError, match=text):
        write(register, [value], resolution)


def test_a_frame_is_as_long_as_can_fd_has_it_and_never_longer():
    for length in range(65):
        frame = pad(bytes(length))
        assert len(frame) == min(each for each in LENGTHS if each >= length)
        assert set(frame[length:]) <= {NOP}
    with pytest.raises(ValueError, match="65 bytes; 64 at the most were expected"):
        pad(bytes(65))


# -- properties ------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
def test_a_varuint_comes_back_at_any_size(number):
    frame = bytes((0x31,)) + varuint(number) + varuint(number)
    assert parse(frame).errors == {number: number}
    assert len(varuint(number)) == max(1, math.ceil(number.bit_length() / 7))


@given(st.sampled_from(SCALED), whole_resolutions, st.floats(-1.0, 1.0))
def test_a_physical_value_comes_back_to_half_a_count(register, resolution, share):
    count = SCALES[register][resolution]
    value = share * HIGHEST[resolution] * count
    [told] = parse(answer_with(write(register, [value], resolution))).values.values()
    assert abs(told - value) <= 0.5000001 * count


@given(st.sampled_from(SCALED), st.floats(width=32))
def test_a_value_in_single_precision_comes_back_as_it_was(register, value):
    [told] = parse(answer_with(write(register, [value]))).values.values()
    assert told == value or (math.isnan(told) and math.isnan(value))


@given(st.sampled_from(WHOLE), whole_resolutions, st.data())
def test_a_whole_number_comes_back_as_it_was(register, resolution, data):
    value = data.draw(st.integers(-HIGHEST[resolution] - 1, HIGHEST[resolution]))
    assert parse(answer_with(write(register, [value], resolution))).values == {register: value}


@given(st.binary(max_size=64))
def test_bytes_of_any_kind_are_a_reply_or_refused(data):
    try:
        reply = parse(data)
    except ValueError:
        return
    assert len(reply.values) + len(reply.errors) <= len(data)


@given(st.lists(st.binary(max_size=64), max_size=5))
def test_no_bytes_break_the_emulator_or_move_a_stopped_machine_but_a_command(frames):
    shaft = Shaft()
    far = MoteusEmulator(NODE, shaft)
    for number, data in enumerate(frames):
        assume(b"\x0a" not in data)  # the mode that moves
        for reply in far.receive(FdFrame(TO_DRIVE, data), 0.01 * number):
            parse(reply.data)
            assert len(reply.data) in LENGTHS
    assert shaft.following[0] == "off"


# -- mutated frames --------------------------------------------------------------------------------------------------


def mutate(draw, frame):
    """One of the ways in which bytes go wrong: flipped, exchanged, dropped, put in, cut, repeated."""
    data = bytearray(frame)
    for _ in range(draw.choice((1, 1, 2, 4))):
        place = draw.randrange(len(data)) if data else 0
        kind = draw.randrange(6)
        if kind == 0 and data:
            data[place] ^= 1 << draw.randrange(8)
        elif kind == 1 and data:
            data[place] = draw.randrange(256)
        elif kind == 2 and data:
            del data[place]
        elif kind == 3:
            data.insert(place, draw.randrange(256))
        elif kind == 4:
            del data[place:]
        else:
            data += data[place : place + draw.randrange(1, 9)]
    return bytes(data[:64])


def test_of_thousands_of_mutated_answers_none_gives_a_row_that_its_bytes_do_not_hold_or_goes_without_a_note():
    draw, bench = random.Random(7), MoteusBench()
    bench.drive.open()
    bench.cycles(0.05)
    exchange, mutants = bench.drive._exchange, []

    def deliver(frame, now, receive=bench.far.receive):
        replies = receive(frame, now)
        if now >= begins and replies and len(replies[0].data) == 48:
            mutants.append((replies[0].data, mutate(draw, replies[0].data)))
            return [FdFrame(replies[0].identifier, mutants[-1][1])]
        return replies

    begins = bench.clock.now()
    bench.far.receive = deliver
    bench.shaft.velocity, bench.shaft.angle = 2.0, 0.75
    rows, noted = [], 0
    while len(mutants) < MUTANTS:
        before = counted(exchange)
        try:
            row = bench.cycle()
        except LeactlError:  # a mode or a fault that reads as one, an answer that stays away for too long
            bench.drive._heard_until = math.inf
            bench.drive.reported_mode = 0
            exchange.second_controller = False
            row = list(bench.drive.values)
        rows.append(row)
        noted += counted(exchange) > before
        was, became = mutants[-1]
        if math.isnan(row[6]):
            assert counted(exchange) > before  # never without a note
            assert all(math.isnan(value) for value in row[3:6])
        else:
            held = layout_of(became)  # found by itself: in which order whatever the answer holds came
            assert held is not None
            assert same(row[3], held[0x004] * math.sqrt(1.5))
            assert same(row[4], held[0x002] * 2 * math.pi)
            assert same(row[5], held[0x001] * 2 * math.pi)
            assert len(was) == 48
    assert noted > 0.5 * MUTANTS
    assert any(not math.isnan(row[6]) for row in rows)


def counted(exchange):
    told = exchange.irregular
    return exchange.unreadable + told.lost + told.late + told.surplus


def same(a, b):
    return a == pytest.approx(b, rel=1e-12, nan_ok=True)


def layout_of(data):
    """Registers of an answer to a cycle's question, by a reader of its own; None where it is none."""
    held, place = {}, 0
    sizes = {0: "<b", 1: "<h", 2: "<i", 3: "<f"}
    scales = {0x001: (0.01, 1e-4, 1e-5), 0x002: (0.1, 0.00025, 1e-5), 0x004: (1.0, 0.1, 0.001)}
    while place < len(data):
        head, place = data[place], place + 1
        if head == 0x50:
            continue
        if head == 0x31:
            return None
        assert head & 0xF0 == 0x20
        count = head & 3
        if not count:
            count, place = data[place], place + 1
        register, place = data[place], place + 1
        form = sizes[head >> 2 & 3]
        for each in range(register, register + count):
            (value,) = struct.unpack_from(form, data, place)
            place += struct.calcsize(form)
            if form != "<f" and each in scales:
                lowest = -(1 << 8 * struct.calcsize(form) - 1)
                value = math.nan if value == lowest else value * scales[each][head >> 2 & 3]
            held[each] = float(value)
    return held


# -- the maker's package as the peer ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def maker():
    """The package `moteus`, which the driver does without."""
    return pytest.importorskip("moteus", reason="pip install 'leactl[test]' brings the maker's package")


def test_the_maker_reads_the_drivers_frames_as_they_were_meant(maker):
    bench = MoteusBench(supply_period_s=60.0)
    bench.drive.open()
    bench.cycle()
    for mode, value in ((Mode.CURRENT, 3.0), (Mode.VELOCITY, -2.0), (Mode.ANGLE, 1.5)):
        bench.engage(mode)
        bench.cycle()
        bench.drive.command(value)
        bench.cycle()
        seen = maker.parse_registers(bench.commands()[-1])
        told = seen.command
        assert told[0x000] == maker.Mode.POSITION
        loops = 0.0 if mode is Mode.CURRENT else 1.0
        assert (told[0x023], told[0x024], told[0x02B]) == (loops, loops, pytest.approx(loops))
        assert (told[0x027], told[0x028], told[0x029]) == (pytest.approx(0.1), -1.0, -1.0)
        assert math.isnan(told[0x025])
        position, velocity, torque = {
            Mode.CURRENT: (math.nan, 0.0, 3.0 * math.sqrt(2 / 3) * CONSTANT),
            Mode.VELOCITY: (math.nan, -2.0 / (2 * math.pi), 0.0),
            Mode.ANGLE: (1.5 / (2 * math.pi), 0.0, 0.0),
        }[mode]
        assert told[0x020] == pytest.approx(position, rel=1e-6, nan_ok=True)
        assert told[0x021] == pytest.approx(velocity, rel=1e-6)
        assert told[0x022] == pytest.approx(torque, rel=1e-6)
        floats = [(register, maker.F32) for register in (0x010, 0x001, 0x002, 0x003, 0x004, 0x027)]
        assert sorted(seen.query) == sorted([(0x000, maker.INT8), (0x00F, maker.INT8), *floats])
        assert seen.response == {}
        assert seen.errors == []


@given(
    resolution=st.sampled_from(sorted(Resolution)),
    position=st.floats(-1.2, 1.2) | st.just(math.nan),
    velocity=st.floats(-8.0, 8.0),
    torque=st.floats(-60.0, 60.0),
)
def test_values_mean_the_same_to_both_ends_at_every_resolution(maker, resolution, position, velocity, torque):
    frame = write(Register.COMMAND_POSITION, [position, velocity, torque], resolution)
    told = maker.parse_registers(frame).command
    mine = parse(answer_with(frame)).values
    assert list(told) == list(mine)
    for register, value in told.items():
        assert mine[register] == pytest.approx(value, rel=1e-12, abs=1e-15, nan_ok=True)
    by_maker = maker.Controller(id=1, position_resolution=resolutions(maker, resolution))
    command = by_maker.make_position(position=position, velocity=velocity, feedforward_torque=torque)
    there = parse(answer_with(command.data[3:])).values  # behind the mode
    for register, value in there.items():  # the maker's encoder cuts off what this one rounds
        count = 0.0 if resolution is Resolution.FLOAT else SCALES[register][resolution]
        assert mine[register] == pytest.approx(value, rel=1e-6, abs=1.0000001 * count, nan_ok=True)


def resolutions(maker, resolution):
    made = maker.PositionResolution()
    made.position = made.velocity = made.feedforward_torque = int(resolution)
    return made


def test_mutated_frames_are_refused_or_read_as_the_maker_reads_them(maker):
    draw, bench = random.Random(11), MoteusBench()
    shaft = bench.shaft
    question = (
        read(0, 5) + read(0x0D, 3, Resolution.INT16) + read(0x20, 3, Resolution.INT32) + read(0x100, 3, Resolution.INT8)
    )
    taken = 0
    for _ in range(MUTANTS):
        shaft.angle, shaft.velocity = draw.uniform(-9, 9), draw.uniform(-50, 50)
        [whole] = bench.far.receive(FdFrame(TO_DRIVE, pad(question)), 0.0)
        mutant = mutate(draw, whole.data)
        try:
            mine = parse(mutant)
        except ValueError:
            continue
        if mine.text is not None:
            continue
        taken += 1
        seen = maker.parse_registers(mutant)
        assert list(mine.values) == list(seen.response)
        for register, value in seen.response.items():
            if register != Register.PWM_PHASE_A:  # which the package leaves unscaled, against its document
                assert mine.values[register] == pytest.approx(float(value), rel=1e-12, nan_ok=True)
        assert mine.errors == dict(seen.errors)
    assert 0.1 * MUTANTS < taken < 0.9 * MUTANTS


class EmulatedTransport:
    """What the maker's controller sends its commands through, with the emulator at the other end."""

    def __init__(self, maker, far, now):
        self._maker, self._far, self._now = maker, far, now

    async def cycle(self, commands, request_attachments=False):
        results = []
        for command in commands:
            source = command.source | (0x80 if command.reply_required else 0)
            data = pad(command.data)
            for reply in self._far.receive(FdFrame(source << 8 | command.destination, data), self._now()):
                message = self._maker.Frame(arbitration_id=reply.identifier, data=reply.data)
                if command.reply_filter is None or command.reply_filter(message):
                    results.append(command.parse(message))
        return results

    async def read(self, channel=None):
        await asyncio.sleep(3600)


def test_the_makers_controller_drives_the_emulator(maker):
    bench = MoteusBench()
    shaft, far, now = bench.shaft, bench.far, [0.0]
    wanted = maker.QueryResolution()
    wanted.q_current = maker.F32
    controller = maker.Controller(
        id=NODE, query_resolution=wanted, transport=EmulatedTransport(maker, far, lambda: now[0])
    )

    async def session():
        shaft.angle, shaft.velocity = 1.5, -3.0
        await controller.set_stop()
        ask = {"position": math.nan, "kp_scale": 0.0, "kd_scale": 0.0, "feedforward_torque": 0.6, "query": True}
        for _ in range(3):
            now[0] += 0.01
            state = await controller.set_position(watchdog_timeout=0.05, **ask)
        told = state.values
        assert told[maker.Register.MODE] == maker.Mode.POSITION
        assert told[maker.Register.POSITION] == pytest.approx(1.5 / (2 * math.pi), rel=1e-6)
        assert told[maker.Register.VELOCITY] == pytest.approx(-3.0 / (2 * math.pi), rel=1e-6)
        assert told[maker.Register.Q_CURRENT] == pytest.approx(1.0, rel=1e-6)
        assert told[maker.Register.TORQUE] == pytest.approx(CONSTANT, rel=1e-6)
        assert told[maker.Register.VOLTAGE] == 29.5
        assert shaft.following == ("current", pytest.approx(math.sqrt(1.5)))
        now[0] += 0.051
        far.tick(now[0])
        state = await controller.set_position(**ask)
        assert state.values[maker.Register.MODE] == maker.Mode.TIMEOUT
        await controller.set_stop()
        state = await controller.query()
        assert state.values[maker.Register.MODE] == maker.Mode.STOPPED
        far.fault(0x2340)
        state = await controller.query()
        assert (state.values[maker.Register.MODE], state.values[maker.Register.FAULT]) == (maker.Mode.FAULT, 33)

    asyncio.run(session())


def test_the_makers_text_channel_and_this_one_say_the_same(maker):
    bench = MoteusBench()
    controller = maker.Controller(id=NODE, transport=EmulatedTransport(maker, bench.far, lambda: 0.0))
    stream = maker.Stream(controller, use_flow_control=False)

    async def session():
        assert float(await stream.command(b"conf get servo.timeout_mode", allow_any_response=True)) == 12
        assert await stream.command(b"conf set servo.timeout_mode 15") == b""
        assert float(await stream.command(b"conf get motor.Kv", allow_any_response=True)) == pytest.approx(
            13.783, rel=1e-4
        )
        with pytest.raises(maker.CommandError):
            await stream.command(b"conf set servo.nothing 15")

    asyncio.run(session())
    assert bench.far.parameters["servo.timeout_mode"] == 15
    here = controller.make_diagnostic_write(b"conf get motor.Kv\n")
    assert here.data == text_to_device(1, b"conf get motor.Kv\n")
    assert controller.make_diagnostic_read().data == poll_for_text(1, 48)


def test_the_maker_prints_the_serial_number_in_the_same_form(maker):
    tool = pytest.importorskip("moteus.moteus_tool")
    far = MoteusEmulator(NODE, Shaft())
    assert tool._base64_serial_number(*far.words) == far.serial_number
    far.serial_number = "AAAAAAAAAAAAAAAB"
    assert far.words == [0, 0, 1]
    far.serial_number = "no serial number"
    assert far.words == [0, 0, 1]


def test_modes_have_the_makers_numbers(maker):
    assert {int(mode) for mode in maker.Mode} <= set(MODES)
    names = {register.name: register for register in maker.Register}
    own = {"COMMAND_MAX_TORQUE": "COMMAND_POSITION_MAX_TORQUE"}
    assert all(names[own.get(register.name, register.name)] == register for register in Register)
