"""Answers that come late, not at all or twice: a row holds what the drive sampled at its own SYNC, or NaN."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from .elmo_bench import EMPTY, FRESH, ElmoBench, ages_of
from .failing import CountingDrive
from .transports import CanInProcess

LEAST_AGE_S = 0.05  # for which the supervisor lets a drive's readings stay away


class Link:
    """A host and its drive with a link between them that holds answers up and loses them."""

    def __init__(self, period, stalls=(), lost=()):
        self.period, self.stalls, self.lost = period, stalls, set(lost)
        wire = CanInProcess()
        self.far = CountingDrive(wire.wire)
        wire.drive = lambda _node: self.far
        self.bench = ElmoBench(wire=wire)
        self.bench.drive.open()
        self.bench.cycle(period)
        self.start, self.first = wire.clock.now(), self.far.number + 1
        self.delayed = 0
        wire.wire.disturb(self._passes)

    def _passes(self, frame, device):
        if device is None or not 0x180 < frame.identifier < 0x300:
            return 0.0
        if self.far.number - self.first in self.lost:
            return None
        now = self.bench.clock.now() - self.start
        late = max((end - now for begin, end in self.stalls if begin <= now < end), default=0.0)
        self.delayed += late > 0.0
        return late

    def ages(self, cycles):
        """How many SYNCs old each cycle's current, velocity and angle are; None where the row leaves them out."""
        ages = []
        for _ in range(cycles):
            row = self.bench.cycle(self.period, answer_s=max(0.6 * self.period, 0.002))
            ages.append(ages_of(row, self.far.number))
        return ages

    def close(self):
        self.bench.drive.close()


@pytest.fixture
def make_link():
    """Make links, which are let go at the end."""
    made = []

    def make(*arguments, **options):
        made.append(Link(*arguments, **options))
        return made[-1]

    yield make
    for link in made:
        link.close()


def longest_empty(ages):
    longest = run = 0
    for age in ages:
        run = run + 1 if age != FRESH else 0
        longest = max(longest, run)
    return longest


@pytest.mark.parametrize("rate", [1000, 500, 100, 67, 60, 50, 30])
def test_an_answer_that_is_lost_empties_rows_for_less_than_the_supervisor_waits(make_link, rate):
    link = make_link(1 / rate, lost=[20])
    ages = link.ages(200)
    assert set(ages) == {FRESH, EMPTY}
    assert ages[:20] == [FRESH] * 20 and ages[20] == EMPTY
    # looked at when the last of them ends, which is that many periods after the last reading
    assert longest_empty(ages) / rate < max(LEAST_AGE_S, 3 / rate)
    assert ages[-100:] == [FRESH] * 100
    assert link.bench.drive._answers.irregular.lost == 2
    assert any("2 were lost" in text for text in link.bench.drive.notices())


@pytest.mark.parametrize("rate", [1000, 500, 100, 50])
def test_one_stall_leaves_no_row_stale_and_is_over_when_it_is_over(make_link, rate):
    for stall_ms in (0.5, 1, 2, 5, 10, 15, 20, 35, 50):
        link = make_link(1 / rate, stalls=[(0.1, 0.1 + 1e-3 * stall_ms)])
        ages = link.ages(round(0.3 * rate))
        assert set(ages) <= {FRESH, EMPTY}, stall_ms
        assert ages[-round(0.1 * rate) :] == [FRESH] * round(0.1 * rate), stall_ms


@settings(max_examples=60, deadline=None)
@given(
    rate=st.sampled_from([1000, 500, 200, 100, 50]),
    gaps=st.lists(st.tuples(st.floats(0.0005, 0.12), st.floats(0.0005, 0.05)), min_size=1, max_size=8),
    lost=st.lists(st.integers(5, 300), max_size=4),
)
def test_no_course_of_stalls_and_losses_makes_a_row_stale(rate, gaps, lost):
    stalls, now = [], 0.01
    for gap, length in gaps:
        stalls.append((now + gap, now + gap + length))
        now += gap + length
    link = Link(1 / rate, stalls=stalls, lost=lost)
    ages = link.ages(min(1500, round((now + 0.3) * rate)))
    link.close()
    assert {each for age in ages for each in age} <= {0, None}


@pytest.mark.parametrize("rate", [1000, 500, 100, 50])
def test_of_thousands_of_cycles_with_random_stalls_no_row_is_stale_and_each_late_answer_counts(make_link, rate):
    draw, stalls, now = random.Random(rate), [], 0.0
    cycles = 6000
    while now < cycles / rate:
        begin = now + draw.expovariate(1 / 0.2)
        stalls.append((begin, begin + draw.uniform(0.0005, 0.05)))
        now = stalls[-1][1]
    link = make_link(1 / rate, stalls=stalls)
    ages = link.ages(cycles)
    assert set(ages) <= {FRESH, EMPTY}
    irregular = link.bench.drive._answers.irregular
    empty = 2 * ages.count(EMPTY)
    assert empty > 0
    # each answer that came after its cycle was late, or lost and then too many
    assert irregular.late + irregular.surplus <= link.delayed
    assert irregular.surplus <= irregular.lost


@pytest.mark.parametrize(("identifier", "unasked"), [(0x181, 0), (0x281, 1)])
@pytest.mark.parametrize("rate", [1000, 100])
def test_an_answer_that_comes_twice_makes_no_row_stale(make_link, rate, identifier, unasked):
    link = make_link(1 / rate)
    link.ages(round(1.2 * rate))  # watched for a second after it was opened
    while link.bench.drive._answers.watched:
        link.ages(1)
    bus = link.bench.port.bus
    for frame in [frame for frame in link.far.last_answers if frame.identifier == identifier]:
        bus.arrived.append(frame)  # as a CAN controller does after a disturbed end of frame
    assert link.ages(200) == [FRESH] * 200
    assert [f"{unasked} came unasked" in text for text in link.bench.drive.notices()] == [True] * unasked


def test_answers_that_all_come_twice_are_noticed_at_the_next_heartbeat(make_link):
    link = make_link(0.001)
    link.ages(1100)
    bus = link.bench.port.bus
    bus.arrived.extend(link.far.last_answers)
    ages = link.ages(200)
    stale = [age for age in ages if age not in (FRESH, EMPTY)]
    assert len(stale) <= 34  # cycles between two heartbeats of the host, a third of 100 ms apart
    assert ages[-100:] == [FRESH] * 100
    assert any("2 came unasked" in text for text in link.bench.drive.notices())
