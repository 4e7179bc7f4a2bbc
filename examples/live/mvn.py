"""Stands in for Xsens MVN where there is no suit: a person who swings the right hand, sent for three seconds at 60 Hz.

kinecast live --source xsens:// --sink ws://127.0.0.1:8767 --sink mcap:live.mcap
python examples/live/mvn.py 9763
"""

import math
import socket
import struct
import sys
import time

SPINE = [(0, 0, z) for z in (0.95, 1.05, 1.15, 1.25, 1.35, 1.5, 1.6)]  # pelvis, L5, L3, T12, T8, neck, head
RIGHT = [(0, -0.05, 1.45), (0, -0.2, 1.4), (0, -0.25, 1.1)]  # shoulder, upper arm, forearm: each where it begins
LEFT = [(0, 0.05, 1.45), (0, 0.2, 1.4), (0, 0.25, 1.1), (0.2, 0.2, 1.0)]
LEGS = [(x, y, z) for y in (-0.1, 0.1) for x, z in ((0, 0.9), (0, 0.5), (0, 0.1), (0.2, 0.05))]

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mvn:
    mvn.connect(("127.0.0.1", int(sys.argv[1])))
    begun = time.monotonic()
    for sample in range(180):
        time.sleep(max(begun + sample / 60 - time.monotonic(), 0))
        hand = (0.2, -0.2 + 0.15 * math.sin(sample / 20), 1.0)
        segments = [*SPINE, *RIGHT, hand, *LEFT, *LEGS]
        poses = [struct.pack(">I7f", k + 1, *place, 1, 0, 0, 0) for k, place in enumerate(segments)]
        milliseconds = round(1000 * sample / 60)
        header = struct.pack(
            ">6sIBBIBBBBHH", b"MXTP02", sample, 0x80, 23, milliseconds, 0, 23, 0, 0, 0, 32 * len(segments)
        )
        mvn.send(header + b"".join(poses))
