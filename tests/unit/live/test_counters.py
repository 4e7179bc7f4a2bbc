"""A sink's counters: percentiles, and attempts of which none raises and a fault is logged once."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.live.counters import SinkCounters


def fails(error: Exception) -> None:
    raise error


def test_percentiles_are_known_to_half_a_millisecond() -> None:
    counters = SinkCounters("sink", "sent")
    assert np.isnan(counters.latency(0.5))
    latencies = np.random.default_rng(0).exponential(0.02, 5000)
    for latency in latencies:
        counters.sent(float(latency))
    for share in (0.5, 0.99):
        assert 0 <= counters.latency(share) - np.quantile(latencies, share, method="inverted_cdf") <= 0.5e-3
    counters.sent(1e9)
    assert counters.latency(1.0) == np.inf
    assert counters.published == 5001


def test_a_fault_costs_one_and_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    done: list[int] = []
    counters = SinkCounters("sink", "drawn", OSError)
    assert not counters.attempt(fails, ValueError("odd"))
    assert not counters.attempt(fails, ValueError("odd"))
    assert counters.attempt(done.append, 1)
    assert (done, counters.failure) == ([1], None)
    assert caplog.text.count("sink: a prediction could not be drawn") == 1


def test_after_a_fatal_one_nothing_more_is_tried(caplog: pytest.LogCaptureFixture) -> None:
    done: list[int] = []
    counters = SinkCounters("sink", "written", OSError)
    assert not counters.attempt(fails, OSError("disc full"))
    assert not counters.attempt(done.append, 1)
    counters.fail(OSError("later"))
    assert (done, counters.failure) == ([], "sink: disc full")
    assert caplog.text.count("nothing more is written") == 1
    assert "later" not in caplog.text


def test_without_fatal_errors_it_goes_on() -> None:
    counters = SinkCounters("sink", "sent")
    assert not counters.attempt(fails, OSError("away"))
    assert counters.attempt(int)
    assert counters.failure is None
