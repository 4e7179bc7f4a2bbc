"""Two worker processes give what this process gives, to the last bit, also when one of them is killed."""

from __future__ import annotations

import importlib
import json
import operator
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("distributed")

import dask
from benchmarks.generated_people import SyntheticOptions, generate
from distributed import LocalCluster

from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import ClusterError, DatasetError, OptionError
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import all_windows, training_windows
from kinecast.prediction.kinecast.experts import FeatureScale, arm_views
from kinecast.prediction.kinecast.objectives import fit_network
from kinecast.prediction.method import shortened
from kinecast.prediction.methods import shipped_methods, train
from kinecast.tasks import Cluster, Serial, Workers, cluster_at, scatter, worker_count


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    """Two workers; a task under which two die is given up, not one under which four do: each takes long to start."""
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}), cluster_at("local:2") as cluster:
        yield cluster


@pytest.fixture(scope="module")
def people() -> list[Recording]:
    return generate(SyntheticOptions(subjects=2, recordings=2, duration=2.5), seed=2)


class Killer:
    """Kills one worker process once, in the middle of the work."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self.victim: int | None = None
        self.counted: list[int] = []

    def __call__(self, done: int, total: int) -> None:
        self.counted.append(done)
        if self.victim is None and 3 * done >= total:
            self.victim = min(self._cluster.client.run(os.getpid).values())
            os.kill(self.victim, signal.SIGKILL)


def outcome(people: list[Recording], workers: Workers, progress: Any = None) -> tuple[dict[str, bytes], str]:
    """Arrays of trained methods, and their scores as text."""
    windows = training_windows(people[:2], WindowOptions(), workers=workers)
    methods = train(["ridge", "ridge_angles"], windows, 0, progress, workers)
    _, whole = shipped_methods()
    methods["kinecast"] = shortened(whole["kinecast"], 0.5)  # it follows the person; training it takes long
    arrays = {f"{name}.{key}": a.tobytes() for name, m in methods.items() for key, a in m.to_arrays().items()}
    recordings = TestRecording.of(people[2:], WindowOptions(stride=20), workers)
    options = EvaluationOptions(samples=20, repeats=2)
    scores, histograms = evaluate(methods, recordings, None, options, workers=workers)
    for score in scores["methods"].values():
        del score["latency_ms"]
    return arrays, json.dumps([scores, {name: again.tolist() for name, again in histograms.items()}])


def test_a_worker_killed_in_the_middle_changes_nothing(cluster: Cluster, people: list[Recording]) -> None:
    arrays, scores = outcome(people, Serial())
    killer = Killer(cluster)
    spread_arrays, spread_scores = outcome(people, cluster, killer)
    assert killer.victim is not None
    assert killer.counted == list(range(1, len(killer.counted) + 1))
    assert spread_arrays == arrays
    assert spread_scores == scores
    assert killer.victim not in cluster.client.run(os.getpid).values()


def test_descent_gives_the_same_network_everywhere(cluster: Cluster, people: list[Recording]) -> None:
    windows = training_windows(people[:1], WindowOptions())
    scale = FeatureScale.of(arm_views(windows.observed))
    task = (fit_network, scale, windows.observed, windows.future, 20, 0)
    spread, serial = cluster.submit(*task), Serial()  # at the same time: both compile
    [here], [there] = serial.results([serial.submit(*task)]), cluster.results([spread])
    assert here.to_arrays().keys() == there.to_arrays().keys()
    for name, array in here.to_arrays().items():
        np.testing.assert_array_equal(there.to_arrays()[name], array, err_msg=name)


def test_what_a_task_raises_is_raised_here(cluster: Cluster) -> None:
    bad = cluster.submit(all_windows, [], WindowOptions())
    with pytest.raises(DatasetError, match=r"no window of 0\.7 s"):
        cluster.results([bad])
    assert cluster.results([cluster.submit(operator.add, cluster.submit(scatter, 1), 2)]) == [3]


def test_a_task_that_kills_its_workers_is_given_up(cluster: Cluster) -> None:
    deadly = cluster.submit(os._exit, 1)
    with pytest.raises(ClusterError, match="workers died under the task exit"):
        cluster.results([deadly])


class Foreign:
    """Cannot be unpickled on a worker."""

    def __reduce__(self) -> tuple[Any, ...]:
        return importlib.import_module, ("no_such_module",)


def test_what_a_worker_lacks_is_said(cluster: Cluster) -> None:
    with pytest.raises(ClusterError, match="a worker lacks something: No module named 'no_such_module'"):
        cluster.results([cluster.submit(scatter, Foreign())])
    assert cluster.results([cluster.submit(scatter, 5)]) == [5]


def test_modules_of_the_users_own_travel(cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "only_here.py").write_text("factor = 3\ndef triple(x):\n    return factor * x\n")
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("only_here")
    monkeypatch.setattr("kinecast.tasks.CARRIED", {module})
    assert cluster.results([cluster.submit(module.triple, 14)]) == [42]


def test_without_workers_nothing_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    place = {"processes": False, "n_workers": 1, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**place) as local, cluster_at(local.scheduler_address) as emptied:
        monkeypatch.setattr("kinecast.tasks.PATIENCE", 0.2)
        local.scale(0)
        while emptied.client.scheduler_info(n_workers=-1)["workers"]:
            time.sleep(0.02)
        with pytest.raises(ClusterError, match="no worker is left; 1 tasks are not done"):
            emptied.results([emptied.submit(scatter, 1)])


def test_a_scheduler_has_an_address(cluster: Cluster) -> None:
    with cluster_at(cluster.client.scheduler.address) as same:
        assert same.results([same.submit(np.sum, np.ones(4))]) == [4.0]
    assert cluster.client.status == "running"


def test_workers_with_several_threads_are_refused() -> None:
    with (
        LocalCluster(processes=False, n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0") as unfit,
        pytest.raises(ClusterError, match="start workers with --nthreads 1"),
        cluster_at(unfit.scheduler_address),
    ):
        pass


@pytest.mark.parametrize("where", ["local:0", "local:-1", "local:x", "local:", "local:9999", "nonsense", ""])
def test_places_that_are_none_are_named(where: str) -> None:
    with pytest.raises(OptionError, match="expected local, local:N"):
        worker_count(where)


def test_places() -> None:
    assert worker_count("local:3") == 3
    assert (worker_count("local") or 0) >= 1
    assert worker_count("tls://example.org:8786") is None
