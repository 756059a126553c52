// The photograph with the boxes on it. All pictures share one zoom: {scale ≥ 1, u, v: the middle, as a share}.

class PictureView {
  constructor(panel, zoom, redraw) {
    Object.assign(this, {panel, zoom, redraw, canvas: panel.querySelector("canvas"), drawn: []});
    followPointer(this.canvas, {
      drag: (du, dv) => { this.moveBy(du, dv); redraw(); },
      zoom: (factor, u, v) => { this.zoomAt(factor, u, v); redraw(); },
    });
  }

  // Pixels of the photograph to the panel's.
  window(width, height) {
    const {scale} = this.zoom, [w, h] = this.camera.size, s = scale * width / w, half = 0.5 / scale;
    this.zoom.u = Math.max(half, Math.min(1 - half, this.zoom.u));
    this.zoom.v = Math.max(half, Math.min(1 - half, this.zoom.v));
    return {s, left: width / 2 - this.zoom.u * w * s, top: height / 2 - this.zoom.v * h * s};
  }
  moveBy(du, dv) {
    const {width, height} = this.canvas.getBoundingClientRect();
    this.zoom.u -= du / width / this.zoom.scale;
    this.zoom.v -= dv / height / this.zoom.scale;
  }
  zoomAt(factor, u, v) {
    const {width, height} = this.canvas.getBoundingClientRect(), before = this.zoom.scale;
    const scale = this.zoom.scale = Math.max(1, Math.min(24, before * factor));
    this.zoom.u += (u / width - 0.5) * (1 / before - 1 / scale);
    this.zoom.v += (v / height - 0.5) * (1 / before - 1 / scale);
  }

  draw(scene) {
    const camera = this.camera = scene.frame.cameras[scene.camera];
    this.panel.style.aspectRatio = camera.size.join(" / ");
    const {context, width, height} = fitted(this.canvas), {s, left, top} = this.window(width, height);
    const at = ([u, v]) => [left + (u + 0.5) * s, top + (v + 0.5) * s];
    context.imageSmoothingEnabled = s < 3;
    context.imageSmoothingQuality = "high";
    context.drawImage(camera.photo, left, top, camera.size[0] * s, camera.size[1] * s);
    const objects = [];
    for (const {rect: [u, v, w, h], patch} of scene.attack?.patches.filter(one => one.camera === scene.camera) ?? []) {
      objects.push([left + u * s, top + v * s, w * s, h * s]);
      context.drawImage(patch, ...objects.at(-1));
    }
    const m = camera.pixel_from_velo;
    const depth = p => m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
    const project = p => {
      const z = depth(p);
      return at([(m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / z, (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / z]);
    };
    this.drawn = [];
    const tags = [];
    for (const box of scene.boxes) {
      let places, path;
      if (box.box) {
        const corners = cornersOf(box.box);
        places = corners.filter(c => depth(c) > 0.3).map(project);
        if (!places.length) continue;
        path = edgePath(edgesOf(places), corners, clipAt(0.3, depth), project);
      } else {
        if ((box.camera ?? 0) !== scene.camera) continue;
        const [l, t, r, b] = box.picture;
        places = [at([l, t]), at([r, b])];
        path = new Path2D();
        path.rect(...places[0], places[1][0] - places[0][0], places[1][1] - places[0][1]);
      }
      strokeBox(context, box, path, true);
      const seen = extent(box, places);
      if (seen.right < 0 || seen.left > width || seen.bottom < 0 || seen.top > height) continue;
      this.drawn.push(seen);
      if (box.score !== undefined || box.host || box.tag) tags.push({box, seen});
    }
    this.tags(context, tags, objects, width, height);
  }

  // Scores over the boxes or below, where they hide no object; a drive's vehicle and tracks, the host and
  // its own detection, then the surest first.
  tags(context, tags, objects, width, height) {
    context.font = "600 11px system-ui, 'Liberation Sans', sans-serif";
    const taken = [...objects];
    const rank = ({box}) => box.kind === "mark" ? 4 : box.tag ? 3 : box.host ? 2 : box.own ? 1 : box.score;
    tags.sort((a, b) => rank(b) - rank(a));
    for (const {box, seen} of tags) {
      const text = box.tag ?? (box.score !== undefined ? box.score.toFixed(2) : "host"), w = context.measureText(text).width + 8, h = 15;
      for (const top of [seen.top - h - 2, seen.bottom + 2, seen.top - 2 * h - 4, seen.bottom + h + 4]) {
        const left = Math.max(1, Math.min(width - w - 1, (seen.left + seen.right - w) / 2));
        if (top < 1 || top + h > height - 1 || left < 80 && top < 28) continue; // the panel's name stands there
        if (taken.some(t => left < t[0] + t[2] + 2 && t[0] < left + w + 2 && top < t[1] + t[3] + 2 && t[1] < top + h + 2)) continue;
        taken.push([left, top, w, h]);
        context.fillStyle = boxColour(box, true);
        context.beginPath();
        context.roundRect(left, top, w, h, 3);
        context.fill();
        context.fillStyle = "#0c1015";
        context.fillText(text, left + 4, top + 11.5);
        break;
      }
    }
  }

  boxAt(u, v) { return boxAt(this.drawn, u, v); }
  reset() { Object.assign(this.zoom, {scale: 1, u: 0.5, v: 0.5}); }
}

// Dragging, pinching and the wheel on a canvas. drag(du, dv, shifted), zoom(factor, u, v).
function followPointer(canvas, act) {
  const held = new Map();
  const place = event => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, place(event));
  });
  canvas.addEventListener("pointermove", event => {
    if (!held.has(event.pointerId)) return;
    const before = held.get(event.pointerId), now = place(event), others = [...held].filter(([id]) => id !== event.pointerId);
    held.set(event.pointerId, now);
    if (others.length) {
      const [u, v] = others[0][1], apart = p => Math.hypot(p[0] - u, p[1] - v) || 1;
      act.zoom(apart(now) / apart(before), u, v);
    } else act.drag(now[0] - before[0], now[1] - before[1], event.shiftKey || (event.buttons & 2) !== 0);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => held.delete(event.pointerId));
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    act.zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)), ...place(event));
  }, {passive: false});
}
