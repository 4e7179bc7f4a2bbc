"""How well methods do where they were not trained: other clips, other tasks, other people, cameras and rates.

python -m benchmarks.generalisation --data FOLDER [--only NAME ...] [--methods a,b,c] [--out JSON]

FOLDER holds the recordings as docs/datasets.md names them. Every split trains anew, on what it does not test:
HA4M clip V001 for V002; each Vicon task from the five others; LEGO and KTH from all Vicon tasks, trained once. Results
are added to the JSON file split by split, so that a run can be continued.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinecast.body.limits import JointLimits
from kinecast.datasets.loading import load_all
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import every_frame, training_windows
from kinecast.prediction.method import Method
from kinecast.prediction.methods import TrainingOptions, limits_of, train

VICON, HA4M, LEGO, KTH = (
    "human_robot_animations",
    "ha4m_features_demo/UpSkel",
    "human_assembly_data",
    "kth_handover_sample",
)
TRIVIAL = ("zero_velocity", "constant_velocity", "damped_velocity")
METHODS = (*TRIVIAL, "kalman", "ridge", "kinecast")
RESULTS = Path(__file__).parent / "results" / "generalisation.json"


def splits(data: Path) -> dict[str, tuple[list[Recording], list[Recording]]]:
    """Name of each split: what is trained on, what is tested."""
    vicon = load_all([data / VICON])
    found = {
        "HA4M V002": (load_all([data / HA4M / "IDU001V001.npy"]), load_all([data / HA4M / "IDU001V002.npy"])),
    }
    for task in sorted({recording.task for recording in vicon}):
        inside = [recording for recording in vicon if recording.task != task]
        found[task] = (inside, [recording for recording in vicon if recording.task == task])
    found["LEGO"] = (vicon, load_all([data / LEGO]))
    found["KTH"] = (vicon, load_all([data / KTH]))
    return found


@dataclass(frozen=True)
class Trained:
    """Methods trained on some recordings.

    Attributes:
        on: names of the recordings.
        methods: by name.
        limits: found in training.
        windows: how many.
        seconds: it took.
    """

    on: tuple[str, ...]
    methods: Mapping[str, Method[Any]]
    limits: JointLimits
    windows: int
    seconds: float


def fit(names: Sequence[str], recordings: Sequence[Recording]) -> Trained:
    """All methods, trained on every window of some recordings."""
    data, settings = training_windows(recordings, WindowOptions()), TrainingOptions()
    started = time.perf_counter()
    methods = train(names, data, settings)
    seconds = time.perf_counter() - started
    return Trained(names_of(recordings), methods, limits_of(data, settings), len(data), seconds)


def names_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    return tuple(recording.name for recording in recordings)


def run(trained: Trained, tested: Sequence[Recording], samples: int) -> dict[str, object]:
    """One split: scores of methods on recordings they have not seen."""
    options = WindowOptions()
    recordings = TestRecording.of(all_windows(tested, options), all_windows(tested, every_frame(options)))
    scores = EvaluationOptions(samples=samples, repeats=0, limits=trained.limits)
    results, _ = evaluate(trained.methods, recordings, None, scores)
    return {"training_windows": trained.windows, "training_seconds": trained.seconds, **results}


def main() -> None:
    """Runs what is missing in the results file and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    names = arguments.methods.split(",")
    results = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    trained: Trained | None = None
    for split, (training, tested) in splits(arguments.data).items():
        if (arguments.only and split not in arguments.only) or split in results:
            continue
        if trained is None or trained.on != names_of(training):
            trained = fit(names, training)
        results[split] = run(trained, tested, arguments.samples)
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(results, indent=1))
        print(line(split, results[split]), flush=True)
    print("\n".join(line(split, result) for split, result in results.items()))


def line(split: str, result: dict[str, Any]) -> str:
    """One row of the table: MPJPE of each method, and the gain over the best trivial one."""
    errors = {name: each["mpjpe_mm"] for name, each in result["methods"].items()}
    best = min(errors[name] for name in TRIVIAL if name in errors)
    last = list(errors)[-1]
    shown = "  ".join(f"{name} {error:.1f}" for name, error in errors.items())
    coverage = "/".join(
        f"{100 * result['methods'][last]['coverage'][level]:.0f}" for level in ("0.5", "0.8", "0.9", "0.95")
    )
    return f"{split:24} {shown}  {last}: {100 * (errors[last] / best - 1):+.1f} %, coverage {coverage}"


if __name__ == "__main__":
    main()
