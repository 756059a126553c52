// Points from above and in 3-D, drawn one by one into a picture with a depth buffer: no graphics card is needed.
// All views of a kind share one eye. velo: x forward, y left, z up.

const EYES = {
  top: () => ({x: 27, y: 0, span: 70}), // the middle, and metres across the shorter side
  orbit: () => ({x: 15, y: 0, z: -1, heading: -0.2, down: 0.4, distance: 27}),
};
const FIELD = 0.9; // rad, across the shorter side of the 3-D view
const RINGS = [10, 20, 30, 40, 60, 80, 100];

class PointView {
  constructor(panel, kind, eye, redraw) {
    Object.assign(this, {panel, kind, eye, canvas: panel.querySelector("canvas"), drawn: []});
    this.canvas.dataset.splat = "1";
    this.held = document.createElement("canvas"); // the points alone, in device pixels
    followPointer(this.canvas, {
      drag: (du, dv, shifted) => { this.drag(du, dv, shifted); redraw(); },
      zoom: (factor, u, v) => { this.zoomAt(factor, u, v); redraw(); },
    });
  }
  reset() { Object.assign(this.eye, EYES[this.kind]()); }

  drag(du, dv, shifted) {
    const eye = this.eye;
    if (this.kind === "top") {
      eye.x += dv / this.scale;
      eye.y += du / this.scale;
    } else if (shifted) {
      const k = eye.distance * 0.0016, c = Math.cos(eye.heading), s = Math.sin(eye.heading);
      eye.x += k * (dv * c - du * s);
      eye.y += k * (dv * s + du * c);
    } else {
      eye.heading += du * 0.006;
      eye.down = Math.max(-0.1, Math.min(1.55, eye.down + dv * 0.006));
    }
  }
  zoomAt(factor, u, v) {
    const eye = this.eye;
    if (this.kind === "orbit") {
      eye.distance = Math.max(1.5, Math.min(300, eye.distance / factor));
      return;
    }
    const {width, height} = this.canvas.getBoundingClientRect(), before = this.scale;
    eye.span = Math.max(4, Math.min(400, eye.span / factor));
    const after = Math.min(width, height) / eye.span;
    eye.x -= (v - height / 2) * (1 / before - 1 / after);
    eye.y -= (u - width / 2) * (1 / before - 1 / after);
  }

  // Sets this.place(x, y, z) → [u, v, depth] in CSS pixels, and this.numbers for the loop over points.
  look(width, height) {
    const eye = this.eye, u0 = width / 2, v0 = height / 2;
    if (this.kind === "top") {
      const s = this.scale = Math.min(width, height) / eye.span;
      this.place = (x, y, z) => [u0 - (y - eye.y) * s, v0 - (x - eye.x) * s, 1000 - z];
      this.clip = (a, b) => [a, b];
      return;
    }
    const ch = Math.cos(eye.heading), sh = Math.sin(eye.heading), cd = Math.cos(eye.down), sd = Math.sin(eye.down);
    const f = [cd * ch, cd * sh, -sd], r = [sh, -ch, 0], up = [sd * ch, sd * sh, cd];
    const from = [eye.x - eye.distance * f[0], eye.y - eye.distance * f[1], eye.z - eye.distance * f[2]];
    const k = this.focal = Math.min(width, height) / 2 / Math.tan(FIELD / 2);
    const depth = p => (p[0] - from[0]) * f[0] + (p[1] - from[1]) * f[1] + (p[2] - from[2]) * f[2];
    this.view = {f, r, up, from};
    this.place = (x, y, z) => {
      const d = [x - from[0], y - from[1], z - from[2]], w = d[0] * f[0] + d[1] * f[1] + d[2] * f[2];
      return [u0 + k * (d[0] * r[0] + d[1] * r[1]) / w, v0 - k * (d[0] * up[0] + d[1] * up[1] + d[2] * up[2]) / w, w];
    };
    this.clip = clipAt(0.3, depth);
  }

  // Points into `pixels` (words) with `near` as depth buffer; `size` in device pixels at least.
  splat(points, words, skipped, pixels, near, w, h, ratio, size) {
    const top = this.kind === "top", eye = this.eye, s = top ? this.scale * ratio : this.focal * ratio, u0 = w / 2, v0 = h / 2;
    const {f, r, up, from} = top ? {} : this.view, {x, y, z} = points;
    for (let i = 0; i < points.n; ++i) {
      if (skipped && skipped[i]) continue;
      let u, v, d, reach = size;
      if (top) {
        u = u0 - (y[i] - eye.y) * s;
        v = v0 - (x[i] - eye.x) * s;
        d = 1000 - z[i];
      } else {
        const a = x[i] - from[0], b = y[i] - from[1], c = z[i] - from[2];
        d = a * f[0] + b * f[1] + c * f[2];
        if (d < 0.5) continue;
        const k = s / d;
        u = u0 + k * (a * r[0] + b * r[1]);
        v = v0 - k * (a * up[0] + b * up[1] + c * up[2]);
        reach = Math.max(size, Math.min(4 * ratio, 0.035 * k));
      }
      const u1 = Math.round(u - reach / 2), v1 = Math.round(v - reach / 2), n = Math.max(1, Math.round(reach));
      if (u1 < 0 || v1 < 0 || u1 + n > w || v1 + n > h) continue;
      for (let q = v1; q < v1 + n; ++q)
        for (let p = u1; p < u1 + n; ++p) {
          const at = q * w + p;
          if (d < near[at]) {
            near[at] = d;
            pixels[at] = words[i];
          }
        }
    }
  }

  draw(scene) {
    const {context, ratio, width, height} = fitted(this.canvas), w = this.canvas.width, h = this.canvas.height;
    this.look(width, height);
    context.clearRect(0, 0, width, height);
    this.ground(context, width, height);
    if (!this.image || this.image.width !== w || this.image.height !== h) {
      [this.held.width, this.held.height] = [w, h];
      this.image = new ImageData(w, h);
      this.near = new Float32Array(w * h);
    }
    const {image, near} = this, pixels = new Uint32Array(image.data.buffer);
    pixels.fill(0);
    near.fill(1e9);
    const {points, attack} = scene.frame ? {points: scene.frame.points, attack: scene.attack} : {};
    const size = Math.max(1, Math.round(ratio * (this.kind === "top" && this.scale > 14 ? 2 : 1.3)));
    this.splat(points, scene.words, scene.skipped, pixels, near, w, h, ratio, size);
    if (attack) {
      const hit = word(rgb(css("hit")));
      this.splat(attack.added, new Uint32Array(attack.added.n).fill(hit), null, pixels, near, w, h, ratio, Math.round(3 * ratio));
    }
    const held = this.held.getContext("2d", {willReadFrequently: true});
    held.putImageData(image, 0, 0);
    context.drawImage(this.held, 0, 0, width, height);
    this.boxes(context, scene);
    this.ranges(context, width, height);
    if (this.kind === "top") this.scaleBar(context, width, height);
    else this.axes(context, width, height);
  }

  line(context, from, to) {
    const ends = this.clip(from, to);
    if (!ends) return;
    context.moveTo(...this.place(...ends[0]).slice(0, 2));
    context.lineTo(...this.place(...ends[1]).slice(0, 2));
  }

  // Range rings on the ground around the LiDAR, the camera's view and the LiDAR itself.
  ground(context, width, height) {
    const z = this.ground_z ?? -1.7;
    context.setLineDash([]);
    context.lineWidth = 1;
    context.strokeStyle = css("ring");
    context.beginPath();
    const apart = this.kind === "top" ? this.scale : this.focal / this.eye.distance; // px a metre
    const rings = RINGS.filter(r => r % 20 === 0 || apart > 4);
    for (const radius of rings)
      for (let k = 0; k < 120; ++k) {
        const a = k / 60 * Math.PI, b = (k + 1) / 60 * Math.PI;
        this.line(context, [radius * Math.cos(a), radius * Math.sin(a), z], [radius * Math.cos(b), radius * Math.sin(b), z]);
      }
    context.stroke();
    if (this.wedge) { // the camera's field of view
      context.strokeStyle = css("strong");
      context.setLineDash([6, 5]);
      context.beginPath();
      for (const angle of this.wedge) this.line(context, [0, 0, z], [100 * Math.cos(angle), 100 * Math.sin(angle), z]);
      context.stroke();
      context.setLineDash([]);
    }
    this.rings = rings;
  }

  // The rings' ranges, along the right edge of the field of view, and the LiDAR.
  ranges(context, width, height) {
    const z = this.ground_z ?? -1.7;
    context.fillStyle = css("muted");
    context.font = "11px system-ui, 'Liberation Sans', sans-serif";
    const written = [];
    for (const radius of this.rings) {
      const angle = (this.wedge?.[1] ?? -0.7) - 0.06, [u, v, depth] = this.place(radius * Math.cos(angle), radius * Math.sin(angle), z);
      const text = radius + " m", wide = context.measureText(text).width;
      if (depth < 0.5 || u < 4 || v < 30 || u + wide > width - 4 || v > height - 34) continue;
      if (written.some(([a, b]) => Math.abs(a - u) < 40 && Math.abs(b - v) < 15)) continue;
      written.push([u, v]);
      write(context, text, u, v);
    }
    const [u, v, depth] = this.place(0, 0, this.kind === "top" ? 0 : z);
    if (depth > 0.5) {
      context.fillStyle = css("ink");
      context.beginPath();
      if (this.kind === "top") {
        context.moveTo(u, v - 8); context.lineTo(u + 5, v + 6); context.lineTo(u - 5, v + 6);
      } else context.arc(u, v, 3.5, 0, 7);
      context.fill();
      write(context, "LiDAR", u + 9, v + 4);
    }
  }

  boxes(context, scene) {
    this.drawn = [];
    for (const box of scene.boxes) {
      if (!box.box) continue;
      const corners = cornersOf(box.box), project = p => this.place(...p).slice(0, 2);
      const places = corners.map(c => this.place(...c)).filter(p => p[2] > 0.5);
      if (!places.length) continue;
      this.drawn.push(extent(box, places));
      if (this.kind === "orbit") {
        strokeBox(context, box, edgePath(edgesOf(places), corners, this.clip, project));
        continue;
      }
      const [x, y, bottom, length, , , yaw] = box.box, ahead = k => [x + k * length * Math.cos(yaw), y + k * length * Math.sin(yaw), bottom];
      strokeBox(context, box, edgePath(EDGES.slice(0, 4), corners, this.clip, project));
      strokeBox(context, {...box, host: true}, edgePath([[0, 1]], [ahead(0.5), ahead(0.75)], this.clip, project));
    }
  }
  boxAt(u, v) { return boxAt(this.drawn, u, v); }

  scaleBar(context, width, height) {
    const most = Math.min(150, width / 3) / this.scale, base = 10 ** Math.floor(Math.log10(most));
    const metres = [5, 2, 1].map(k => k * base).find(k => k <= most), long = metres * this.scale;
    this.bar = {metres, pixels: long};
    context.globalAlpha = 0.8; // a ground for the bar among the points
    context.fillStyle = css("stage");
    context.fillRect(6, height - 38, Math.max(50, long + 12), 33);
    context.globalAlpha = 1;
    context.fillStyle = context.strokeStyle = css("ink");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(12, height - 17); context.lineTo(12, height - 12); context.lineTo(12 + long, height - 12); context.lineTo(12 + long, height - 17);
    context.stroke();
    context.font = "12px system-ui, 'Liberation Sans', sans-serif";
    write(context, metres + " m", 14, height - 21);
    this.arrow(context, width - 24, 40, width - 24, 16, "x ahead", "right");
  }

  // velo's axes at the lower left, one metre long in no scale.
  axes(context, width, height) {
    const {f, r, up} = this.view, u = 40, v = height - 34;
    context.font = "12px system-ui, 'Liberation Sans', sans-serif";
    [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].forEach(([name, a]) => {
      const du = 24 * (a[0] * r[0] + a[1] * r[1]), dv = -24 * (a[0] * up[0] + a[1] * up[1] + a[2] * up[2]);
      context.strokeStyle = css("muted");
      context.fillStyle = css("ink");
      context.lineWidth = 1.5;
      context.beginPath(); context.moveTo(u, v); context.lineTo(u + du, v + dv); context.stroke();
      if (Math.hypot(du, dv) > 7) write(context, name, u + 1.4 * du - 3, v + 1.4 * dv + 4);
    });
  }
  arrow(context, u1, v1, u2, v2, text) {
    context.strokeStyle = context.fillStyle = css("muted");
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(u1, v1); context.lineTo(u2, v2);
    context.moveTo(u2 - 4, v2 + 6); context.lineTo(u2, v2); context.lineTo(u2 + 4, v2 + 6);
    context.stroke();
    context.font = "12px system-ui, 'Liberation Sans', sans-serif";
    context.textAlign = "right";
    write(context, text, u1 - 8, v1 - 8);
    context.textAlign = "left";
  }
}
