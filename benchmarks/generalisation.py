"""How well methods do where they were not trained: other clips, other tasks, other people, cameras and rates.

python -m benchmarks.generalisation --data FOLDER [--only NAME ...] [--methods a,b,c] [--out JSON]

FOLDER holds the recordings as docs/datasets.md names them. Every split trains anew, on what it does not test:
HA4M clip V001 for V002; each Vicon task from the five others; LEGO and KTH from all Vicon tasks. Results are added to
the JSON file split by split, so that a run can be continued.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

from kinecast.datasets.loading import load_all
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.evaluation.protocol import EvaluationOptions, TestRecording, evaluate
from kinecast.pipeline import every_frame, followed, observations, training_windows
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


def run(names: list[str], training: list[Recording], tested: list[Recording], samples: int) -> dict[str, object]:
    """One split: trains, scores, says how long training took."""
    options = WindowOptions()
    data = training_windows(training, replace(options, stride=1, whole=False))
    started = time.perf_counter()
    settings = TrainingOptions()
    methods = train(names, data, settings)
    seconds = time.perf_counter() - started
    parts = list(all_windows(tested, options))
    every = {history.name: history for history in all_windows(tested, every_frame(options))}
    recordings = [
        TestRecording(part.name, observations(part), part.future, part.frames, followed(every[part.name]))
        for part in parts
    ]
    scores = EvaluationOptions(samples=samples, repeats=0, limits=limits_of(data, settings))
    results, _ = evaluate(methods, recordings, None, scores)
    return {"training_windows": len(data), "training_seconds": seconds, **results}


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
    for split, (training, tested) in splits(arguments.data).items():
        if (arguments.only and split not in arguments.only) or split in results:
            continue
        results[split] = run(names, training, tested, arguments.samples)
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(results, indent=1))
        print(line(split, results[split]), flush=True)
    print("\n".join(line(split, result) for split, result in results.items()))


def line(split: str, result: dict) -> str:
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
