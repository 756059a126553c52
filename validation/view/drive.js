// A vehicle's drive: its strip of found, coasting and lost over time, what is said of the moment, and the clock that
// plays it. Words and colours are those of the drive's report.

const VERSIONS = [["clean", "as recorded"], ["attacked", "with the object"], ["random", "random of its size"]];
const STATES = {f: ["found", "with a detection"], c: ["coasting", "coasting"], l: ["lost", "none"]};

class Drive {
  constructor(vehicle, seek) {
    Object.assign(this, {vehicle, strip: vehicle.strip, name: `vehicle ${vehicle.track % 100000} of ${vehicle.sequence}`});
    const {time_s, stands_s} = this.strip;
    // Where each frame begins and ends in the strip, s; the vehicle's absences are shown at their length, too.
    this.times = time_s.map(t => t - time_s[0]);
    this.ends = this.times.map((t, i) => t + stands_s[i]);
    this.length = this.ends.at(-1);
    // When each is due in playing: absences are left out.
    this.playtimes = [];
    stands_s.reduce((sum, seconds, i) => (this.playtimes[i] = sum) + seconds, 0);
    this.build(seek);
  }

  // {from, to} of frames on end for which `is`, s.
  runs(is) {
    const runs = [];
    for (let i = 0; i < this.times.length; ++i) {
      if (!is(i)) continue;
      if (i > 0 && is(i - 1) && !this.strip.away[i - 1]) runs.at(-1).to = this.ends[i];
      else runs.push({from: this.times[i], to: this.ends[i]});
    }
    return runs;
  }

  build(seek) {
    const strip = byId("strip"), share = t => `${100 * t / this.length}%`;
    strip.hidden = false;
    this.said = VERSIONS.slice(0, 2).map(([version]) => make(strip, "p", "said " + version));
    this.away = make(strip, "p", "said away");
    const grid = make(strip, "div", "grid"), names = make(grid, "div", "names");
    const scale = this.scale = make(grid, "div", "scale");
    const piece = (bar, name, {from, to}, title) => {
      const part = make(bar, "i", name);
      Object.assign(part.style, {left: share(from), width: share(to - from)});
      if (title) part.title = `${from.toFixed(1)} to ${to.toFixed(1)} s: ${title}`;
    };
    for (const [version, name] of VERSIONS) {
      const {found, track} = this.strip[version], bar = make(scale, "div", "bar " + version);
      make(names, "span", "", name);
      for (const [letter, [state, text]] of Object.entries(STATES))
        for (const run of this.runs(i => track[i] === letter)) piece(bar, state, run, text);
      for (const run of this.runs(i => found[i] === "f")) piece(bar, "seen", run);
    }
    const axis = make(scale, "div", "axis"), apart = [0.5, 1, 2, 5, 10, 20, 50, 100].find(s => this.length / s <= 9) ?? 200;
    for (let s = 0; s <= this.length; s += apart) make(axis, "span", "", s + " s").style.left = share(s);
    this.cursor = make(scale, "div", "cursor");
    const said = make(strip, "p", "key", "A confirmed track lies on the vehicle:");
    for (const [state, text] of Object.values(STATES)) {
      make(said, "i", state);
      said.append(text);
    }
    make(said, "i", "seen");
    said.append("the detector finds it");
    Object.assign(scale, {tabIndex: 0});
    for (const [name, value] of [["role", "slider"], ["aria-label", "Time"], ["aria-valuemin", 0], ["aria-valuemax", this.length.toFixed(1)]])
      scale.setAttribute(name, value);
    const drag = event => {
      const {left, width} = scale.getBoundingClientRect();
      seek(this.nearest((event.clientX - left) / width * this.length));
    };
    scale.addEventListener("pointerdown", event => { scale.setPointerCapture(event.pointerId); drag(event); });
    scale.addEventListener("pointermove", event => { if (event.buttons) drag(event); });
  }

  // The frame that stands at this time, or that is nearest to it.
  nearest(t) {
    const off = i => Math.max(this.times[i] - t, t - this.ends[i] + 1e-9, 0);
    return this.times.reduce((best, _, i) => off(i) < off(best) ? i : best, 0);
  }

  // s for which the vehicle is not found up to the end of this frame; 0: it is found.
  unseen(version, index) {
    const {stands_s, away} = this.strip, {found} = this.strip[version];
    let seconds = 0;
    for (let i = index; i >= 0 && found[i] !== "f" && (i === index || !away[i]); --i) seconds += stands_s[i];
    return seconds;
  }

  at(index) {
    const s = value => `${value.toFixed(1)} s`, {range_m, closing_mps} = this.strip;
    VERSIONS.slice(0, 2).forEach(([version, name], k) => {
      const unseen = this.unseen(version, index), longest = this.vehicle.gap_s[version];
      this.said[k].replaceChildren(name[0].toUpperCase() + name.slice(1) + ": ");
      make(this.said[k], "b", unseen ? "lost" : "found", unseen ? `not found for ${s(unseen)} so far` : "found");
      this.said[k].append(longest ? `; longest ${s(longest)}` : "");
    });
    const closing = closing_mps[index];
    this.away.textContent = `${range_m[index].toFixed(0)} m away, ${Math.abs(closing) < 0.5 ? "keeping its distance"
      : `${closing > 0 ? "closing" : "going away"} at ${Math.abs(closing).toFixed(0)} m/s`}`;
    this.cursor.style.left = `${100 * (this.times[index] + this.ends[index]) / 2 / this.length}%`;
    this.scale.setAttribute("aria-valuenow", this.times[index].toFixed(1));
    this.scale.setAttribute("aria-valuetext", `${s(this.times[index])}, frame ${index + 1}`);
  }

  // The vehicle's own box, in the colour of its state.
  mark(frame, side) {
    const [state] = STATES[this.strip[side].track[frame.index]];
    return {...frame.labels[frame.attacks[0].label], kind: "mark", host: true, colour: state, tag: state};
  }

  legend(swatch, tracks) {
    if (tracks) swatch("muted", "confirmed tracks, coloured by identity, dashed: coasting");
    swatch("found", "the vehicle, followed");
    swatch("coasting", "coasting");
    swatch("lost", "lost");
  }

  start() { [this.clock, this.step] = [null, 1]; }
  // The frame to be shown now. What a slow machine can't show in time is left out; after the last, a second's rest.
  due(index) {
    const now = performance.now() / 1000, times = this.playtimes;
    if (this.clock?.index !== index) { // it begins, or somebody chose another frame
      this.step = 1;
      this.clock = {index, began: now - times[index]};
    }
    let next = index;
    while (next + 1 < times.length && times[next + 1] <= now - this.clock.began) ++next;
    if (next === times.length - 1 && now - this.clock.began > times[next] + 1) [next, this.clock.began] = [0, now];
    if (next > index) this.step = next - index;
    this.clock.index = next;
    return next;
  }
  // What is likely to be due after it.
  ahead(index) { return [1, 2, 3].map(k => index + k * this.step); }
}
