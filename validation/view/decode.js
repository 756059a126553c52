"use strict";
// Frames as the page carries them: base64 of gzip of a container (validation/view/frame_pack.h). A frame is decoded
// when it is looked at; the last few are kept.

const byId = id => document.getElementById(id);
const about = () => JSON.parse(byId("about").textContent);

function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; ++i) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

// Neither a Blob nor a Response: those go through other processes and wait for them.
async function unzip(text) {
  const zip = new DecompressionStream("gzip"), writer = zip.writable.getWriter(), reader = zip.readable.getReader(), parts = [];
  const written = writer.write(bytesOf(text)).then(() => writer.close());
  for (let part; !(part = await reader.read()).done;) parts.push(part.value);
  await written;
  const bytes = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  parts.reduce((at, part) => { bytes.set(part, at); return at + part.length; }, 0);
  return bytes;
}

// {n, x, y, z (m), reflectance (0 … 1), instance (label's number + 1, 0: none)} of packed_points.
function unpackPoints(bytes) {
  const n = bytes.length / 8, points = {n};
  ["x", "y", "z"].forEach((axis, k) => {
    const values = new Float32Array(n);
    for (let i = 0, now = 0, low = 2 * n * k, high = low + n; i < n; ++i) {
      const zigzag = bytes[low + i] | bytes[high + i] << 8;
      now = now + ((zigzag >>> 1) ^ -(zigzag & 1)) << 16 >> 16;
      values[i] = now / 100;
    }
    points[axis] = values;
  });
  points.reflectance = Float32Array.from(bytes.subarray(6 * n, 7 * n), v => v / 255);
  points.instance = bytes.slice(7 * n);
  return points;
}

async function decodeFrame(index) {
  const bytes = await unzip(byId("frame-" + index).textContent), view = new DataView(bytes.buffer);
  const start = 4 + view.getUint32(0, true), frame = JSON.parse(new TextDecoder().decode(bytes.subarray(4, start)));
  const blob = ([at, size]) => bytes.subarray(start + at, start + at + size);
  const picture = place => createImageBitmap(new Blob([blob(place)], {type: "image/jpeg"}));
  for (const camera of frame.cameras) camera.photo = await picture(camera.photo);
  frame.points = unpackPoints(blob(frame.points));
  for (const attack of frame.attacks) {
    for (const patch of attack.patches) patch.patch = await picture(patch.patch);
    const words = blob(attack.removed);
    attack.removed = new Uint32Array(words.slice().buffer);
    attack.added = unpackPoints(blob(attack.added));
  }
  return frame;
}

const decoded = new Map(); // index → promise, the oldest first
function frameAt(index) {
  const held = decoded.get(index) ?? decodeFrame(index);
  decoded.delete(index);
  decoded.set(index, held);
  if (decoded.size > 6) decoded.delete(decoded.keys().next().value);
  return held;
}
