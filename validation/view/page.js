// The page: what is shown, and what changes it.

const told = about();
const state = {index: 0, camera: 0, colour: "height", show: "both", score: told.judged_at, vehicle: 0, side: "attacked",
               close: !!told.run && !told.drive,
               layers: {label: !told.drive, found: !!told.detector && !told.drive, file: !!told.file, track: !!told.drive}, playing: 0};
const lowestScore = Math.floor(20 * told.lowest_score) / 20; // a file's may be logits
let choice = "system"; // of the theme
let current = null;    // the frame that is shown

const KINDS = [["label", "Labels", true], ["found", "Detections", !!told.detector], ["file", told.detector ? "From file" : "Detections", !!told.file],
               ["track", "Tracks", !!told.drive]];
const eyes = {zoom: {scale: 1, u: 0.5, v: 0.5}, top: EYES.top(), orbit: EYES.orbit()};
const drive = told.drive && new Drive(told.drive, show);
const columns = (told.run ? ["clean", "attacked"] : ["clean"]).map(makeColumn);

function make(parent, tag, name, text) {
  const element = parent.appendChild(document.createElement(tag));
  if (name) element.className = name;
  if (text) element.textContent = text;
  return element;
}

function makeColumn(side) {
  const column = make(byId("columns"), "section", "column " + side);
  const title = make(column, "h2", "", side === "clean" ? "As recorded" : told.drive ? "With the object" : "Attacked");
  make(title, "span");
  const panel = (parent, name, text) => {
    const element = make(parent, "div", "panel " + name);
    const canvas = make(element, "canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", text + (told.run ? side === "clean" ? ", as recorded" : ", attacked" : ""));
    make(element, "span", "name", text);
    return element;
  };
  const picture = new PictureView(panel(column, "picture", "Camera"), eyes.zoom, draw);
  const maps = make(column, "div", "maps");
  const top = new PointView(panel(maps, "top", "From above"), "top", eyes.top, draw);
  const orbit = new PointView(panel(maps, "orbit", "3-D"), "orbit", eyes.orbit, draw);
  const made = {side, title, maps, views: [picture, top, orbit]};
  for (const view of made.views) {
    new ResizeObserver(draw).observe(view.panel);
    view.canvas.addEventListener("pointermove", event => tell(view, event));
    view.canvas.addEventListener("pointerleave", () => { byId("tip").hidden = true; });
    view.canvas.addEventListener("dblclick", () => { view.reset(); draw(); });
  }
  return made;
}

// How alike two boxes are is told as; without the object, who is judged.
const overlap = told.matching === "centre" ? "overlap" : "IoU", before = told.plain ? "as a plain cuboid" : "as recorded";
// The label by which an attack is judged: its victim's, the object's own, or its host's.
const judged = (frame, attack) => attack.object ?? frame.labels[attack.victim ?? attack.label];
const nameOf = (frame, label) => `${frame.id}_${label}`;

// The boxes of a column, each with its kind, colour and what is told about it.
function boxesOf(frame, attack, side) {
  const boxes = [], chosen = frame.attacks[state.vehicle];
  if (state.layers.label) {
    frame.labels.forEach((label, k) => {
      const host = k === chosen?.label, victim = k === chosen?.victim;
      if (host && drive) return; // it has a mark
      if (label.type !== "DontCare") boxes.push({...label, kind: "label", colour: "truth", host, victim, tag: victim ? "victim" : undefined});
      else boxes.push({...label, kind: "region", colour: "muted"});
    });
    if (attack?.object) boxes.push({...attack.object, type: "Object", kind: "label", colour: "truth", victim: true, tag: "object"});
  }
  const add = (found, kind, colour) => (found ?? []).filter(one => one.score >= state.score - 1e-9)
    .forEach(one => boxes.push({...one, kind, colour}));
  if (state.layers.found) {
    add(attack ? attack.found : frame.found, "found", side);
    const of = chosen?.outcome ?? {}, score = attack ? of.attacked_score : of.clean_score;
    const own = boxes.find(box => box.kind === "found" && Math.abs(box.score - score) < 1e-4);
    // What is found of a plain object is not found in the frame as recorded.
    if (own && (attack ? of.attacked_iou : told.plain ? 0 : of.clean_iou) > 0) own.own = true;
  }
  if (state.layers.track)
    for (const {identity, box, detected} of (attack ?? frame).tracks)
      boxes.push({type: `Track ${identity}`, kind: "track", identity, box, coasts: !detected, tag: `#${identity}`});
  if (drive) boxes.push(drive.mark(frame, side));
  if (state.layers.file && side === "clean") add(frame.file, "file", told.detector ? "file" : "clean");
  return boxes;
}

let asked = false;
function draw() {
  if (asked || !current) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; drawNow(); });
}

function drawNow() {
  const frame = current, key = [frame.id, state.colour, theme()].join();
  if (frame.coloured !== key) [frame.words, frame.coloured] = [pointWords(frame.points, state.colour, told), key];
  for (const {side, title, views} of columns) {
    const attack = side === "attacked" ? frame.attacks[state.vehicle] : null;
    let skipped = null;
    if (attack) {
      skipped = new Uint8Array(frame.points.n);
      for (const i of attack.removed) skipped[i] = 1;
    }
    const scene = {frame, camera: state.camera, attack, words: frame.words, skipped, boxes: boxesOf(frame, attack, side)};
    const camera = frame.cameras[state.camera];
    for (const view of views) {
      view.wedge = wedge(camera.pixel_from_velo, camera.size[0]);
      view.ground_z = told.height[0];
      if (view.panel.offsetParent) view.draw(scene);
    }
    title.lastChild.textContent = attack
      ? `${attack.outcome.returns} returns on the object, ${attack.outcome.removed} behind it removed`
      : told.file && !frame.file ? `this frame is not in ${told.file}` : "";
  }
  document.documentElement.dataset.frame = frame.id;
}

// Directions (velo, rad) of the picture's left and right edge.
function wedge(m, width) {
  return [-0.5, width - 0.5].map(u => { // (row 0 − u row 2) · p = 0 on the ground plane, ahead
    const a = m[0] - u * m[8], b = m[1] - u * m[9], angle = Math.atan2(-a, b), ahead = m[8] * Math.cos(angle) + m[9] * Math.sin(angle);
    return ahead > 0 ? angle : angle + Math.PI;
  });
}

const number = (value, digits) => value.toFixed(digits).replace("-", "−");
function describe(box) {
  const who = {label: "label", region: "unlabelled region", found: `${told.detector}`, file: `${told.file}`,
               track: box.coasts ? "coasting" : "with a detection", mark: "label"}[box.kind];
  const lines = [`${box.type}${box.score !== undefined ? ` ${box.score.toFixed(3)}` : ""} · ${who}`];
  if (box.box) {
    const [x, y, , length, width, height, yaw] = box.box;
    lines.push(`${number(Math.hypot(x, y), 1)} m away · ${number(length, 2)} × ${number(width, 2)} × ${number(height, 2)} m`);
    lines.push(`x ${number(x, 1)} m, y ${number(y, 1)} m, yaw ${number(yaw * 180 / Math.PI, 0)}°`);
  }
  if (box.occluded !== undefined) lines.push(`occlusion ${box.occluded} of 3 · truncation ${box.truncated} · ${box.returns} returns`);
  if (box.host) lines.push("carries the object in the attacked frame");
  if (box.victim) lines.push("the attack is judged on this box");
  return lines.join("\n");
}

function tell(view, event) {
  const tip = byId("tip"), place = view.canvas.getBoundingClientRect();
  const box = event.buttons ? null : view.boxAt(event.clientX - place.left, event.clientY - place.top);
  tip.hidden = !box;
  if (!box) return;
  tip.textContent = describe(box);
  tip.style.left = Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8) + "px";
  tip.style.top = (event.clientY + 18 + tip.offsetHeight > innerHeight ? event.clientY - tip.offsetHeight - 10 : event.clientY + 18) + "px";
}

// What the attack did to the vehicle that is chosen.
function outcome() {
  const line = byId("outcome"), attack = current.attacks[state.vehicle];
  line.replaceChildren();
  if (!attack) return;
  const of = attack.outcome, part = (text, name) => make(line, "span", name, text);
  if (of.learned_on) part(`Seen in training, so no evidence${drive ? "." : ": "}`, "bad");
  if (drive) return; // its own strip tells
  if (attack.object) part("The object: ");
  if (attack.victim !== undefined) part(`The victim ${nameOf(current, attack.victim)}: `);
  if (of.clean_score === undefined) {
    part(`${Math.round(100 * of.visible)} % of the object is in view.`, "quiet");
    return;
  }
  const found = (score, iou) => iou > 0 ? `score ${score.toFixed(2)}, ${overlap} ${iou.toFixed(2)}` : "no box";
  if (!of.detected) part(`Not found ${before}`, "quiet");
  else part(!of.hidden ? "Still found" : of.vanished ? "Vanished" : "Misplaced", of.hidden ? "bad" : "good");
  part(`: ${found(of.clean_score, of.clean_iou)} ${before}, ${found(of.attacked_score, of.attacked_iou)} attacked`);
  part(of.new_boxes ? `, ${of.new_boxes} new false ${of.new_boxes > 1 ? "boxes" : "box"}.` : ".", of.new_boxes ? "bad" : "");
  part(` Found means ${overlap} > ${told.judged_iou} at score ≥ ${told.judged_at}.`, "quiet");
}

function legend() {
  const byInstance = state.colour === "instance", ramp = byId("ramp"), context = ramp.getContext("2d"), words = rampWords();
  byId("ramp-name").textContent = {height: "Height over the LiDAR", reflectance: "Reflectance",
    instance: current?.true_instance ? "Instance, by the generator's truth" : "Instance, by the labelled boxes"}[state.colour];
  ramp.hidden = false;
  const image = context.createImageData(ramp.width, ramp.height), pixels = new Uint32Array(image.data.buffer);
  const hues = INSTANCES[theme()];
  for (let v = 0; v < ramp.height; ++v)
    for (let u = 0; u < ramp.width; ++u)
      pixels[v * ramp.width + u] = byInstance ? word(rgb(hues[Math.floor(u / ramp.width * hues.length)]))
                                              : words[Math.floor(u / (ramp.width - 1) * 255)];
  context.putImageData(image, 0, 0);
  const ends = {height: told.height.map(v => number(v, 1) + " m"), reflectance: ["0", number(told.reflectance, 2)], instance: ["", ""]}[state.colour];
  byId("ramp-low").textContent = ends[0];
  byId("ramp-high").textContent = ends[1];
  const list = byId("swatches");
  list.replaceChildren();
  const swatch = (colour, text, name = "") => {
    const entry = make(list, "span");
    make(entry, "i", name).style.setProperty("--c", `var(--${colour})`);
    entry.append(text);
  };
  if (byInstance) swatch("background", "no labelled object", "dot");
  if (state.layers.label) swatch("truth", "label", "dashed");
  if (state.layers.label && told.run && !drive) swatch("truth", "host's label");
  if (state.layers.found && told.detector) {
    swatch("clean", `${told.detector}, as recorded`);
    swatch("attacked", `${told.detector}, ${drive ? "with the object" : "attacked"}`);
  }
  if (drive) drive.legend(swatch, state.layers.track);
  if (state.layers.file && told.file) swatch(told.detector ? "file" : "clean", `detections (${told.file})`);
  if (told.run) swatch("hit", "return on the object", "dot");
}

function refresh() {
  for (const button of document.querySelectorAll("fieldset button"))
    button.setAttribute("aria-pressed", state[button.parentElement.id] === button.value);
  for (const input of document.querySelectorAll("#layers input")) input.checked = state.layers[input.value];
  const score = byId("score");
  score.hidden = !told.detector && !told.file;
  score.style.display = score.hidden ? "none" : "";
  score.querySelector("input").value = state.score;
  score.querySelector("output").textContent = state.score.toFixed(2);
  byId("columns").dataset.side = state.side;
  for (const {maps} of columns) {
    maps.classList.toggle("one", state.show !== "both");
    maps.querySelector(".top").style.display = state.show === "orbit" ? "none" : "";
    maps.querySelector(".orbit").style.display = state.show === "top" ? "none" : "";
  }
  legend();
  if (current) {
    outcome();
    address();
  }
  draw();
}

// Which vehicles N and P step through: [frame, vehicle, distance] each. The page's order for all and for a drive,
// else the nearest first. Vehicles that the object was learned on are no evidence and have a group of their own.
const everyOne = told.attacks.flatMap((of, frame) => of.map(([word, distance], vehicle) => ({word, at: [frame, vehicle, distance]})));
const later = (a, b) => a[0] - b[0] || a[1] - b[1], farther = (a, b) => a[2] - b[2] || later(a, b);
const group = (name, text, of) => {
  const order = told.drive || name === "all" ? later : farther;
  return {name, text, order, vehicles: everyOne.filter(({word}) => name === "all" || word === name).map(({at}) => at).sort(order), of};
};
const foundClean = everyOne.filter(({word}) => word === "hidden" || word === "found").length;
const AMONG = [group("all", told.drive ? "All frames" : "All vehicles"), group("hidden", "Hidden", foundClean), group("found", "Still found", foundClean),
               group("unfound", `Not found ${before}`), group("learned", "Learned on")]
  .filter(({name, vehicles}) => name === "all" || told.detector && (name !== "learned" || vehicles.length));

function jump(forward) {
  const {vehicles, order} = AMONG[byId("among").querySelector("select").selectedIndex];
  const here = [state.index, state.vehicle, told.attacks[state.index][state.vehicle]?.[1] ?? 0], after = at => order(at, here);
  const next = forward ? vehicles.find(at => after(at) > 0) ?? vehicles[0] : vehicles.findLast(at => after(at) < 0) ?? vehicles.at(-1);
  return next && show(...next);
}

// The page's address names the vehicle as all results do, by its frame and label: #000007_2; a drive's, or a frame
// without attacks, the frame alone. Once the page is at rest: browsers refuse an address that changes all the time.
let addressing = 0;
function address() {
  clearTimeout(addressing);
  addressing = setTimeout(() => {
    const hash = `#${encodeURIComponent(drive ? current.id : current.attacks[state.vehicle]?.name ?? current.id)}`;
    if (location.hash !== hash) history.replaceState(null, "", hash);
  }, 250);
}
function follow() {
  let name = "";
  try { name = decodeURIComponent(location.hash.slice(1)); } catch { /* no address of ours: "#%" */ }
  for (const id of [name, name.slice(0, Math.max(0, name.lastIndexOf("_")))]) {
    const index = told.frames.indexOf(id);
    if (index >= 0) return show(index, name);
  }
  return show(...(!drive && AMONG[1]?.vehicles[0] || [0])); // the nearest hidden vehicle, if there is one
}

// `vehicle`: its place among those of the frame, or its name.
async function show(index, vehicle) {
  index = Math.max(0, Math.min(told.frames.length - 1, index));
  state.index = index;
  drive?.at(index);
  byId("slider").value = index;
  byId("place").textContent = `${told.frames[index]} · ${index + 1} of ${told.frames.length}`;
  const frame = await frameAt(index);
  if (state.index !== index) return; // another was asked for meanwhile
  current = frame;
  frame.index = index;
  const first = is => frame.attacks.findIndex(is), found = [first((attack, k) => vehicle === k || vehicle === attack.name),
    first(attack => attack.outcome.hidden), first(attack => attack.outcome.detected)];
  state.vehicle = found.find(place => place >= 0) ?? 0;
  if (state.close) closeUp();
  const list = byId("vehicle").querySelector("select");
  list.replaceChildren(...frame.attacks.map((attack, k) => {
    const [x, y] = frame.labels[attack.label].box;
    const learned = attack.outcome.learned_on ? ", learned on" : "", victim = attack.victim === undefined ? "" : `, victim ${nameOf(frame, attack.victim)}`;
    return new Option(`${attack.name}: ${frame.labels[attack.label].type}, ${number(Math.hypot(x, y), 0)} m${victim}${learned}`, k);
  }));
  list.value = state.vehicle;
  const cameras = byId("camera").querySelector("select");
  cameras.replaceChildren(...frame.cameras.map(({name}, k) => new Option(name, k)));
  byId("camera").style.display = frame.cameras.length > 1 ? "" : "none";
  lookAt(state.camera);
  byId("tip").hidden = true;
  byId("columns").classList.add("ready");
  refresh();
  const ahead = drive && state.playing ? drive.ahead(index) : [index + 1];
  for (const next of ahead.filter(next => next < told.frames.length)) frameAt(next).catch(() => {});
}

// The camera that is shown: another where this one does not show the object on the vehicle that is chosen.
function lookAt(camera) {
  const patches = current.attacks[state.vehicle]?.patches ?? [];
  const shows = k => !patches.length || patches.some(one => one.camera === k);
  state.camera = camera < current.cameras.length && shows(camera) ? camera : patches[0]?.camera ?? 0;
  byId("camera").querySelector("select").value = state.camera;
}

// All views at what is judged of the attacked vehicle; at the nearest label without a run.
function closeUp() {
  const boxed = current.labels.filter(label => label.box), away = label => Math.hypot(label.box[0], label.box[1]);
  const attack = current.attacks[state.vehicle], label = attack ? judged(current, attack) : boxed.sort((a, b) => away(a) - away(b))[0];
  state.close = !!label;
  if (!label) return;
  state.camera = label.camera ?? 0;
  byId("camera").querySelector("select").value = state.camera;
  const [x, y, bottom, length, , height] = label.box, [left, top, right, low] = label.picture;
  const [w, h] = current.cameras[state.camera].size;
  if (right > left) Object.assign(eyes.zoom, {u: (left + right) / 2 / w, v: (1.6 * top + 0.4 * low) / 2 / h,
                            scale: Math.max(1, Math.min(12, w / 3.5 / Math.max(1, right - left), h / 2.6 / Math.max(1, low - top)))});
  Object.assign(eyes.top, {x, y, span: 5 * length});
  Object.assign(eyes.orbit, {x, y, z: bottom + 0.7 * height, heading: Math.atan2(y, x) - 0.5, down: 0.3, distance: 3 * length});
}
function reset() {
  state.close = false;
  for (const view of columns[0].views) view.reset();
}

// The next frame half a second after the last was there: a slow machine shows every one, later. A drive keeps its time.
function play() {
  clearTimeout(state.playing);
  const wait = drive ? 10 : 500, after = () => drive ? drive.due(state.index) : (state.index + 1) % told.frames.length;
  const next = async () => {
    const index = after();
    if (index !== state.index) await show(index);
    if (state.playing) state.playing = setTimeout(next, wait);
  };
  drive?.start();
  state.playing = state.playing ? 0 : setTimeout(next, wait);
  byId("play").textContent = state.playing ? "Stop" : "Play";
}

function setTheme(next) {
  choice = next;
  if (next === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = next;
  byId("theme").textContent = {system: "◐ System", light: "○ Light", dark: "● Dark"}[next];
  refresh();
}

const step = (list, value) => list[(list.indexOf(value) + 1) % list.length];
const toggle = kinds => {
  const on = kinds.some(kind => state.layers[kind]);
  for (const kind of kinds) state.layers[kind] = !on;
};
const KEYS = {
  ArrowRight: event => show(state.index + (event.shiftKey ? 10 : 1)),
  ArrowLeft: event => show(state.index - (event.shiftKey ? 10 : 1)),
  Home: () => show(0),
  End: () => show(told.frames.length - 1),
  " ": play,
  h: () => { state.colour = "height"; },
  r: () => { state.colour = "reflectance"; },
  i: () => { state.colour = "instance"; },
  s: () => { state.side = step(["clean", "attacked"], state.side); },
  v: () => { state.show = step(["top", "orbit", "both"], state.show); },
  l: () => toggle(["label"]),
  d: () => toggle(KINDS.slice(1, 3).filter(kind => kind[2]).map(kind => kind[0])),
  k: () => { if (drive) toggle(["track"]); },
  "[": () => { state.score = Math.max(lowestScore, Math.round(20 * state.score - 1) / 20); },
  "]": () => { state.score = Math.min(1, Math.round(20 * state.score + 1) / 20); },
  a: () => {
    if (!current.attacks.length) return;
    state.vehicle = (state.vehicle + 1) % current.attacks.length;
    byId("vehicle").querySelector("select").value = state.vehicle;
    state.close ? closeUp() : lookAt(state.camera);
  },
  c: () => { state.camera = (state.camera + 1) % current.cameras.length; byId("camera").querySelector("select").value = state.camera; },
  n: () => { jump(true); },
  p: () => { jump(false); },
  z: () => { state.close ? reset() : closeUp(); },
  0: reset,
  t: () => setTheme(step(["system", "light", "dark"], choice)),
};
addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.("select, #score input")) return;
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!act || event.key === " " && event.target.matches?.("button, input[type=checkbox]")) return;
  event.preventDefault();
  act(event);
  refresh();
});
byId("slider").max = told.frames.length - 1;
byId("slider").addEventListener("input", event => show(+event.target.value));
byId("before").onclick = () => show(state.index - 1);
byId("after").onclick = () => show(state.index + 1);
byId("play").onclick = play;
byId("theme").onclick = KEYS.t;
byId("score").querySelector("input").min = lowestScore; // before refresh(), which sets its value
byId("score").querySelector("input").addEventListener("input", event => { state.score = +event.target.value; refresh(); });
byId("vehicle").querySelector("select").addEventListener("change", event => { state.vehicle = +event.target.value; state.close ? closeUp() : lookAt(state.camera); refresh(); });
byId("camera").querySelector("select").addEventListener("change", event => { state.camera = +event.target.value; refresh(); });
for (const {side, title} of columns) Object.assign(make(byId("side"), "button", "", title.firstChild.textContent), {type: "button", value: side});
for (const button of document.querySelectorAll("fieldset button"))
  button.onclick = () => { state[button.parentElement.id] = button.value; refresh(); };
for (const [kind, name, there] of KINDS.filter(kind => kind[2])) {
  const label = make(byId("layers"), "label"), input = make(label, "input");
  Object.assign(input, {type: "checkbox", value: kind});
  label.append(name);
  input.onchange = () => { state.layers[kind] = input.checked; refresh(); };
}
const among = byId("among").querySelector("select");
for (const {text, vehicles, of} of AMONG) among.add(new Option(`${text} (${vehicles.length}${of === undefined ? "" : ` of ${of}`})`));
if (AMONG[1]?.vehicles.length) among.selectedIndex = 1;
byId("next").onclick = () => jump(true);
addEventListener("hashchange", follow);
byId("what").textContent = told.data + (drive ? `, ${drive.name} with ${told.run}` : told.run ? `, attacked by ${told.run}` : "");
document.title = `Mirage: ${told.data}`;
byId("columns").classList.toggle("pair", !!told.run);
byId("columns").classList.toggle("drive", !!drive);
for (const part of document.querySelectorAll(".run, .vehicle")) part.style.display = told.run ? "" : "none";
for (const part of document.querySelectorAll(".drive:not(main)")) part.style.display = drive ? "" : "none";
if (drive) byId("vehicle").style.display = "none"; // there is one
byId("about-page").textContent = `${told.megabytes} MB, nothing is loaded from elsewhere. ` +
  (told.kept === told.points ? "All returns are shown" : `${Math.round(100 * told.kept / told.points)} % of the returns are shown ` +
   `(outside labelled boxes at least ${told.step === 1 ? "every one" : `every ${told.step}th`})`) +
  `, to the centimetre; pictures are JPEG of quality ${told.quality} or better.` +
  (told.detector || told.file ? " Boxes found in the bird's-eye view alone get their height from the sweep." : "");
dark.addEventListener("change", () => setTheme(choice));
setTheme("system");
follow();
