// The player: two event streams, the epipolar line of each position of the object in the other view,
// and an offset between the clocks that the reader moves; beside it the cameras and the object's path
// in space. All data come from the page itself.
"use strict";
(async () => {
  const root = document.getElementById("player");
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const find = (name) => root.querySelector(`[data-part="${name}"]`);
  const slider = find("slider"), timeSlider = find("time"), dot = find("dot"), playButton = find("play");
  const calm = matchMedia("(prefers-reduced-motion: reduce)");

  const SPEED = 0.4; // of real time
  const HOLD_S = 5, EASE_S = 2; // the offset rests at each end, and takes so long from one to the other
  const FAR_PX = 3; // nearer than this, the object is on the line
  const WINDOW_S = 0.02, TRAIL_S = 0.35; // events about now, and fading ones before
  const FADED = 0.42, FADE_S = 0.13; // opacity of an event past its window, and when it falls to 1/e
  // Of camera 1 and camera 2 (darker, brighter): legible on light and dark ground, and apart in grey.
  const COLORS = [[[36, 100, 176], [74, 151, 224]], [[198, 112, 20], [242, 166, 60]]];

  // --- Data ---------------------------------------------------------------------------------------

  // Bytes of equal worth stand side by side.
  const unpack = async (text, size) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = planes.length / size, values = size === 4 ? new Uint32Array(n) : new Int16Array(n);
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < size; k++) values[i] |= planes[k * n + i] << (8 * k);
    }
    return values;
  };

  const views = await Promise.all(data.views.map(async (view) => {
    const [counts, steps, track] = await Promise.all(
      [unpack(view.counts, 4), unpack(view.events, 4), unpack(view.track, 2)]);
    const starts = new Uint32Array(counts.length + 1);
    counts.forEach((count, f) => { starts[f + 1] = starts[f] + count; });
    const cells = new Uint32Array(steps.length), signs = new Uint8Array(steps.length);
    for (let f = 0; f < counts.length; f++) {
      for (let i = starts[f], cell = 0; i < starts[f + 1]; i++) {
        cell += steps[i] >>> 1;
        cells[i] = cell;
        signs[i] = steps[i] & 1;
      }
    }
    const small = document.createElement("canvas");
    small.width = view.columns;
    small.height = view.rows;
    const pen = small.getContext("2d");
    return { ...view, starts, cells, signs, track, small, pen, image: pen.createImageData(view.columns, view.rows),
      end: view.start + view.frame * counts.length };
  }));

  // The position between two samples; null next to an instant at which the object is not well seen.
  const positionAt = (view, time) => {
    const place = (time - view.start) / view.frame, i = Math.floor(place), part = place - i;
    if (i < 0 || i >= view.track.length / 2 - 1) return null;
    const at = (k) => view.track[k];
    if (at(2 * i) === -32768 || at(2 * i + 2) === -32768) return null;
    return [0, 1].map((axis) => (axis ? view.top : view.left) + view.unit
      * ((1 - part) * at(2 * i + axis) + part * at(2 * i + 2 + axis)));
  };

  // l1 = F' p2 in camera 1, l2 = F p1 in camera 2.
  const lineOf = (F, camera, point) => [0, 1, 2].map((row) => {
    const f = (column) => (camera === 0 ? F[column][row] : F[row][column]);
    return f(0) * point[0] + f(1) * point[1] + f(2);
  });

  const footOf = (line, point) => {
    const off = (line[0] * point[0] + line[1] * point[1] + line[2]) / (line[0] ** 2 + line[1] ** 2);
    return [point[0] - off * line[0], point[1] - off * line[1]];
  };

  const interpolated = (xs, ys, x) => {
    if (!xs.length || x <= xs[0]) return ys[0] || 0;
    const i = xs.findIndex((value) => value > x);
    if (i < 0) return ys[ys.length - 1];
    return ys[i - 1] + (x - xs[i - 1]) / (xs[i] - xs[i - 1]) * (ys[i] - ys[i - 1]);
  };

  // --- State --------------------------------------------------------------------------------------

  let pair, shown, time = 0, offset = 0, playing = false;
  let tour = data.tour; // the offset goes to and fro by itself, until the reader takes it
  let tourClock = 0, ease = null, frame = 0, last = 0, visible = true;

  const onClock2 = (t) => t + offset + pair.skew * (t - pair.t_ref) + interpolated(pair.knots, pair.strays, t);
  const middle = () => (pair.found === null ? (pair.low + pair.high) / 2 : pair.found);
  const curveAt = (value) => {
    const place = (value - pair.low) / (pair.high - pair.low) * (pair.curve.length - 1);
    return pair.curve[Math.min(Math.max(Math.round(place), 0), pair.curve.length - 1)];
  };
  const inWords = (seconds, digits = 1) => (Math.abs(seconds) < 1
    ? `${(1000 * seconds).toFixed(digits)} ms` : `${seconds.toFixed(digits + 2)} s`);

  const smooth = (part) => part * part * (3 - 2 * part);
  const tourOffset = (clock) => {
    const at = clock % (2 * (HOLD_S + EASE_S)), way = middle() - pair.before;
    if (at < HOLD_S) return pair.before;
    if (at < HOLD_S + EASE_S) return pair.before + way * smooth((at - HOLD_S) / EASE_S);
    if (at < 2 * HOLD_S + EASE_S) return middle();
    return middle() - way * smooth((at - 2 * HOLD_S - EASE_S) / EASE_S);
  };

  const choose = (index) => {
    pair = data.pairs[index];
    shown = pair.cameras.map((k) => views[k]);
    offset = tour ? pair.before : middle();
    time = Math.min(Math.max(pair.still, shown[0].start), shown[0].end);
    ease = null;
    const worst = Math.max(...pair.curve.map((px) => px ?? 0));
    pair.worst = 1.08 * worst || 1;
    find("line").setAttribute("d", pair.curve.map((px, i) => (px === null ? "" : `${
      i && pair.curve[i - 1] !== null ? "L" : "M"}${1000 * i / (pair.curve.length - 1)} ${1000 * (1 - px / pair.worst)}`)).join("") || "M0 0");
    const mark = find("found"), percent = 100 * (middle() - pair.low) / (pair.high - pair.low);
    mark.hidden = pair.found === null;
    mark.textContent = `${pair.holds ? "found" : "best, not reliable"}: ${inWords(middle(), 2)}`;
    mark.style.left = `${percent}%`;
    mark.classList.toggle("left", percent > 60);
    find("curve").hidden = worst === 0;
    root.classList.toggle("blind", !pair.F);
    find("before").hidden = pair.found === null && pair.before !== 0;
    find("before").textContent = pair.before === 0 ? "As recorded" : `${inWords(pair.before - middle())} off`;
    find("after").hidden = pair.found === null;
    find("after").textContent = pair.holds ? "Synchronised" : "Best offset";
    timeSlider.max = String(Math.round((shown[0].end - shown[0].start) / shown[0].frame));
    shown.forEach((view, i) => {
      find(`name${i + 1}`).textContent = `Camera ${pair.cameras[i] + 1}`;
      find(`view${i + 1}`).style.setProperty("--shape", `${view.columns} / ${view.rows}`);
    });
    wake();
  };

  const step = (now) => {
    const passed = Math.min((now - last) / 1000, 0.1);
    last = now;
    if (playing) {
      time += SPEED * passed;
      if (time > shown[0].end) time = shown[0].start;
    }
    if (ease) {
      ease.part = Math.min(1, ease.part + passed / EASE_S);
      offset = ease.from + (ease.to - ease.from) * smooth(ease.part);
      if (ease.part === 1) ease = null;
    } else if (tour && playing) {
      tourClock += passed;
      offset = tourOffset(tourClock);
    }
    draw();
    frame = visible && (playing || ease) ? requestAnimationFrame(step) : 0;
  };
  const wake = () => {
    if (frame) return;
    last = performance.now();
    frame = requestAnimationFrame(step);
  };

  const setPlaying = (on) => {
    playing = on;
    playButton.textContent = on ? "Pause" : "Play";
    wake();
  };
  const goTo = (target) => {
    tour = false;
    if (calm.matches) offset = target; else ease = { from: offset, to: target, part: 0 };
    wake();
  };
  const take = (target) => {
    tour = false;
    ease = null;
    offset = Math.min(Math.max(target, pair.low), pair.high);
    wake();
  };

  // --- Drawing ------------------------------------------------------------------------------------

  const paint = () => {
    const style = getComputedStyle(root);
    const color = (name) => style.getPropertyValue(name).trim();
    return { cameras: [color("--cam1"), color("--cam2")], gap: color("--gap"), ink: color("--ink"),
      soft: color("--soft"), faint: color("--faint"), halo: color("--screen") };
  };
  let colors = paint();

  const fit = (canvas) => {
    const ratio = Math.min(devicePixelRatio || 1, 3);
    const width = Math.round(canvas.clientWidth * ratio);
    const height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    return ratio;
  };

  const drawEvents = (view, camera, now) => {
    const pixels = view.image.data, frames = view.starts.length - 1;
    const frameAt = (t) => Math.min(Math.max(Math.floor((t - view.start) / view.frame), 0), frames);
    pixels.fill(0);
    for (let f = frameAt(now - TRAIL_S), end = frameAt(now + WINDOW_S + view.frame); f < end; f++) {
      const past = now - WINDOW_S - (view.start + (f + 0.5) * view.frame);
      const alpha = past <= 0 ? 255 : 255 * FADED * Math.exp(-past / FADE_S);
      for (let i = view.starts[f]; i < view.starts[f + 1]; i++) {
        const at = 4 * view.cells[i], rgb = COLORS[camera][view.signs[i]];
        pixels[at] = rgb[0];
        pixels[at + 1] = rgb[1];
        pixels[at + 2] = rgb[2];
        pixels[at + 3] = alpha;
      }
    }
    view.pen.putImageData(view.image, 0, 0);
  };

  const stroke = (pen, from, to, color, width) => {
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.beginPath();
    pen.moveTo(...from);
    pen.lineTo(...to);
    pen.stroke();
  };

  const spot = (pen, at, radius, color, filled) => {
    pen.beginPath();
    pen.arc(at[0], at[1], radius, 0, 2 * Math.PI);
    pen.fillStyle = color;
    pen.strokeStyle = color;
    if (filled) pen.fill(); else pen.stroke();
  };

  const drawView = (camera, now, points) => {
    const view = shown[camera], canvas = find(`view${camera + 1}`);
    drawEvents(view, camera, now);
    const ratio = fit(canvas);
    const width = view.columns * view.cell; // [px]
    const pen = canvas.getContext("2d"), scale = canvas.width / width;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(view.small, 0, 0, canvas.width, canvas.height);
    find(`clock${camera + 1}`).textContent = now < view.start || now > view.end ? `${now.toFixed(2)} s: not recorded` : `${now.toFixed(2)} s`;
    pen.setTransform(scale, 0, 0, scale, -view.left * scale, -view.top * scale);
    const unit = ratio / scale; // one CSS pixel
    pen.lineCap = "round";
    const [point, other] = [points[camera], points[1 - camera]];
    let distance = null;
    if (other && pair.F) {
      const line = lineOf(pair.F, camera, other);
      const length = Math.hypot(line[0], line[1]);
      const foot = footOf(line, point || [view.left + width / 2, view.top + view.rows * view.cell / 2]);
      const along = [-line[1] / length, line[0] / length].map((c) => 2 * width * c);
      const ends = [1, -1].map((side) => [foot[0] + side * along[0], foot[1] + side * along[1]]);
      stroke(pen, ends[0], ends[1], colors.halo, 5 * unit);
      stroke(pen, ends[0], ends[1], colors.cameras[1 - camera], 2 * unit);
      if (point) {
        distance = Math.hypot(point[0] - foot[0], point[1] - foot[1]);
        stroke(pen, point, foot, colors.gap, 3 * unit);
      }
    }
    if (point) {
      [[5, colors.halo], [2, colors.ink]].forEach(([thick, color]) => { // a ring: the object may be tiny
        pen.lineWidth = thick * unit;
        spot(pen, point, 6.5 * unit, color, false);
      });
    }
    return distance;
  };

  // --- The scene: parallel rays, turned about the vertical and tilted -------------------------------

  const scene = data.scene, sceneCanvas = find("scene"), turn = find("turn"), tilt = find("tilt");
  const bounds = scene && (() => {
    const all = [...scene.path, ...scene.cameras.map((camera) => camera.centre)];
    const centre = [0, 1, 2].map((k) => {
      const values = all.map((p) => p[k]);
      return (Math.min(...values) + Math.max(...values)) / 2;
    });
    return { centre, radius: Math.max(...all.map((p) => Math.hypot(...p.map((c, k) => c - centre[k])))) };
  })();

  const drawScene = () => {
    if (!scene || !sceneCanvas.clientWidth) return;
    const ratio = fit(sceneCanvas), pen = sceneCanvas.getContext("2d");
    const { width, height } = sceneCanvas, scale = Math.min(width, height) / (2.2 * bounds.radius);
    const [a, b] = [turn, tilt].map((input) => Number(input.value) * Math.PI / 180);
    const turned = ([x, y, z]) => {
      const ahead = Math.cos(a) * z - Math.sin(a) * x;
      return [Math.cos(a) * x + Math.sin(a) * z, Math.cos(b) * y - Math.sin(b) * ahead];
    };
    const to = (p) => {
      const [x, y] = turned(p.map((c, k) => c - bounds.centre[k]));
      return [width / 2 + scale * x, height / 2 + scale * y];
    };
    const moved = (p, axis, by) => p.map((c, k) => c + by * axis[k]);
    const cross = (at, axes, color) => axes.forEach((axis) => {
      const by = scene.larger;
      stroke(pen, to(moved(at, axis, -by)), to(moved(at, axis, by)), color, 1.2 * ratio);
    });
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.lineCap = pen.lineJoin = "round";
    pen.font = `600 ${12 * ratio}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const ends = new Set(scene.ends);
    scene.crosses[0].forEach((place, i) => cross(place, scene.crosses[1][i], colors.faint));
    pen.strokeStyle = colors.soft;
    pen.lineWidth = 1.6 * ratio;
    pen.beginPath();
    scene.path.forEach((p, i) => (i && !ends.has(i - 1) ? pen.lineTo(...to(p)) : pen.moveTo(...to(p))));
    pen.stroke();
    // Where the object is when each camera sees what is shown of it.
    const first = scene.cameras.find((one) => one.k === pair.cameras[0]);
    const seen = scene.cameras.flatMap((camera) => {
      const i = pair.cameras.indexOf(camera.k);
      if (i < 0 || !first) return [];
      const t = time - first.later + (i ? offset - middle() : 0), k = scene.times.findIndex((one) => one >= t);
      return [{ i, camera, at: k < 1 || ends.has(k - 1) ? null : scene.path[k] }];
    });
    seen.forEach(({ i, camera, at }) => at && stroke(pen, to(camera.centre), to(at), colors.cameras[i], 1.2 * ratio));
    scene.cameras.forEach((camera) => {
      const i = pair.cameras.indexOf(camera.k), color = i < 0 ? colors.soft : colors.cameras[i];
      const size = 0.16 * bounds.radius;
      const corners = [[-1, -0.75], [1, -0.75], [1, 0.75], [-1, 0.75]].map(([x, y]) => {
        const p = [0.5 * size * x, 0.5 * size * y, size];
        return camera.centre.map((c, k) => c + camera.R[0][k] * p[0] + camera.R[1][k] * p[1] + camera.R[2][k] * p[2]);
      });
      corners.forEach((corner, k) => {
        stroke(pen, to(camera.centre), to(corner), color, 1.6 * ratio);
        stroke(pen, to(corner), to(corners[(k + 1) % 4]), color, 1.6 * ratio);
      });
      cross(camera.centre, camera.axes, colors.gap);
      const behind = camera.centre.map((c, k) => c - 0.6 * size * camera.R[2][k]);
      pen.fillStyle = color;
      pen.fillText(String(camera.k + 1), ...to(behind));
    });
    seen.forEach(({ i, at }) => {
      if (!at) return;
      pen.lineWidth = 2 * ratio;
      spot(pen, to(at), (i ? 4.5 : 7.5) * ratio, colors.cameras[i], i === 1);
    });
    const corner = [28 * ratio, height - 28 * ratio];
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]].forEach((axis, k) => {
      const [x, y] = turned(axis);
      stroke(pen, corner, [corner[0] + 16 * ratio * x, corner[1] + 16 * ratio * y], colors.soft, 1.2 * ratio);
      pen.fillStyle = colors.soft;
      pen.fillText("xyz"[k], corner[0] + 24 * ratio * x, corner[1] + 24 * ratio * y);
    });
  };

  const draw = () => {
    const now = [time, onClock2(time)];
    const points = now.map((t, i) => positionAt(shown[i], t));
    const distances = now.map((t, i) => drawView(i, t, points));
    drawScene();
    const mean = curveAt(offset), part = (offset - pair.low) / (pair.high - pair.low);
    dot.style.left = `${100 * part}%`;
    dot.style.top = `${100 * (1 - (mean ?? 0) / pair.worst)}%`;
    root.classList.toggle("together", mean !== null && mean < FAR_PX);
    const px = (value, none) => (value === null ? none : `${value.toFixed(1)} px`);
    slider.value = String(Math.round(1000 * part));
    slider.setAttribute("aria-valuetext", `${inWords(offset)}, mean distance ${px(mean, "not known")}`);
    timeSlider.value = String(Math.round((time - shown[0].start) / shown[0].frame));
    timeSlider.setAttribute("aria-valuetext", `${(time - shown[0].begin).toFixed(2)} seconds after the start of the first camera`);
    find("offset").textContent = inWords(offset);
    find("mean").textContent = px(mean, "–");
    find("now").textContent = px(distances[0], pair.F ? "out of view" : "–");
  };

  // --- The reader ---------------------------------------------------------------------------------

  slider.addEventListener("input", () => take(pair.low + (pair.high - pair.low) * Number(slider.value) / 1000));
  timeSlider.addEventListener("input", () => {
    setPlaying(false);
    time = shown[0].start + shown[0].frame * Number(timeSlider.value);
    wake();
  });
  playButton.addEventListener("click", () => setPlaying(!playing));
  find("before").addEventListener("click", () => goTo(pair.before));
  find("after").addEventListener("click", () => goTo(pair.found));
  document.getElementById("pair")?.addEventListener("change", (event) => choose(Number(event.target.value)));

  const dragged = (element, start, move) => {
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      start(event);
    });
    element.addEventListener("pointermove", (event) => {
      if (element.hasPointerCapture(event.pointerId)) move(event);
    });
  };
  const curve = find("curve");
  const onCurve = (event) => {
    const box = curve.getBoundingClientRect();
    take(pair.low + (pair.high - pair.low) * (event.clientX - box.left) / box.width);
  };
  dragged(curve, onCurve, onCurve);
  dragged(sceneCanvas, () => {}, (event) => {
    turn.value = String((Number(turn.value) + 0.5 * event.movementX + 540) % 360 - 180);
    tilt.value = String(Number(tilt.value) + 0.5 * event.movementY);
    wake();
  });
  [turn, tilt].forEach((input) => input.addEventListener("input", wake));

  const repaint = () => { colors = paint(); wake(); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  addEventListener("resize", wake);
  new IntersectionObserver(([entry]) => {
    visible = entry.isIntersecting;
    if (visible) wake();
  }).observe(root);

  choose(data.first);
  setPlaying(data.tour && !calm.matches);
  root.dataset.ready = "";
})();
