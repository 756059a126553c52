// Colours: of the theme (style.css), of a ramp, of instances; and boxes as all views draw them.

const RAMPS = { // dark to bright on dark paper; on light paper without the tones that drown in it
  dark: ["#41348a", "#31688e", "#21918c", "#35b779", "#a8db34", "#fde725"],
  light: ["#3b0f70", "#414487", "#2a788e", "#1f9e89", "#55a630", "#b59a00"],
};
const INSTANCES = { // no red: that is the object's
  dark: ["#ffab70", "#85e89d", "#79b8ff", "#ffea7f", "#b392f0", "#56d4dd", "#d4b483", "#9ecb3c"],
  light: ["#d9730d", "#22863a", "#0366d6", "#a68a00", "#6f42c1", "#0e8a93", "#8a6d3b", "#5f8f0f"],
};
const dark = matchMedia("(prefers-color-scheme: dark)");
const theme = () => document.documentElement.dataset.theme ?? (dark.matches ? "dark" : "light");
const css = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16));
const word = ([r, g, b]) => (255 << 24 | b << 16 | g << 8 | r) >>> 0; // as ImageData has it

// 256 words of the theme's ramp.
function rampWords() {
  const stops = RAMPS[theme()].map(rgb), table = new Uint32Array(256);
  for (let i = 0; i < 256; ++i) {
    const at = i / 255 * (stops.length - 1), k = Math.min(stops.length - 2, Math.floor(at)), f = at - k;
    table[i] = word(stops[k].map((v, c) => Math.round(v + f * (stops[k + 1][c] - v))));
  }
  return table;
}
const instanceColour = k => INSTANCES[theme()][k % INSTANCES[theme()].length];

// A word for each point.
function pointWords(points, mode, told) {
  const words = new Uint32Array(points.n);
  if (mode === "instance") {
    const table = Uint32Array.from({length: 256}, (_, k) => word(rgb(k ? instanceColour(k - 1) : css("background"))));
    for (let i = 0; i < points.n; ++i) words[i] = table[points.instance[i]];
    return words;
  }
  const table = rampWords(), values = mode === "height" ? points.z : points.reflectance;
  const [low, high] = mode === "height" ? told.height : [0, told.reflectance];
  const scale = 255 / Math.max(1e-6, high - low);
  for (let i = 0; i < points.n; ++i) words[i] = table[Math.max(0, Math.min(255, (values[i] - low) * scale | 0))];
  return words;
}

// Eight corners of [x, y, bottom, length, width, height, yaw]: the bottom's from front left on, then the top's.
function cornersOf([x, y, bottom, length, width, height, yaw]) {
  const c = Math.cos(yaw), s = Math.sin(yaw), corners = [];
  for (const z of [bottom, bottom + height])
    for (const [a, b] of [[1, 1], [-1, 1], [-1, -1], [1, -1]])
      corners.push([x + (c * a * length - s * b * width) / 2, y + (s * a * length + c * b * width) / 2, z]);
  return corners;
}
const EDGES = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
const FRONT = [[0, 7], [3, 4]]; // a cross on the front face, of boxes that are not too small for it
const edgesOf = places => {
  const {left, right, top, bottom} = extent(null, places);
  return Math.max(right - left, bottom - top) > 50 ? [...EDGES, ...FRONT] : EDGES;
};

// A path of segments between corners; `project` gives [u, v].
function edgePath(edges, corners, clip, project) {
  const path = new Path2D();
  for (const [a, b] of edges) {
    const ends = clip(corners[a], corners[b]);
    if (!ends) continue;
    path.moveTo(...project(ends[0]));
    path.lineTo(...project(ends[1]));
  }
  return path;
}

// Cuts a segment at depth(p) = near; null if it lies behind.
function clipAt(near, depth) {
  return (a, b) => {
    const da = depth(a) - near, db = depth(b) - near;
    if (da <= 0 && db <= 0) return null;
    if (da > 0 && db > 0) return [a, b];
    const f = da / (da - db), cut = a.map((v, k) => v + f * (b[k] - v));
    return da > 0 ? [a, cut] : [cut, b];
  };
}

// By its kind; a track's by its identity.
function boxColour(box, over) {
  const hues = INSTANCES[over ? "dark" : theme()];
  return box.identity === undefined ? css((over ? "on-" : "") + box.colour) : hues[box.identity % hues.length];
}

// Strokes a box's path; `over` a photograph with a dark edge, so that it shows on any ground.
function strokeBox(context, box, path, over) {
  const width = box.host ? 2.2 : box.kind === "label" ? 1.3 : 1.8, dashed = box.coasts || box.kind === "label" && !box.host;
  if (over) {
    context.setLineDash([]);
    context.strokeStyle = "rgba(0, 0, 0, .42)";
    context.lineWidth = width + 1.6;
    context.stroke(path);
  }
  context.strokeStyle = boxColour(box, over);
  context.lineWidth = width;
  context.setLineDash(dashed ? [5, 3] : box.kind === "region" ? [2, 3] : []);
  context.stroke(path);
  context.setLineDash([]);
}

// Fits a canvas to its panel in device pixels; returns its context, scaled to CSS pixels.
function fitted(canvas) {
  const ratio = Math.min(2, devicePixelRatio || 1), {width, height} = canvas.parentElement.getBoundingClientRect();
  const w = Math.max(1, Math.round(width * ratio)), h = Math.max(1, Math.round(height * ratio));
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d", {willReadFrequently: canvas.dataset.splat === "1"});
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return {context, ratio, width: w / ratio, height: h / ratio};
}

// The smallest of the boxes drawn around a place of the panel.
function boxAt(drawn, u, v) {
  const area = b => (b.right - b.left) * (b.bottom - b.top);
  return drawn.filter(b => u >= b.left - 3 && u <= b.right + 3 && v >= b.top - 3 && v <= b.bottom + 3)
              .sort((a, b) => area(a) - area(b))[0]?.box;
}
// Text with an edge of the ground's colour.
function write(context, text, u, v) {
  context.lineJoin = "round";
  context.lineWidth = 4;
  context.strokeStyle = css("stage");
  context.strokeText(text, u, v);
  context.fillText(text, u, v);
}
function extent(box, places) {
  const u = places.map(p => p[0]), v = places.map(p => p[1]);
  return {box, left: Math.min(...u), right: Math.max(...u), top: Math.min(...v), bottom: Math.max(...v)};
}
