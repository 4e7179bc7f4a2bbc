"""A first prediction.

A real person at work, frame by frame through the online predictor, as a camera would give them.

Shows: `Predictor.shipped`, `observe`, the status, the mean, tubes, the probability of touching something, and how
likely what came next was held to be.
"""

from __future__ import annotations

import numpy as np

from kinecast import ARM_JOINTS, Box, Predictor, PredictorOptions, SkeletonFrame
from kinecast.datasets.loading import shipped_clips

RIGHT_WRIST = ARM_JOINTS.index("right_wrist")


def main() -> None:
    predictor = Predictor.shipped(options=PredictorOptions(samples=300))
    person = shipped_clips()[0].select(slice(120))  # four seconds of a recording stand in for a camera
    bin_on_table = Box(center=np.array([0.5, -0.1, 0.3]), size=np.array([0.2, 0.2, 0.2]))

    shown = range(20, 75, 9)
    for index, (stamp, positions) in enumerate(zip(person.stamps, person.positions, strict=True)):
        prediction = predictor.observe(SkeletonFrame(float(stamp), person.joints, positions))
        if index not in shown:
            continue
        last = len(prediction.times) - 1
        came = person.joint("right_wrist")[index + 1 + last]
        error = np.linalg.norm(prediction.mean[last, RIGHT_WRIST] - came)
        forearm = prediction.tubes(0.95).radius[last, 3]
        touching = prediction.probability_of_hitting(bin_on_table, radius=0.05).max()
        print(
            f"t = {stamp:.2f} s, {prediction.status.name}: in {prediction.times[last] - stamp:.2f} s the right wrist "
            f"is {1e3 * error:.0f} mm from its mean; a capsule of {1e3 * forearm:.0f} mm holds 95 % of right "
            f"forearms; P(touching the bin) {touching:.2f}"
        )
    print(f"\n{prediction.status.name} means: {prediction.status.advice}")

    # The distribution itself: S equally likely motions, and an exact density at every step.
    print(f"samples {prediction.samples.shape}: motions, steps, joints, xyz in metres")
    print(
        f"log density of the mean motion, first and last step: {prediction.log_prob(prediction.mean)[[0, -1]].round(1)}"
    )


if __name__ == "__main__":
    main()
