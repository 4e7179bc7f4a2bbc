"""Every command as a user would run it, on generated tables, and on real recordings where they are there."""

from __future__ import annotations

import copy
import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import redirect_stdout
from importlib import resources
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.generated_people import SyntheticOptions, generate, table_scene

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.cli import progress
from kinecast.cli.commands import run
from kinecast.datasets import table
from kinecast.datasets.loading import load, shipped_clips
from kinecast.datasets.recording import differences
from kinecast.datasets.table import read_rows
from kinecast.geometry.scene import Scene
from kinecast.prediction.methods import METHODS, SHIPPED, read_method
from kinecast.types import Status

from .conftest import leave_undrawn

EXAMPLES = Path(__file__).parents[2] / "examples"

QUICK = ("--stride", 25, "--repeats", 2, "--samples", 40)

FILES = ["metrics.json", "prediction.gif", "prediction.png", "report.html"]
LEVELS = {"0.5", "0.8", "0.9", "0.95", "0.99"}

Kinecast = Callable[..., Any]


@pytest.fixture(scope="module")
def evaluated(
    tables: tuple[Path, Path], model: Path, scene_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str]:
    """The folder of an evaluation, and what it printed."""
    out = tmp_path_factory.mktemp("results")
    command = ("evaluate", "--model", model, "--test", tables[1], "--scene", scene_file, "--out", out, *QUICK)
    with redirect_stdout(StringIO()) as said, pytest.MonkeyPatch.context() as patch:
        leave_undrawn(patch)
        run([str(argument) for argument in command])
    return out, said.getvalue()


@pytest.fixture
def evaluation(evaluated: tuple[Path, str]) -> Path:
    """The folder."""
    return evaluated[0]


DEMO = """
from functools import partial
import kinecast.cli.commands, kinecast.cli.evaluate as command, kinecast.evaluation.report as report
from kinecast.cli import main
command.evaluate = partial(command.evaluate, stride=25)
report.FILM = 0.1
main()
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a demo with a fifth of its windows and a short film, and what it printed.

    In a process of its own: checking types takes several times as long.
    """
    out = tmp_path_factory.mktemp("results") / "new" / "demo"
    command = [sys.executable, "-c", DEMO, "demo", "--out", str(out)]
    return out, subprocess.run(command, capture_output=True, text=True, check=True).stdout


def scores(folder: Path) -> dict[str, Any]:
    """What metrics.json holds, without times."""
    metrics: dict[str, Any] = copy.deepcopy(json.loads((folder / "metrics.json").read_text()))
    for method in metrics["methods"].values():
        del method["latency_ms"]
    return metrics


class TestHelp:
    def test_lists_the_commands_one_after_another(self, kinecast: Kinecast) -> None:
        outcome = kinecast("--help")
        assert outcome.code == 0
        assert re.findall(r"• (\w+)", outcome.out) == [
            "demo",
            "info",
            "convert",
            "download",
            "train",
            "evaluate",
            "predict",
            "live",
            "calibrate",
            "simulate",
            "robot",
        ]

    @pytest.mark.parametrize("command", ["train", "evaluate"])
    def test_says_what_every_method_is(self, kinecast: Kinecast, command: str) -> None:
        text = kinecast(command, "--help").out
        assert re.findall(r"• (\w+): ", text) == list(METHODS)
        assert "None}" not in text

    def test_version(self, kinecast: Kinecast) -> None:
        assert re.fullmatch(r"kinecast \d+\.\d+\.\d+\n", kinecast("--version").out)


class TestInfo:
    def test_of_a_table(self, kinecast: Kinecast, tables: tuple[Path, Path]) -> None:
        outcome = kinecast("info", *tables)
        assert (outcome.code, outcome.err) == (0, "")
        first, second = outcome.out.split("\n\n")
        assert first.startswith("synthetic/pick_and_place/0-0: ")
        assert second.startswith("synthetic/pick_and_place/1-0: ")
        assert "150 frames, 5.0 s at 30 Hz" in first
        assert re.search(r"left_forearm: \d{3} mm", first)
        assert "labels: " in first

    def test_as_json(self, kinecast: Kinecast, tables: tuple[Path, Path]) -> None:
        (summary,) = json.loads(kinecast("info", tables[0], "--json").out)
        assert summary["frames"] == 150
        assert set(ARM_JOINTS) <= set(summary["joint_names"])
        assert 0.2 < summary["bones"]["left_forearm"]["median"] < 0.3

    @pytest.mark.parametrize(
        ("path", "names", "facts"),
        [
            ("human_robot_animations/TossTheCan/0.csv.xz", ["TossTheCan/0"], "vicon, 2123 frames, 21.2 s at 100 Hz"),
            ("ha4m_features_demo/UpSkel", ["IDU001V001", "IDU001V002"], "ha4m-features, 2427 frames, 80.9 s at 30 Hz"),
            ("human_assembly_data/Task1/Human2/trial2.txt.gz", ["trial2"], "lego, 855 frames, 28.5 s at 30 Hz"),
            (
                "kth_handover_sample",
                ["handover_sample/giver", "handover_sample/taker"],
                "kth-handover, person giver, 801 frames, 6.7 s at 120 Hz",
            ),
        ],
    )
    def test_of_each_real_format(
        self, kinecast: Kinecast, data_root: Path, path: str, names: list[str], facts: str
    ) -> None:
        outcome = kinecast("info", data_root / path)
        assert (outcome.code, outcome.err) == (0, "")
        parts = outcome.out.split("\n\n")
        assert [part.partition(":")[0].endswith(name) for part, name in zip(parts, names, strict=True)]
        assert facts in parts[0]


class TestTrain:
    def test_writes_a_model_and_says_so(self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
        out = tmp_path / "model.npz"
        options = ("--method", "damped_velocity", "--rate", 15, "--window", 0.4, "--horizon", 0.6, "--seed", 4)
        outcome = kinecast("train", *tables, *options, "--out", out)
        card, method = read_method(out)
        assert (card.rate, card.frames, card.steps, card.seed) == (15.0, 6, 9, 4)
        assert (method.frames, method.steps) == (6, 9)
        assert card.trained_on == ("synthetic/pick_and_place/0-0", "synthetic/pick_and_place/1-0")
        assert outcome.out == f"{out}: damped_velocity, trained on {card.windows} windows of 2 recordings\n"
        assert outcome.err == ""
        assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]

    def test_one_action_alone(self, kinecast: Kinecast, tmp_path: Path) -> None:
        (recording,) = generate(SyntheticOptions(subjects=1, recordings=1, duration=12.0), seed=1)
        table.write(tmp_path / "person.csv", [recording])
        for name, options in (("all", ()), ("carrying", ("--label", "Ca"))):
            out = tmp_path / f"{name}.npz"
            kinecast("train", tmp_path / "person.csv", "--method", "zero_velocity", "--out", out, *options)
        everything, carrying = (read_method(tmp_path / f"{name}.npz")[0] for name in ("all", "carrying"))
        assert (everything.label, carrying.label) == ("", "Ca")
        assert recording.labels is not None
        assert carrying.windows <= recording.labels.count("Ca") < everything.windows


class TestDemo:
    def test_leaves_four_files_and_no_other(self, demo: tuple[Path, str]) -> None:
        out, said = demo
        assert sorted(path.name for path in out.iterdir()) == FILES
        assert [path.name for path in out.parent.iterdir()] == ["demo"]
        assert [path.name for path in out.parent.parent.iterdir()] == ["new"]
        assert f"pictures: {out / 'prediction.png'}, {out / 'prediction.gif'}" in said

    def test_scores_the_clips_of_real_people(self, demo: tuple[Path, str]) -> None:
        metrics = json.loads((demo[0] / "metrics.json").read_text())
        assert sorted(metrics["settings"]["test"]) == sorted(clip.name for clip in shipped_clips())
        assert tuple(metrics["methods"]) == SHIPPED
        errors = {name: method["mpjpe_mm"] for name, method in metrics["methods"].items()}
        assert errors["kinecast"] < errors["damped_velocity"] < errors["zero_velocity"]
        assert metrics["methods"]["kinecast"]["violations"] == {"position": 0.0, "speed": 0.0, "scene": 0.0}

    def test_the_report_needs_nothing_else(self, demo: tuple[Path, str]) -> None:
        page = (demo[0] / "report.html").read_text()
        assert "gp_constrained" in page
        assert "<script" not in page
        assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
        assert not re.findall(r"url\((?!#)|@import", page)
        assert page.count("data:image/png;base64,") == page.count("data:image/gif;base64,") == 1


class TestEvaluate:
    def test_metrics_have_the_documented_form(self, evaluation: Path) -> None:
        metrics = json.loads((evaluation / "metrics.json").read_text())
        assert set(metrics) == {"settings", "methods", "ground_truth_violations"}
        assert set(metrics["ground_truth_violations"]) == {"position", "speed", "scene"}
        settings = metrics["settings"]
        assert (settings["rate"], settings["window"], settings["horizon"]) == (30.0, 0.2, 0.5)
        assert (settings["stride"], settings["seed"], settings["label"]) == (25, 0, None)
        assert settings["scene"] == "generated_table.yaml"
        assert settings["train"] == ["synthetic/pick_and_place/0-0"]
        assert settings["test"] == ["synthetic/pick_and_place/1-0"]
        (name,) = metrics["methods"]
        assert name == "kalman_constrained"
        method = metrics["methods"][name]
        for key in ("mpjpe_mm", "mpjpe_mm_stderr", "moving_mpjpe_mm", "wrist_final_mm", "nll", "kde_nll", "crps_mm"):
            assert isinstance(method[key], float), key
        assert isinstance(method["energy_score_mm"], float)
        assert len(method["mpjpe_mm_by_step"]) == 15
        assert np.mean(method["mpjpe_mm_by_step"]) == pytest.approx(method["mpjpe_mm"])
        assert set(method["coverage"]) == LEVELS
        assert set(method["violations"]) == {"position", "speed", "scene"}
        assert set(method["latency_ms"]) == {"p50", "p99"}
        assert 0 < method["latency_ms"]["p50"] <= method["latency_ms"]["p99"]
        assert 0 < method["accepted_fraction"] <= 1
        (recording,) = method["recordings"].values()
        assert set(recording) == {"windows", "mpjpe_mm", "crps_mm", "nll", "coverage"}
        assert set(recording["coverage"]) == LEVELS
        assert recording["windows"] == settings["windows"]
        assert recording["mpjpe_mm"] == pytest.approx(method["mpjpe_mm"])

    def test_a_constrained_method_keeps_every_limit(self, evaluation: Path) -> None:
        method = json.loads((evaluation / "metrics.json").read_text())["methods"]["kalman_constrained"]
        assert method["violations"] == {"position": 0.0, "speed": 0.0, "scene": 0.0}

    def test_prints_the_table_and_where_the_report_is(self, evaluated: tuple[Path, str]) -> None:
        out, said = evaluated
        assert "MPJPE" in said
        assert re.search(r"^ kalman_constrained +\d+\.\d ± \d+\.\d ", said, re.MULTILINE)
        assert said.endswith(f"\nreport: {out / 'report.html'}\n")

    @pytest.mark.usefixtures("no_drawing")
    def test_training_here_or_beforehand_is_the_same_and_seeds_decide(
        self, kinecast: Kinecast, tables: tuple[Path, Path], evaluation: Path, scene_file: Path, tmp_path: Path
    ) -> None:
        common = ("--test", tables[1], "--scene", scene_file, *QUICK)
        trained = ("evaluate", "--train", tables[0], "--methods", "zero_velocity, kalman_constrained", *common)
        kinecast(*trained, "--out", tmp_path / "same")
        kinecast(*trained, "--out", tmp_path / "other", "--seed", 1)
        before, same, other = scores(evaluation), scores(tmp_path / "same"), scores(tmp_path / "other")
        assert list(same["methods"]) == ["zero_velocity", "kalman_constrained"]
        assert same["methods"]["kalman_constrained"] == before["methods"]["kalman_constrained"]
        assert same["ground_truth_violations"] == before["ground_truth_violations"]
        assert same["settings"] | {"models": before["settings"]["models"]} == before["settings"]
        crps = [each["methods"]["kalman_constrained"]["crps_mm"] for each in (same, other)]
        assert crps[0] != crps[1]
        assert crps[0] == pytest.approx(crps[1], rel=0.2)

    @pytest.mark.usefixtures("no_drawing")
    def test_a_model_brings_its_rate_and_horizon(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        model, out = tmp_path / "slow.npz", tmp_path / "results"
        rate = ("--rate", 15, "--window", 0.4, "--horizon", 1.0)
        kinecast("train", tables[0], "--method", "zero_velocity", *rate, "--out", model)
        assert kinecast("evaluate", "--model", model, "--test", tables[1], "--out", out, *QUICK).code == 0
        metrics = scores(out)
        assert [metrics["settings"][key] for key in ("rate", "window", "horizon")] == [15.0, 0.4, 1.0]
        assert len(metrics["methods"]["zero_velocity"]["mpjpe_mm_by_step"]) == 15

    @pytest.mark.usefixtures("no_drawing")
    def test_models_of_one_method_are_told_apart(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        models = [tmp_path / "a" / "model.npz", tmp_path / "b" / "model.npz"]
        for model, recording in zip(models, tables, strict=True):
            model.parent.mkdir()
            kinecast("train", recording, "--method", "zero_velocity", "--out", model)
        outcome = kinecast("evaluate", "--model", *models, "--test", tables[1], "--out", tmp_path / "results", *QUICK)
        assert list(scores(tmp_path / "results")["methods"]) == ["zero_velocity #1", "zero_velocity #2"]
        assert "trained on recordings of these names" in outcome.err
        assert "synthetic/pick_and_place/1-0" in outcome.err

    @pytest.mark.usefixtures("no_drawing")
    def test_taken_apart_stage_by_stage(
        self, kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path
    ) -> None:
        shipped = resources.files("kinecast") / "data" / "models" / "kinecast.npz"
        options = ("--test", tables[1], "--ablate", "--stride", 30, "--samples", 50, "--repeats", 0)
        assert kinecast("evaluate", "--model", shipped, "--out", tmp_path / "whole", *options).code == 0
        methods = scores(tmp_path / "whole")["methods"]
        assert list(methods)[-1] == "kinecast"
        errors = {name.removeprefix("kinecast, "): each["mpjpe_mm"] for name, each in methods.items()}
        assert {"no gate", "no regression", "no memory", "no network", "no adaptive spread"} < set(errors)
        assert all(errors[name] != errors["kinecast"] for name in ("no gate", "no memory", "no network"))
        assert methods["kinecast, no limits, no scene"]["mpjpe_mm"] == methods["kinecast"]["mpjpe_mm"]
        nothing = kinecast("evaluate", "--model", model, "--out", tmp_path / "none", *options)
        assert nothing.code == 2
        assert "kinecast" in nothing.err
        assert not (tmp_path / "none").exists()

    @pytest.mark.usefixtures("no_drawing")
    def test_test_recordings_are_left_out_of_training(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        out = tmp_path / "results"
        options = ("--methods", "zero_velocity", "--out", out, *QUICK)
        outcome = kinecast("evaluate", "--train", *tables, "--test", tables[1], *options)
        assert scores(out)["settings"]["train"] == ["synthetic/pick_and_place/0-0"]
        assert "not trained on, because they are test recordings: synthetic/pick_and_place/1-0" in outcome.err

    @pytest.mark.usefixtures("no_drawing")
    def test_one_action_alone(self, kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path) -> None:
        labels = load(tables[1])[0].labels
        assert labels is not None
        options = ("--stride", 1, "--repeats", 0, "--samples", 20, "--label", "Pi", "--out", tmp_path / "results")
        kinecast("evaluate", "--model", model, "--test", tables[1], *options)
        settings = scores(tmp_path / "results")["settings"]
        assert settings["label"] == "Pi"
        assert 0 < settings["windows"] <= labels.count("Pi")


class TestCluster:
    """`--cluster` beside this process; several workers, and a killed one, are in tests/unit/test_cluster.py."""

    @pytest.mark.usefixtures("no_drawing")
    def test_scores_are_the_same_to_the_last_bit(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        command = ["evaluate", "--train", tables[0], "--test", tables[1], "--methods", "ridge", *QUICK]
        assert kinecast(*command, "--out", tmp_path / "here").code == 0
        outcome = kinecast(*command, "--out", tmp_path / "there", "--cluster", "local:1")
        assert (outcome.code, outcome.err) == (0, "kinecast: cluster local:1: 1 worker\n")
        assert scores(tmp_path / "there") == scores(tmp_path / "here")

    def test_a_place_that_is_none_is_refused(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        outcome = kinecast("train", tables[0], "--out", tmp_path / "a.npz", "--cluster", "local:none")
        assert outcome.code == 2
        assert "--cluster local:none: expected local, local:N" in outcome.err
        assert not list(tmp_path.iterdir())


class TestConvert:
    def test_a_table_through_mcap_and_back_is_the_same(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        outcome = kinecast("convert", tables[0], tmp_path / "a.mcap")
        assert (outcome.code, outcome.err) == (0, "")
        assert outcome.out.splitlines()[1:] == ["  nothing is lost"]
        assert kinecast("convert", tmp_path / "a.mcap", tmp_path / "b.csv").code == 0
        for before, after in zip(table.load(tables[0]), table.load(tmp_path / "b.csv"), strict=True):
            np.testing.assert_array_equal(after.positions, before.positions)
            assert (after.name, after.labels, after.notes) == (before.name, before.labels, before.notes)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "b.csv"]

    def test_what_json_lines_lose_is_printed_and_they_are_recordings(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        outcome = kinecast("convert", tables[0], tmp_path / "a.jsonl")
        lost = [line.split(":")[1].strip() for line in outcome.out.splitlines()[1:]]
        assert lost == ["name", "format", "subject", "task", "note"]
        assert "jsonl, 150 frames, 5.0 s at 30 Hz" in kinecast("info", tmp_path / "a.jsonl").out

    @pytest.mark.parametrize("ending", [".bag", ".rosbag2"])
    def test_a_bag_keeps_what_the_prediction_needs(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path, ending: str
    ) -> None:
        outcome = kinecast("convert", tables[0], tmp_path / f"a{ending}")
        assert outcome.code == 0, outcome.err
        lost = [line.split(":")[1].strip() for line in outcome.out.splitlines()[1:]]
        assert lost == ["name", "format", "subject", "task", "labels", "note", "stamps"]
        assert re.search(r"stamps: moved by up to [3-5]\S*e-10 s", outcome.out)
        assert "bag, 150 frames, 5.0 s at 30 Hz" in kinecast("info", tmp_path / f"a{ending}").out
        assert kinecast("convert", tmp_path / f"a{ending}", tmp_path / "b.csv").code == 0
        before, after = table.load(tables[0])[0], table.load(tmp_path / "b.csv")[0]
        np.testing.assert_array_equal(after.positions, before.positions)

    def test_orientations_of_a_vicon_take_are_said_to_be_lost(
        self, kinecast: Kinecast, data_root: Path, tmp_path: Path
    ) -> None:
        take = data_root / "human_robot_animations/TossTheCan/0.csv.xz"
        outcome = kinecast("convert", take, tmp_path / "take.parquet")
        assert outcome.out.splitlines()[1:] == ["  lost: rotations of the rigid bodies, which kinecast does not read"]
        assert differences(load(take), load(tmp_path / "take.parquet")) == []

    def test_nothing_is_replaced_unasked_and_nothing_is_left_of_a_failure(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        there = tmp_path / "a.csv"
        there.write_text("mine")
        refusals = {
            there: "is there already; --force replaces it",
            tmp_path / "a.bvh": "cannot be written; BVH holds the rotations",
            tmp_path / "a.xyz": "must end in .parquet or .csv or .mcap or .jsonl or .bag or .rosbag2",
            tables[0]: "is what is to be converted",
        }
        for target, reason in refusals.items():
            outcome = kinecast("convert", tables[0], target)
            assert outcome.code == 2
            assert reason in outcome.err
        many = kinecast("convert", tables[0].parent, tmp_path / "b.csv")
        assert "convert takes one" in many.err
        assert there.read_text() == "mine"
        assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
        assert kinecast("convert", tables[0], there, "--force").code == 0
        assert there.read_text() != "mine"
        (folder := tmp_path / "a.rosbag2").mkdir()
        assert "folders are never replaced" in kinecast("convert", tables[0], folder, "--force").err


class TestOwnMethod:
    """The method of examples/own_method.py, by name."""

    @pytest.fixture(autouse=True)
    def _found(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.syspath_prepend(EXAMPLES)

    @pytest.mark.usefixtures("no_drawing")
    def test_is_scored_beside_others(self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
        methods = "own_method:fit,zero_velocity"
        command = ["evaluate", "--train", tables[0], "--test", tables[1], "--methods", methods, *QUICK]
        outcome = kinecast(*command, "--out", tmp_path)
        assert outcome.code == 0
        found = scores(tmp_path)["methods"]
        assert list(found) == ["own_method:fit", "zero_velocity"]
        assert found["own_method:fit"]["mpjpe_mm"] < found["zero_velocity"]["mpjpe_mm"]
        assert 0.6 < found["own_method:fit"]["coverage"]["0.9"] <= 1.0

    def test_predicts_frame_by_frame(self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path) -> None:
        out = tmp_path / "out.parquet"
        assert kinecast("predict", tables[0], "--model", "own_method:trained", "--samples", 20, "--out", out).code == 0
        assert len(read_rows(out).stamp) > 100 * 15 * 6

    def test_one_that_is_not_there_is_named(
        self, kinecast: Kinecast, tables: tuple[Path, Path], tmp_path: Path
    ) -> None:
        outcome = kinecast("predict", tables[0], "--model", "own_method:no", "--out", tmp_path / "out.csv")
        assert (outcome.code, outcome.err) == (2, "kinecast: own_method:no: own_method has no function no\n")


class TestPredict:
    def test_every_frame_gets_its_rows(
        self, kinecast: Kinecast, tables: tuple[Path, Path], model: Path, tmp_path: Path
    ) -> None:
        out = tmp_path / "predictions.parquet"
        outcome = kinecast("predict", tables[1], "--model", model, "--out", out, "--samples", 30)
        assert outcome.code == 0
        rows, (recording,) = read_rows(out), load(tables[1])
        frames, steps = len(recording.stamps), 15
        assert rows.position.shape == (frames * steps * 6, 3)
        assert rows.made is not None
        made = rows.made.reshape(frames, steps, 6)
        assert np.array_equal(made[:, 0, 0], recording.stamps)
        assert (made == made[:, :1, :1]).all()
        ahead = rows.stamp.reshape(frames, steps, 6)[..., 0] - made[..., 0]
        assert ahead == pytest.approx(np.tile(np.arange(1, 16) / 30, (frames, 1)), abs=1e-9)
        assert rows.joint[:12].tolist() == [*ARM_JOINTS, *ARM_JOINTS]
        assert rows.label is not None
        statuses = rows.label.reshape(frames, -1)[:, 0]
        assert set(statuses) <= {status.name for status in Status}
        assert (statuses[:5] == "WARMING_UP").all()
        assert (statuses == "OK").mean() > 0.5
        for name in set(statuses):
            assert f"  {name}: {np.count_nonzero(statuses == name)}" in outcome.out
        ok = np.flatnonzero(statuses == "OK")
        ok = ok[ok < frames - 1]
        predicted = rows.position.reshape(frames, steps, 6, 3)[ok, 0]
        measured = np.stack([recording.joint(name) for name in ARM_JOINTS], axis=1)[ok + 1]
        assert np.nanmedian(np.linalg.norm(predicted - measured, axis=-1)) < 0.02
        assert rows.covariance is not None
        assert (rows.covariance.reshape(frames, -1, 6)[ok][..., [0, 3, 5]] > 0).all()

    def test_two_persons_at_once(self, kinecast: Kinecast, model: Path, data_root: Path, tmp_path: Path) -> None:
        recordings = [person.select(slice(0, 60)) for person in load(data_root / "kth_handover_sample")]
        table.write(tmp_path / "handover.parquet", recordings)
        out = tmp_path / "predictions.csv"
        options = ("--model", model, "--out", out, "--samples", 20)
        assert kinecast("predict", tmp_path / "handover.parquet", *options).code == 0
        rows = read_rows(out)
        assert set(rows.person) == {"giver", "taker"}
        assert rows.made is not None
        assert (np.diff(rows.made) >= 0).all()
        assert np.unique(rows.person, return_counts=True)[1].tolist() == [60 * 15 * 6, 60 * 15 * 6]


class TestCompiling:
    def test_is_said_where_it_takes_long_and_only_there(self, monkeypatch: pytest.MonkeyPatch) -> None:
        said, told = [], threading.Event()
        monkeypatch.setattr(progress, "note", lambda text: (said.append(text), told.set()))
        with progress.compiling():
            pass
        assert said == []
        monkeypatch.setattr(progress, "PATIENCE", 0.0)
        with progress.compiling():
            assert told.wait(60.0)
        assert said == ["compiling once for this machine ..."]


class TestScenes:
    def test_the_generated_table_is_the_generators(self, scene_file: Path) -> None:
        shipped, made = Scene.load(scene_file), table_scene()
        assert np.array_equal(shipped.rows(np.zeros(1)), made.rows(np.zeros(1)))
        assert set(shipped.goals) == set(made.goals)
        for name, goal in made.goals.items():
            assert vars(shipped.goals[name]).keys() == vars(goal).keys()
            for key, value in vars(goal).items():
                assert np.array_equal(vars(shipped.goals[name])[key], value)

    def test_real_hands_stay_above_the_ha4m_table_and_come_near_it(self, data_root: Path) -> None:
        scene = Scene.load(EXAMPLES / "scenes" / "ha4m_table.yaml")
        for clip in ("IDU001V001", "IDU001V002"):
            (recording,) = load(data_root / "ha4m_features_demo" / "UpSkel" / f"{clip}.npy")
            arms = np.stack([recording.joint(name) for name in ARM_JOINTS], axis=1)
            lowest = scene.clearance(arms, recording.stamps)
            assert 0.0 < lowest.min() < 0.12
            tips = np.stack([recording.joint("left_hand_tip"), recording.joint("right_hand_tip")])
            (table_top,) = scene.obstacles
            heights = table_top.signed_distance(tips)
            for hand in heights:  # fingers touch it, both hands', and do not go through
                assert abs(np.nanpercentile(hand, 1)) < 0.03

    @pytest.mark.usefixtures("no_drawing")
    def test_an_action_of_ha4m_at_its_table(self, kinecast: Kinecast, data_root: Path, tmp_path: Path) -> None:
        clips = data_root / "ha4m_features_demo" / "UpSkel"
        kinecast(
            *("evaluate", "--train", clips / "IDU001V001.npy", "--test", clips / "IDU001V002.npy"),
            *("--methods", "zero_velocity,kalman_constrained", "--label", "screws", "--stride", 20, "--samples", 50),
            *("--scene", EXAMPLES / "scenes" / "ha4m_table.yaml", "--repeats", 0, "--out", tmp_path / "results"),
        )
        metrics = scores(tmp_path / "results")
        assert metrics["settings"]["label"] == "screws"
        assert metrics["ground_truth_violations"]["scene"] == 0
        assert metrics["methods"]["kalman_constrained"]["violations"]["scene"] == 0
        assert 0 < metrics["settings"]["windows"] <= 265 / 20 + 1
