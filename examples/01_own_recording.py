"""Your own recording.

A recording becomes a table with one row per (stamp, person, joint); kinecast reads it from csv or parquet.

Shows: the table format, what loading checks and says when a file is wrong, what repair would touch, and a recording
streamed through the online predictor.
"""

from __future__ import annotations

import csv
import tempfile
from collections import Counter
from pathlib import Path

from kinecast import KinecastError, Predictor, PredictorOptions
from kinecast.datasets import table
from kinecast.datasets.loading import load, shipped_clips
from kinecast.datasets.recording import Recording
from kinecast.datasets.summary import summarise
from kinecast.pipeline import stream


def write_csv(path: Path, recording: Recording, metres: float = 1.0) -> None:
    """What a script of your own would do: the six columns that must be there, in any order; others are optional."""
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["stamp", "person", "joint", "x", "y", "z"])
        for stamp, positions in zip(recording.stamps, recording.positions, strict=True):
            for joint, (x, y, z) in zip(recording.joints, positions / metres, strict=True):
                rows.writerow([stamp, "operator", joint, x, y, z])  # nan where a joint is not seen


def main() -> None:
    person = shipped_clips()[0].select(slice(120))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        write_csv(folder / "own.csv", person)
        (recording,) = load(folder / "own.csv")
        print("\n".join(summarise(recording).lines()))

        write_csv(folder / "millimetres.csv", person, metres=1e-3)
        try:
            load(folder / "millimetres.csv")
        except KinecastError as error:
            print(f"\na file in the wrong unit is refused:\n  {str(error).replace(name, '…')}")

        # What kinecast writes comes back bit for bit, with rate, subject, task and labels.
        table.write(folder / "written.csv", [recording])
        recordings = load(folder / "written.csv")

    predictor = Predictor.shipped(options=PredictorOptions(samples=200))
    statuses = Counter(prediction.status for prediction in stream(recordings, predictor))
    print(f"\n{statuses.total()} predictions")
    for status, count in statuses.most_common():
        print(f"  {status.name}: {count}  ({status.advice})")


if __name__ == "__main__":
    main()
