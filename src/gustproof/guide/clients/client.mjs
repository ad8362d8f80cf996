// Hold the paper's vehicle level: gustproof fly calm --controller "exec: node client.mjs"
import { createSocket } from "node:dgram";

const STIFFNESS = [2.2, 1.8, 0.9], DAMPING = [1.2, 1.0, 0.5]; // [N m/rad], [N m s/rad] about roll, pitch and yaw
const LIMITS = ["GP_TRQ_MAX_R", "GP_TRQ_MAX_P", "GP_TRQ_MAX_Y"]; // parameters that publish the torque [N m] of 1.0
const [host, port] = process.env.GUSTPROOF_ADDRESS.split(":"), link = createSocket("udp4");
const limits = [0, 0, 0], angle = [0, 0, 0]; let sequence = 0, stamp = 0n;

function send(id, extra, size, fill) { // a MAVLink 2 frame from system 1, component 191
  const frame = Buffer.alloc(size + 12);
  frame.set([0xfd, size, 0, 0, sequence++ & 255, 1, 191, id]), fill(frame.subarray(10));
  let crc = 0xffff;
  for (const byte of [...frame.subarray(1, size + 10), extra]) {
    const x = (byte ^ crc) & 255, y = (x ^ (x << 4)) & 255;
    crc = ((crc >> 8) ^ (y << 8) ^ (y << 3) ^ (y >> 4)) & 0xffff;
  }
  frame.writeUInt16LE(crc, size + 10);
  link.send(frame, port, host);
}
const beat = () => send(0, 50, 9, (p) => p.set([18, 8, 0, 4, 3], 4)); // HEARTBEAT
const ask = (name) => send(20, 214, 20, (p) => (p.set([255, 255, 1, 1]), p.write(name, 4))); // PARAM_REQUEST_READ
const order = (id, first, second) => send(76, 152, 33, (p) => // COMMAND_LONG
  (p.writeFloatLE(first, 0), p.writeFloatLE(second, 4), p.writeUInt16LE(id, 28), p.set([1, 1], 30)));
link.on("message", (frame) => {
  const p = Buffer.concat([frame.subarray(10, 10 + frame[1]), Buffer.alloc(64)]); // zeros at the end are not sent
  if (frame[7] === 22) limits[LIMITS.indexOf(p.toString("latin1", 8, 20))] = p.readFloatLE(0); // PARAM_VALUE
  if (frame[7] === 0 && stamp > 0n && !(p[6] & 128)) process.exit(); // HEARTBEAT: disarmed, the flight is over
  if (frame[7] !== 105) return; // HIGHRES_IMU
  const time = p.readBigUInt64LE(0), step = 1e-6 * Number(time - stamp), command = Buffer.alloc(16);
  for (let i = 0; i < 3; i++) { // a sample that is sent again adds no angle and gets the same answer
    const rate = p.readFloatLE(20 + 4 * i), torque = -STIFFNESS[i] * (angle[i] += step * rate) - DAMPING[i] * rate;
    command.writeFloatLE(Math.max(-1, Math.min(1, torque / limits[i])), 4 * i);
  }
  stamp = time;
  command.writeFloatLE(NaN, 12); // the vehicle holds its height itself
  if (limits.includes(0)) LIMITS.forEach(ask);
  else send(139, 168, 43, (a) => (p.copy(a, 0, 0, 8), a.set(command, 8), a.set([0, 1, 1], 40)));
  if (stamp === 0n) order(400, 1, 0), order(176, 1, 6); // arm, then OFFBOARD
});
beat(), setInterval(beat, 1000);
