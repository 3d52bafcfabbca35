"""An emulated bench is one thread: its buses answer inside the call, and rows are flushed from within the loop."""

import threading


def test_a_run_on_an_emulated_bench_starts_no_thread(spin, monkeypatch):
    started = []
    monkeypatch.setattr(threading.Thread, "start", started.append)
    outcome, _bench = spin()
    assert outcome.error is None
    assert started == []
