"""Scores of every method on fixed windows of every data set, and what they were when they were recorded.

python -m tests.accuracy.score            every score anew, compared with recorded.json
python -m tests.accuracy.score --record   writes recorded.json
python -m tests.accuracy.score --seed 7   with other random numbers

Everything goes through the command `kinecast evaluate` and the metrics.json it writes. Recordings are found in
$KINECAST_DATA, else in ../shared/data beside the checkout; without them the generated people alone are scored.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import io
import json
import math
import os
import statistics
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any
from unittest import mock

REPOSITORY = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("KINECAST_DATA", REPOSITORY.parent / "shared" / "data"))
RECORDED = Path(__file__).with_name("recorded.json")
SCENES = REPOSITORY / "examples" / "scenes"

MODELS = ("zero_velocity", "damped_velocity", "gp_constrained", "kinecast")
"""The shipped models."""
BASELINES = ("zero_velocity", "constant_velocity", "damped_velocity", "kalman", "ridge")
PAPER = ("gp_xyz", "gp_angles", "gp_constrained")
CONSTRAINED = ("gp_constrained", "kinecast")
"""Methods none of whose samples may break a range, a speed or the scene."""

SAMPLES = 100
"""Motions drawn per window: more windows tell more than more samples do, at the same cost."""
SEEDS = (0, 1, 2, 3, 4, 5)
"""Of the runs that are recorded: their mean, and how far apart they are."""

TOLERANCES = {"mpjpe_mm": 0.2, "crps_mm": 0.1, "energy_mm": 0.2, "nll": 0.02, "coverage_50": 0.5, "coverage_90": 0.5}
"""How far a score may be from the recorded one: mm, nats per joint, per cent. The energy score has MPJPE's: of a
prediction without spread it is the MPJPE."""
SPREADS = 4.0
"""Where random numbers alone move a score more than that: so many standard deviations between seeds."""

Figures = dict[str, dict[str, float]]
"""By method, its scores by name."""


@dataclass(frozen=True)
class Run:
    """One evaluation.

    Attributes:
        test: files and folders below the data folder, by the entry that they count for; none for generated people.
        stride: frames between windows.
        train: files below the data folder that methods are fitted on; empty to score the shipped models.
        scene: obstacles and goals, a file.
        whole: name of an entry for all recordings of the run together, where it has several entries.
    """

    test: Mapping[str, tuple[str, ...]]
    stride: int
    train: tuple[str, ...] = ()
    scene: Path | None = None
    whole: str | None = None

    @property
    def generated(self) -> bool:
        """Whether it needs no recordings."""
        return not any(self.test.values())


RUNS = {
    "shipped": Run(
        {
            "human_robot_animations": (
                "human_robot_animations/TossTheCan/1.csv.xz",
                "human_robot_animations/PickPlaceCloseHuman/3.csv.xz",
            ),
            "human_assembly_data": (
                "human_assembly_data/Task2/Human1/trial2.txt.gz",
                "human_assembly_data/Task1/Human2/trial2.txt.gz",
            ),
            "kth_handover_sample": ("kth_handover_sample",),
            "ui_prmd_vicon": (
                "ui_prmd_vicon/s04/m04_s04_e06_incorrect.parquet",
                "ui_prmd_vicon/s03/m02_s03_e01_correct.parquet",
                "ui_prmd_vicon/s02/m02_s02_e09_incorrect.parquet",
                "ui_prmd_vicon/s01/m01_s01_e10_incorrect.parquet",
            ),
            "ui_prmd_kinect": (
                "ui_prmd_kinect/s04/m01_s04_e09_incorrect.parquet",
                "ui_prmd_kinect/s06/m07_s06_e10_incorrect.parquet",
                "ui_prmd_kinect/s01/m01_s01_e06_incorrect.parquet",
            ),
            "react_idle": ("react_idle/p003/003_genuine.parquet",),
            "precog": (
                "precog/p01/Seq1_1.parquet",
                "precog/p06/Seq2_6.parquet",
                "precog/p08/Seq3_8.parquet",
            ),
            "cmu": (
                "cmu/basketball/basketball_1_test.parquet",
                "cmu/basketball/basketball_4_train.parquet",
                "cmu/washwindow/washwindow_1_test.parquet",
            ),
            "mhad": (
                "mhad/s01/a09_s01_e04.parquet",
                "mhad/s01/a04_s01_e01.parquet",
                "mhad/s02/a03_s02_e01.parquet",
            ),
            "handover_zed": (
                "handover_zed/giver/motion_normal_0_giver.parquet",
                "handover_zed/giver/motion_variation_0_giver.parquet",
                "handover_zed/receiver/motion_variation_0_receiver.parquet",
            ),
        },
        stride=8,
        whole="all_recordings",
    ),
    "ha4m": Run({"ha4m": ("ha4m_features_demo/UpSkel/IDU001V001.npy",)}, stride=20),
    "ha4m_scene": Run(
        {"ha4m_scene": ("ha4m_features_demo/UpSkel/IDU001V002.npy",)}, stride=20, scene=SCENES / "ha4m_table.yaml"
    ),
    "fitted": Run(
        {"fitted": ("human_robot_animations/HumanRobotHandover/5.csv.xz",)},
        stride=2,
        train=(
            "human_robot_animations/HumanRobotHandover/0.csv.xz",
            "human_robot_animations/HumanRobotHandover/1.csv.xz",
        ),
    ),
    "generated": Run({"generated": ()}, stride=6),
    "generated_goals": Run({"generated_goals": ()}, stride=6, scene=Path(__file__).with_name("goals.yaml")),
}
"""By name; those of generated people need no recordings. Goals change what `kinecast` predicts, and nothing else."""


def scored_by(name: str) -> tuple[str, ...]:
    """Names of the methods that one of RUNS scores."""
    if RUNS[name].train:
        return (*BASELINES, *PAPER)
    return ("kinecast",) if name == "generated_goals" else MODELS


def model_file(name: str) -> Path:
    """The file of a shipped model."""
    return Path(str(resources.files("kinecast") / "data" / "models" / f"{name}.npz"))


def generated_people(folder: Path) -> list[Path]:
    """Writes generated people as tables, one file each."""
    from benchmarks.generated_people import SyntheticOptions, generate

    paths = []
    for number, person in enumerate(generate(SyntheticOptions(subjects=3, recordings=1, duration=14.0), seed=5)):
        path = folder / f"generated{number}.csv"
        with path.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(("stamp", "person", "joint", "x", "y", "z"))
            for stamp, positions in zip(person.stamps, person.positions, strict=True):
                for joint, place in zip(person.joints, positions, strict=True):
                    if all(map(math.isfinite, place)):
                        table.writerow((f"{stamp:.6f}", number, joint, *(f"{value:.4f}" for value in place)))
        paths.append(path)
    return paths


def fingerprint(paths: Sequence[Path]) -> str:
    """The same for the same files."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


def _blank(path: Path, *_: object) -> None:
    path.touch()


def _blank_page(_metrics: object, _histograms: object, folder: Path, _pictures: object) -> None:
    (folder / "report.html").touch()


def evaluated(*arguments: object) -> dict[str, Any]:
    """Runs `kinecast evaluate` in this process, with nothing drawn; what metrics.json holds."""
    from kinecast.cli.commands import run
    from kinecast.evaluation import report

    with tempfile.TemporaryDirectory() as folder:
        with (
            mock.patch.multiple(report, draw_prediction=_blank, animate_predictions=_blank, write_report=_blank_page),
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()) as said,
        ):
            try:
                run(["evaluate", *map(str, arguments), "--repeats", "0", "--out", str(Path(folder) / "out")])
            except SystemExit as end:
                raise RuntimeError(f"evaluate ended with {end.code}: {said.getvalue()}") from end
        content: dict[str, Any] = json.loads((Path(folder) / "out" / "metrics.json").read_text())
    return content


def scores(entry: Mapping[str, Any]) -> dict[str, float]:
    """The scores of one method, or of one recording, in metrics.json; those it has."""
    found = {"mpjpe_mm": entry["mpjpe_mm"], "crps_mm": entry["crps_mm"], "nll": entry["nll"]}
    found |= {f"coverage_{level}": 100 * entry["coverage"][f"0.{level // 10}"] for level in (50, 90)}
    if "energy_score_mm" in entry:
        found["energy_mm"] = entry["energy_score_mm"]
    if "violations" in entry:
        found |= {f"violations_{name}": entry["violations"][name] for name in ("position", "speed", "scene")}
    return found


def pooled(parts: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Scores of several recordings together, as if they were one."""
    total = sum(part["windows"] for part in parts)
    return {
        name: sum(part["windows"] * scores(part)[name] for part in parts) / total for name in scores(parts[0])
    }  # fmt: skip


def run(name: str, seed: int = 0, models: Sequence[Path] | None = None) -> dict[str, tuple[int, Figures]]:
    """One of RUNS.

    Args:
        name: which.
        seed: of everything random.
        models: files to score instead of those shipped.

    Returns:
        By entry, the number of windows and the scores of each method.
    """
    asked = RUNS[name]
    files = {entry: [DATA / path for path in paths] for entry, paths in asked.test.items()}
    with tempfile.TemporaryDirectory() as folder:
        if asked.generated:
            files = {name: generated_people(Path(folder))}
        options: list[object] = ["--stride", asked.stride, "--samples", SAMPLES, "--seed", seed]
        if asked.scene is not None:
            options += ["--scene", asked.scene]
        if asked.train:
            options += ["--methods", ",".join(scored_by(name)), "--train", *(DATA / path for path in asked.train)]
        else:
            options += ["--horizon", 0.5, "--model", *(models or map(model_file, scored_by(name)))]
        metrics = evaluated(*options, "--test", *(path for paths in files.values() for path in paths))
    windows = metrics["settings"]["windows"]
    together = {method: scores(entry) for method, entry in metrics["methods"].items()}
    if len(files) == 1:
        return {next(iter(files)): (windows, together)}
    found = {str(asked.whole): (windows, together)}
    for entry, names in _owners(files, list(next(iter(metrics["methods"].values()))["recordings"])).items():
        parts = {method: [own["recordings"][each] for each in names] for method, own in metrics["methods"].items()}
        count = sum(part["windows"] for part in next(iter(parts.values())))
        found[entry] = (count, {method: pooled(own) for method, own in parts.items()})
    return found


def _owners(files: Mapping[str, Sequence[Path]], names: Sequence[str]) -> dict[str, list[str]]:
    """The recordings of each entry: they are in the order of the files, of which a folder holds two people."""
    counts = {entry: sum(2 if path.is_dir() else 1 for path in paths) for entry, paths in files.items()}
    if sum(counts.values()) != len(names):
        raise RuntimeError(f"{len(names)} recordings have windows, expected {sum(counts.values())}: {', '.join(names)}")
    rest = iter(names)
    return {entry: [next(rest) for _ in range(count)] for entry, count in counts.items()}


def all_runs(seed: int = 0) -> Iterator[tuple[str, int, Figures]]:
    """Entry, number of windows and scores, of all that can be run here."""
    for name, asked in RUNS.items():
        if asked.generated or DATA.is_dir():
            for entry, (windows, figures) in run(name, seed).items():
                yield entry, windows, figures
        else:
            print(f"not run, since there are no recordings: {', '.join(asked.test)}", file=sys.stderr)


def differences(windows: int, found: Mapping[str, Mapping[str, float]], recorded: Mapping[str, Any]) -> list[str]:
    """What is out of tolerance in one entry, in words; empty where nothing is.

    Args:
        windows: how many were scored.
        found: scores by method; methods that are not there are not compared.
        recorded: the entry in recorded.json.
    """
    wrong = [] if windows == recorded["windows"] else [f"{windows} windows, recorded {recorded['windows']}"]
    for method, figures in found.items():
        expected = recorded["methods"][method]
        wrong += [f"{method} has no {score}" for score in expected if score not in figures]
        for score, value in figures.items():
            if score.startswith("violations_"):
                if method in CONSTRAINED and value != 0:
                    wrong.append(f"{method} {score} {value:.2g}, allowed is exactly 0")
                continue
            entry = expected[score]
            tolerance = entry.get("tolerance", TOLERANCES[score])
            if not abs(value - entry["value"]) <= tolerance:
                wrong.append(f"{method} {score} {value:.4f}, recorded {entry['value']:.4f} ± {tolerance:g}")
    return wrong


def recorded_of(runs: Sequence[Mapping[str, tuple[int, Figures]]]) -> dict[str, Any]:
    """The entries of recorded.json, from every entry of several runs with different seeds."""
    values = {
        (entry, method, score): [each[entry][1][method][score] for each in runs]
        for entry, (_, figures) in runs[0].items()
        for method, own in figures.items()
        for score in own
        if score in TOLERANCES
    }
    windows = {entry: count for entry, (count, _) in runs[0].items()}
    spreads = _spreads(values, windows)
    entries: dict[str, Any] = {
        entry: {"windows": count, "methods": {method: {} for method in runs[0][entry][1]}}
        for entry, count in windows.items()
    }
    for (entry, method, score), own in values.items():
        spread = spreads[entry, method, score]
        line = {"value": round(statistics.fmean(own), 4), "spread": round(spread, 4)}
        tolerance = SPREADS * spread
        if tolerance > TOLERANCES[score]:
            line["tolerance"] = round(tolerance, 3)
        entries[entry]["methods"][method][score] = line
    return entries


Key = tuple[str, str, str]
"""Entry, method, score."""


def _spreads(values: Mapping[Key, Sequence[float]], windows: Mapping[str, int]) -> dict[Key, float]:
    """Standard deviation of each score between seeds.

    A few seeds tell that of one score badly. It is therefore taken to be no less than usual: than the root mean square
    over all sets for the same method, or over the methods of the same kind where they were fitted. Spreads of scores
    in mm are averaged relative to the score. What all recordings have together follows from what each set has.
    """
    own = {key: statistics.stdev(each) for key, each in values.items()}
    scale = {key: abs(statistics.fmean(each)) if key[2].endswith("_mm") else 1.0 for key, each in values.items()}
    wholes = {str(each.whole): tuple(each.test) for each in RUNS.values() if each.whole is not None}
    # Only with a scene, or of samples, does a mean depend on draws.
    apart = {name for each in RUNS.values() if each.scene is not None for name in each.test} | set(wholes)
    found: dict[Key, float] = {}
    for key in values:
        entry, method, score = key
        same = [
            k for k in values
            if k[2] == score and k[0] not in apart and (k[0] == "fitted") == (entry == "fitted")
            and (k[1] == method if entry != "fitted" else (k[1] in PAPER) == (method in PAPER))
        ]  # fmt: skip
        usual = scale[key] * math.sqrt(statistics.fmean((own[k] / scale[k]) ** 2 for k in same))
        found[key] = max(own[key], usual)
    for whole, parts in wholes.items():
        total = sum(windows[part] for part in parts)
        for _, method, score in [key for key in values if key[0] == whole]:
            known = [(part, method, score) for part in parts if (part, method, score) in values]
            together = math.hypot(*(windows[key[0]] / total * found[key] for key in known)) if known else 0.0
            found[whole, method, score] = max(own[whole, method, score], together)
    return found


def write(path: Path, entries: Mapping[str, Any], people: str) -> None:
    """Writes recorded.json, a line for each score."""
    content = {
        "about": "Written by `python -m tests.accuracy.score --record`. value: mean over the runs with `seeds`; "
        "spread: standard deviation between them, of the score itself or, where that is larger, the usual one of that "
        "score and method over all sets (relative to the score if that is in mm). Where random numbers alone move a "
        f"score by more than `tolerances` allow, it has a tolerance of its own: {SPREADS:g} times the spread. mm, nats "
        "per joint, per cent.",
        "seeds": list(SEEDS),
        "samples": SAMPLES,
        "tolerances": TOLERANCES,
        "generated_people": people,
        "entries": entries,
    }
    path.write_text(_one_line_each(json.dumps(content, indent=1)) + "\n")


def _one_line_each(text: str) -> str:
    """JSON with what holds no other object or list on one line."""
    lines: list[str] = []
    for line in text.splitlines():
        lines.append(line)
        if line.strip().rstrip(",") in ("}", "]"):
            start = max(k for k, each in enumerate(lines[:-1]) if each.endswith(("{", "[")))
            inside = [each.strip() for each in lines[start + 1 : -1]]
            if not any(each.endswith(("}", "]", "},", "],")) for each in inside):
                lines[start:] = [lines[start] + " ".join(inside) + line.strip()]
    return "\n".join(lines)


def main() -> None:
    """Records, or compares and says what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.record:
        if not DATA.is_dir():
            sys.exit("set KINECAST_DATA to the folder of recordings")
        runs = [{entry: (windows, figures) for entry, windows, figures in all_runs(seed)} for seed in SEEDS]
        with tempfile.TemporaryDirectory() as folder:
            write(RECORDED, recorded_of(runs), fingerprint(generated_people(Path(folder))))
        return
    recorded, failed = json.loads(RECORDED.read_text())["entries"], False
    for entry, windows, figures in all_runs(arguments.seed):
        wrong = differences(windows, figures, recorded[entry])
        print(f"{entry}, {windows} windows: {'; '.join(wrong) or 'as recorded'}", flush=True)
        failed |= bool(wrong)
    sys.exit(failed)


if __name__ == "__main__":
    main()
