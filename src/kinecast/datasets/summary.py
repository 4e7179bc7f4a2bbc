"""What a recording holds and how good it is: for `kinecast info`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.body.torso_frame import torso_frame
from kinecast.body.tracking import Flaw
from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import RepairOptions, RepairReport, repair, spans
from kinecast.datasets.resampling import measured_rate

__all__ = ["Bone", "JointQuality", "Speed", "Summary", "summarise"]

BONES = {
    "left_upper_arm": ("left_shoulder", "left_elbow"),
    "left_forearm": ("left_elbow", "left_wrist"),
    "right_upper_arm": ("right_shoulder", "right_elbow"),
    "right_forearm": ("right_elbow", "right_wrist"),
    "shoulder_width": ("left_shoulder", "right_shoulder"),
}
"""Bones whose lengths are reported, as pairs of joints."""

SPEED_JOINTS = tuple(joint for joint in ARM_JOINTS if "shoulder" not in joint)


@dataclass(frozen=True)
class JointQuality:
    """How well one joint is tracked.

    Attributes:
        missing: share of frames without it.
        gaps: how often it is lost.
        longest_gap: [s].
        jumps: how often it is thrown aside and comes back.
        interpolated: frames a repair would interpolate, repeats included.
        left_missing: frames that stay without it after a repair.
    """

    missing: float
    gaps: int
    longest_gap: float
    jumps: int
    interpolated: int
    left_missing: int


@dataclass(frozen=True)
class Bone:
    """Length of a bone [m]: median, and half the 5-95 % range as a share of it. NaN where never seen."""

    median: float
    variation: float


@dataclass(frozen=True)
class Speed:
    """Speed of a joint [m/s] over one frame, repeats and jumps left out: median, 99th percentile, largest."""

    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class Summary:
    """What a recording holds.

    Attributes:
        name: of the recording.
        source: file or folder, "" for generated ones.
        format: name of the format.
        person, subject, task: as in the recording.
        frames: how many.
        duration: [s].
        rate: nominal, frames per second [Hz].
        measured_rate: one over the median step of the stamps [Hz].
        longest_step: longest time between two frames [s].
        joint_names: every joint tracked.
        labels: frames per label, most frequent first.
        repeated_frames: copies of the frame before.
        joints: per joint.
        bones: per bone of both arms, and the shoulder width.
        speeds: of elbows and wrists.
        outside_range: share of frames, after a repair, with an arm angle outside `JointLimits`; NaN where the
            arms are never seen.
        too_fast: share of frames, after a repair, with an arm angle moving faster than `JointLimits` allow.
        notes: as in the recording.
    """

    name: str
    source: str
    format: str
    person: str
    subject: str
    task: str
    frames: int
    duration: float
    rate: float
    measured_rate: float
    longest_step: float
    joint_names: tuple[str, ...]
    labels: Mapping[str, int]
    repeated_frames: int
    joints: Mapping[str, JointQuality]
    bones: Mapping[str, Bone]
    speeds: Mapping[str, Speed]
    outside_range: float
    too_fast: float
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """Plain dicts, lists and numbers; None for NaN."""
        return {name: _plain(value) for name, value in asdict(self).items()}

    def lines(self) -> list[str]:
        """The summary in words, one fact a line."""
        person = f", person {self.person}" if self.person not in ("", "0") else ""
        measured = f"measured {self.measured_rate:.4g} Hz, longest step {1e3 * self.longest_step:.0f} ms"
        lines = [
            f"{self.name}: {self.format}{person}, {self.frames} frames, {self.duration:.1f} s at "
            f"{self.rate:g} Hz ({measured})",
            f"  {len(self.joint_names)} joints: {', '.join(self.joint_names)}",
        ]
        if self.labels:
            lines.append("  labels: " + ", ".join(f"{label} ({count})" for label, count in self.labels.items()))
        lines.append(f"  repeated frames: {self.repeated_frames} ({self.repeated_frames / self.frames:.1%})")
        for name, joint in self.joints.items():
            if joint.gaps:
                gaps = f"gaps: {joint.gaps}, longest {joint.longest_gap:.2f} s"
                lines.append(f"  {name}: missing in {joint.missing:.1%} of frames ({gaps})")
        jumps = [f"{name} ({joint.jumps})" for name, joint in self.joints.items() if joint.jumps]
        if jumps:
            lines.append("  jumps: " + ", ".join(jumps))
        for name, bone in self.bones.items():
            lines.append(f"  {name}: {1e3 * bone.median:.0f} mm ± {bone.variation:.1%}")
        for name, speed in self.speeds.items():
            lines.append(f"  {name} speed: median {speed.p50:.2f}, 99 % {speed.p99:.2f}, largest {speed.max:.2f} m/s")
        lines.append(
            f"  after repair {self.outside_range:.1%} of frames are outside the joints' range, "
            f"{self.too_fast:.1%} above their speed"
        )
        interpolated = sum(joint.interpolated for joint in self.joints.values())
        left = sum(joint.left_missing for joint in self.joints.values())
        values = self.frames * len(self.joints)
        lines.append(
            f"  repair would interpolate {interpolated} of {values} positions ({interpolated / values:.1%}) "
            f"and leave {left} missing ({left / values:.1%})"
        )
        lines.extend(f"  note: {note}" for note in self.notes)
        return lines


def summarise(recording: Recording, options: RepairOptions | None = None) -> Summary:
    """What a recording holds, and what a repair would do to it.

    Args:
        recording: as loaded, at least one frame.
        options: of the repair.
    """
    repaired, report = repair(recording, options)
    steps = np.diff(recording.stamps)
    outside_range, too_fast = _outside_limits(repaired)
    return Summary(
        name=recording.name,
        source="" if recording.source is None else str(recording.source),
        format=recording.format,
        person=recording.person,
        subject=recording.subject,
        task=recording.task,
        frames=len(recording.stamps),
        duration=recording.duration,
        rate=recording.rate,
        measured_rate=measured_rate(recording.stamps),
        longest_step=float(steps.max(initial=0.0)),
        joint_names=recording.joints,
        labels=dict(Counter(recording.labels or ()).most_common()),
        repeated_frames=report.repeated_frames,
        joints={name: _joint(recording, report, name) for name in recording.joints},
        bones={name: _bone(recording.joint(a) - recording.joint(b)) for name, (a, b) in BONES.items()},
        speeds={name: _speed(recording, report, name) for name in SPEED_JOINTS if name in recording.joints},
        outside_range=outside_range,
        too_fast=too_fast,
        notes=recording.notes,
    )


def _joint(recording: Recording, report: RepairReport, name: str) -> JointQuality:
    column = recording.joints.index(name)
    flaws, counts = report.flaws[:, column], report.joint(name)
    gaps = spans(flaws == Flaw.MISSING)
    frame = 1.0 / recording.rate
    return JointQuality(
        missing=counts.missing / max(len(flaws), 1),
        gaps=len(gaps),
        longest_gap=max(
            (float(recording.stamps[start + length - 1] - recording.stamps[start]) + frame for start, length in gaps),
            default=0.0,
        ),
        jumps=len(spans(flaws == Flaw.JUMP)),
        interpolated=counts.interpolated,
        left_missing=counts.left_missing,
    )


def _bone(offsets: Float[np.ndarray, "N 3"]) -> Bone:
    lengths = np.linalg.norm(offsets, axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    if not len(lengths):
        return Bone(np.nan, np.nan)
    low, median, high = np.percentile(lengths, [5, 50, 95])
    return Bone(float(median), float(0.5 * (high - low) / median) if median > 0 else np.nan)


def _speed(recording: Recording, report: RepairReport, name: str) -> Speed:
    sound = report.flaws[:, recording.joints.index(name)] == Flaw.NONE
    steps = np.linalg.norm(np.diff(recording.joint(name), axis=0), axis=-1) / np.diff(recording.stamps)
    steps = steps[sound[1:] & sound[:-1]]
    if not len(steps):
        return Speed(np.nan, np.nan, np.nan)
    return Speed(*(float(value) for value in np.percentile(steps, [50, 99, 100])))


def _outside_limits(recording: Recording) -> tuple[float, float]:
    """Shares of the frames with arms seen that are outside the joints' range, and above their speed."""
    if not set(ARM_JOINTS) <= set(recording.joints):
        return np.nan, np.nan
    T_world_torso = torso_frame(recording.joints, recording.positions).T_world_torso
    arms = np.stack([recording.joint(name) for name in ARM_JOINTS], axis=1)
    points = (arms - T_world_torso[:, None, :3, 3]) @ T_world_torso[:, :3, :3]
    postures = postures_from_points(points)
    seen = np.isfinite(postures).all(axis=-1)
    if not seen.any():
        return np.nan, np.nan
    start = np.full(postures.shape[-1], np.nan)
    position, speed = violations(postures, start, 1.0 / recording.rate, JointLimits())
    return float(position[seen].mean()), float(speed[seen].mean())


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
