"""Tasks in this process: order, arguments that stand for results, threads, seeds."""

from __future__ import annotations

import gc
import operator
import pickle
import weakref

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from kinecast.errors import ClusterError, DatasetError, KinecastError, MissingExtraError
from kinecast.tasks import Serial, generator, scatter


def test_a_task_may_need_others_alone_or_in_a_list() -> None:
    workers, told = Serial(), list[tuple[int, int]]()
    two = workers.submit(scatter, 2)
    five = workers.submit(operator.add, two, 3)
    total = workers.submit(sum, [two, five, 10])
    assert workers.results([total, two], lambda *now: told.append(now)) == [17, 2]
    assert told == [(1, 3), (2, 3), (3, 3)]
    again = workers.submit(operator.mul, total, total)  # of tasks that are done
    assert workers.results([again]) == [289]


def test_a_task_that_fails_raises_what_it_raised_and_the_next_ones_go_on() -> None:
    workers = Serial()
    failing = workers.submit(operator.truediv, 1, 0)
    with pytest.raises(ZeroDivisionError):
        workers.results([failing])
    assert workers.results([workers.submit(scatter, 1)]) == [1]


def test_arguments_are_let_go_once_a_task_is_done() -> None:
    array = np.ones(3)
    held = weakref.ref(array)
    workers = Serial()
    task = workers.submit(np.sum, array)
    del array
    assert workers.results([task]) == [3.0]
    gc.collect()
    assert held() is None


def test_linear_algebra_of_a_task_has_one_thread_and_the_program_its_own() -> None:
    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    workers = Serial()
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        assert workers.results([workers.submit(threads)]) == [{1}]
        assert threads() == before


def test_random_numbers_depend_on_seed_and_place_alone() -> None:
    places = [(0,), (1,), (0, 0), (0, 1), (1, 0)]
    drawn = {(seed, place): generator(seed, *place).random(4).tobytes() for seed in (0, 1) for place in places}
    assert len(set(drawn.values())) == len(drawn)
    assert drawn[1, (0, 1)] == generator(1, 0, 1).random(4).tobytes()


@pytest.mark.parametrize(
    "error",
    [DatasetError("a.csv, line 7", "no number"), MissingExtraError("clusters", "cluster"), ClusterError("gone")],
)
def test_errors_travel_whole(error: KinecastError) -> None:
    there = pickle.loads(pickle.dumps(error))
    assert type(there) is type(error)
    assert str(there) == str(error)
    assert there.__dict__ == error.__dict__
