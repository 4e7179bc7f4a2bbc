// Sends a person who swings the right hand to `kinecast live` by UDP for three seconds. Node.js alone is enough.
//
// kinecast live --source udp://127.0.0.1:8766 --sink ws://127.0.0.1:8767 --sink mcap:live.mcap
// node examples/live/client.mjs 8766
import dgram from "node:dgram";

const port = Number(process.argv[2]);
const joints = ["left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"];
const rest = [[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1]];

const socket = dgram.createSocket("udp4");
let left = 90;
const timer = setInterval(() => {
  const stamp = Date.now() / 1000; // seconds
  const positions = [...rest, [0.2, -0.2 + 0.15 * Math.sin(3 * stamp), 1.0]]; // metres, z up; null where not seen
  socket.send(JSON.stringify({ stamp, person: "operator", joints, positions }), port, "127.0.0.1");
  if (--left === 0) {
    clearInterval(timer);
    socket.close();
  }
}, 1000 / 30);
