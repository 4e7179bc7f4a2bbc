"""Sends a person who swings the right hand to `kinecast live` for three seconds, and prints what is predicted.

kinecast live --source ws://127.0.0.1:8765 --sink ws://127.0.0.1:8767 --sink mcap:live.mcap
python examples/live/client.py ws://127.0.0.1:8765 ws://127.0.0.1:8767
"""

import json
import math
import sys
import time

from websockets.sync.client import connect

SOURCE, SINK = sys.argv[1:]
JOINTS = ["left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"]
REST = [[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]]

with connect(SOURCE, proxy=None) as camera, connect(SINK, proxy=None) as predictions:
    for _ in range(90):
        stamp = time.time()
        positions = [*REST[:5], [0.2, -0.2 + 0.15 * math.sin(3 * stamp), 1.0]]  # metres, z up; null where not seen
        camera.send(json.dumps({"stamp": stamp, "person": "operator", "joints": JOINTS, "positions": positions}))
        prediction = json.loads(predictions.recv())
        print(prediction["status"], "right wrist in half a second:", prediction["mean"][-1][5])
        time.sleep(max(stamp + 1 / 30 - time.time(), 0))
