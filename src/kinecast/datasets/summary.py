"""What a recording holds and how good it is: for `kinecast info`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int8

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.body.torso_frame import torso_frame
from kinecast.body.tracking import Flaw, fill, find_flaws
from kinecast.datasets.recording import Recording
from kinecast.datasets.repair import MAX_GAP
from kinecast.datasets.resampling import measured_rate

BONES = {
    f"{side}_{bone}": (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for bone, upper, lower in (("upper_arm", "shoulder", "elbow"), ("forearm", "elbow", "wrist"))
} | {"shoulder_width": ("left_shoulder", "right_shoulder")}
"""Bones whose lengths are reported, as pairs of joints."""

Flags: TypeAlias = Bool[np.ndarray, " N"]
SPEED_JOINTS = tuple(joint for joint in ARM_JOINTS if "shoulder" not in joint)


@dataclass(frozen=True)
class Summary:
    """What a recording holds and how good it is; numbers are NaN where nothing was seen."""

    recording: Recording
    measured_rate: float  # one over the median step of the stamps [Hz]
    longest_step: float  # between two frames [s]
    repeated_frames: int  # copies of the frame before
    joints: Mapping[str, Mapping[str, float]]
    """Per joint `missing` (share of frames without it), `gaps` (how often it is lost), `longest_gap` [s], `jumps` (how
    often it is thrown aside and comes back), and the frames that a repair would have `interpolated`, repeats included,
    and `left_missing`."""
    bones: Mapping[str, Mapping[str, float]]
    """Per bone of both arms, and the shoulder width: `median` length [m], and `variation`, half the 5-95 % range as a
    share of it."""
    speeds: Mapping[str, Mapping[str, float]]
    """Of elbows and wrists over one frame, repeats and jumps left out: `p50`, `p99`, `max` [m/s]."""
    outside_range: float  # share of frames, after a repair, with an arm angle outside `JointLimits`
    too_fast: float  # share of frames, after a repair, with an arm angle moving faster than `JointLimits` allow

    @property
    def labels(self) -> dict[str, int]:
        """Frames per label, most frequent first."""
        return dict(Counter(self.recording.labels or ()).most_common())

    def as_json(self) -> dict[str, object]:
        """Plain dicts, lists and numbers; None for NaN."""
        r, measured = self.recording, vars(self).copy()
        del measured["recording"]
        about = {
            "name": r.name, "source": str(r.source or ""), "format": r.format, "person": r.person, "subject": r.subject,
            "task": r.task, "frames": len(r.stamps), "duration": r.duration, "rate": r.rate, "joint_names": r.joints,
            "labels": self.labels, "notes": r.notes,
        }  # fmt: skip
        plain: dict[str, object] = json.loads(json.dumps(about | measured), parse_constant=lambda _: None)
        return plain

    def lines(self) -> list[str]:
        """The summary in words, one fact a line."""
        r, frames = self.recording, len(self.recording.stamps)
        person = f", person {r.person}" if r.person not in ("", "0") else ""
        measured = f"measured {self.measured_rate:.4g} Hz, longest step {1e3 * self.longest_step:.0f} ms"
        length = f"{frames} frames, {r.duration:.1f} s at {r.rate:g} Hz ({measured})"
        facts = [f"{len(r.joints)} joints: {', '.join(r.joints)}"]
        if self.labels:
            facts.append("labels: " + ", ".join(f"{label} ({count})" for label, count in self.labels.items()))
        facts.append(f"repeated frames: {self.repeated_frames} ({self.repeated_frames / frames:.1%})")
        for name, joint in self.joints.items():
            if joint["gaps"]:
                gaps = f"gaps: {joint['gaps']}, longest {joint['longest_gap']:.2f} s"
                facts.append(f"{name}: missing in {joint['missing']:.1%} of frames ({gaps})")
        jumps = [f"{name} ({joint['jumps']})" for name, joint in self.joints.items() if joint["jumps"]]
        if jumps:
            facts.append("jumps: " + ", ".join(jumps))
        for name, bone in self.bones.items():
            facts.append(f"{name}: {1e3 * bone['median']:.0f} mm ± {bone['variation']:.1%}")
        for name, speed in self.speeds.items():
            p50, p99, fastest = speed.values()
            facts.append(f"{name} speed: median {p50:.2f}, 99 % {p99:.2f}, largest {fastest:.2f} m/s")
        outside = f"{self.outside_range:.1%} of frames are outside the joints' range"
        facts.append(f"after repair {outside}, {self.too_fast:.1%} above their speed")
        interpolated = sum(joint["interpolated"] for joint in self.joints.values())
        left = sum(joint["left_missing"] for joint in self.joints.values())
        values = frames * len(self.joints)
        positions = f"{interpolated} of {values} positions ({interpolated / values:.1%})"
        facts.append(f"repair would interpolate {positions} and leave {left} missing ({left / values:.1%})")
        facts += [f"note: {note}" for note in r.notes]
        return [f"{r.name}: {r.format}{person}, {length}", *(f"  {fact}" for fact in facts)]


def summarise(recording: Recording) -> Summary:
    """Everything about a recording that a summary holds."""
    flaws = find_flaws(recording.positions, recording.stamps)
    filled, interpolated = fill(recording.positions, recording.stamps, flaws, MAX_GAP)
    columns, sound = {name: column for column, name in enumerate(recording.joints)}, flaws == Flaw.NONE
    outside_range, too_fast = _outside_limits(replace(recording, positions=filled))
    return Summary(
        recording,
        measured_rate=measured_rate(recording.stamps),
        longest_step=float(np.diff(recording.stamps).max(initial=0.0)),
        repeated_frames=int(np.count_nonzero((flaws == Flaw.REPEATED).any(axis=1))),
        joints={name: _joint(recording, flaws[:, k], interpolated[:, k]) for name, k in columns.items()},
        bones={name: _bone(recording.joint(a) - recording.joint(b)) for name, (a, b) in BONES.items()},
        speeds={name: _speed(recording, name, sound[:, columns[name]]) for name in SPEED_JOINTS if name in columns},
        outside_range=outside_range,
        too_fast=too_fast,
    )


def _joint(recording: Recording, flaws: Int8[np.ndarray, " N"], interpolated: Flags) -> dict[str, float]:
    gaps, stamps = runs(flaws == Flaw.MISSING), recording.stamps
    lengths = [float(stamps[end - 1] - stamps[first]) + 1.0 / recording.rate for first, end in gaps]
    return {
        "missing": int(np.count_nonzero(flaws == Flaw.MISSING)) / max(len(flaws), 1),
        "gaps": len(gaps),
        "longest_gap": max(lengths, default=0.0),
        "jumps": len(runs(flaws == Flaw.JUMP)),
        "interpolated": int(np.count_nonzero(interpolated)),
        "left_missing": int(np.count_nonzero((flaws >= Flaw.MISSING) & ~interpolated)),
    }


def runs(flags: Flags) -> list[tuple[int, int]]:
    """First and one past the last index of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def _bone(offsets: Float[np.ndarray, "N 3"]) -> dict[str, float]:
    lengths = np.linalg.norm(offsets, axis=-1)
    lengths = lengths[np.isfinite(lengths)]
    low, median, high = np.percentile(lengths, [5, 50, 95]).tolist() if len(lengths) else (np.nan,) * 3
    return {"median": median, "variation": 0.5 * (high - low) / median if median > 0 else np.nan}


def _speed(recording: Recording, name: str, sound: Flags) -> dict[str, float]:
    steps = np.linalg.norm(np.diff(recording.joint(name), axis=0), axis=-1) / np.diff(recording.stamps)
    steps = steps[sound[1:] & sound[:-1]]
    speeds = np.percentile(steps, [50, 99, 100]).tolist() if len(steps) else (np.nan,) * 3
    return dict(zip(("p50", "p99", "max"), speeds, strict=True))


def _outside_limits(recording: Recording) -> tuple[float, float]:
    """Shares of the frames with arms seen that are outside the joints' range, and above their speed."""
    if not set(ARM_JOINTS) <= set(recording.joints):
        return np.nan, np.nan
    T_world_torso = torso_frame(recording.joints, recording.positions).T_world_torso
    postures = postures_from_points((recording.arms - T_world_torso[:, None, :3, 3]) @ T_world_torso[:, :3, :3])
    seen = np.isfinite(postures).all(axis=-1)
    if not seen.any():
        return np.nan, np.nan
    position, speed = violations(postures, np.full(18, np.nan), 1.0 / recording.rate, JointLimits())
    return float(position[seen].mean()), float(speed[seen].mean())
