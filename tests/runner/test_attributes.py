"""What a cycle reads most keeps few attributes: with more, Python 3.11 to 3.13 keep them in a dictionary."""

from tests.benchmarks.test_control_cycle import rehearsal
from tests.benchmarks.two_drives import machine_of, prepared, request_in

MOST = 29  # that an object holds without one (CPython, SHARED_KEYS_MAX_SIZE less one)


def test_objects_of_the_cycle_keep_few_attributes(tmp_path):
    request = request_in(tmp_path, 1.0)
    loop, bench, writer, _progress = prepared(request, rehearsal(machine_of(request)), 0)
    kept = {type(item).__name__: len(vars(item)) for item in (loop, loop._supervisor, *bench.drives.values())}
    bench.close()
    writer.close("complete")
    assert {name: count for name, count in kept.items() if count > MOST} == {}
