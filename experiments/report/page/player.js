// The player: two event streams, the epipolar line of each drone position in the other view, and an
// offset between the clocks that the reader drags. All data come from the page itself.
"use strict";
(() => {
  const root = document.getElementById("player");
  const data = JSON.parse(document.getElementById("player-data").textContent);
  const find = (name) => root.querySelector(`[data-part="${name}"]`);
  const slider = find("slider"), dot = find("dot"), playButton = find("play");
  const calm = matchMedia("(prefers-reduced-motion: reduce)");

  const SPEED = 0.4; // of real time
  const HOLD_S = 5, EASE_S = 2; // the offset rests at each end, and takes so long from one to the other
  const FAR_PX = 3; // nearer than this, the drone is on the line

  // --- Data ---------------------------------------------------------------------------------------

  // 32 bits an event: 13 of time, 1 of polarity, 9 of y, 9 of x.
  const unpack = (view) => {
    const bytes = Uint8Array.from(atob(view.events), (c) => c.charCodeAt(0));
    const words = new DataView(bytes.buffer);
    const n = bytes.length / 4, scale = (data.trail + view.end + data.window) / 8192;
    const t = new Float32Array(n), xy = new Uint32Array(n), p = new Uint8Array(n);
    for (let i = 0; i < n; i++) {
      const word = words.getUint32(4 * i, true);
      t[i] = (word >>> 19) * scale - data.trail;
      p[i] = (word >>> 18) & 1;
      xy[i] = ((word >>> 9) & 511) * data.width + (word & 511);
    }
    return { t, xy, p };
  };

  const views = data.views.map((view, i) => {
    const canvas = find(`view${i + 1}`);
    const small = document.createElement("canvas");
    small.width = data.width;
    small.height = data.height;
    const pen = small.getContext("2d");
    return { canvas, small, pen, image: pen.createImageData(data.width, data.height),
      clock: find(`clock${i + 1}`), events: unpack(view), track: view.track };
  });

  const firstAfter = (times, time) => {
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < time) low = middle + 1; else high = middle;
    }
    return low;
  };

  // The position between two samples; null next to an instant at which the drone is not well seen.
  const between = (track, time) => {
    const place = Math.min(Math.max(time / data.step, 0), track.length - 1);
    const i = Math.min(Math.floor(place), track.length - 2), part = place - i;
    const a = track[i], b = track[i + 1];
    if (a[0] === null || b[0] === null) return null;
    return [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])];
  };

  // l1 = F' p2 in camera 1, l2 = F p1 in camera 2.
  const lineOf = (camera, point) => [0, 1, 2].map((row) => {
    const f = (column) => (camera === 0 ? data.F[column][row] : data.F[row][column]);
    return f(0) * point[0] + f(1) * point[1] + f(2);
  });

  const footOf = (line, point) => {
    const off = (line[0] * point[0] + line[1] * point[1] + line[2]) / (line[0] ** 2 + line[1] ** 2);
    return [point[0] - off * line[0], point[1] - off * line[1]];
  };

  const curveAt = (offset) => {
    const { offsets, curve } = data;
    const i = Math.min(Math.max(firstAfter(offsets, offset), 1), offsets.length - 1);
    const part = (offset - offsets[i - 1]) / (offsets[i] - offsets[i - 1]);
    return curve[i - 1] + part * (curve[i] - curve[i - 1]);
  };
  const offsetEnd = data.offsets[data.offsets.length - 1];

  // --- State --------------------------------------------------------------------------------------

  let time = data.still, offset = 0, playing = false;
  let tour = true; // the offset goes to and fro by itself, until the reader takes it
  let tourClock = 0, ease = null, frame = 0, last = 0, visible = true;

  const smooth = (part) => part * part * (3 - 2 * part);
  const tourOffset = (clock) => {
    const at = clock % (2 * (HOLD_S + EASE_S));
    if (at < HOLD_S) return 0;
    if (at < HOLD_S + EASE_S) return data.found * smooth((at - HOLD_S) / EASE_S);
    if (at < 2 * HOLD_S + EASE_S) return data.found;
    return data.found * (1 - smooth((at - 2 * HOLD_S - EASE_S) / EASE_S));
  };

  const step = (now) => {
    const passed = Math.min((now - last) / 1000, 0.1);
    last = now;
    if (playing) {
      time += SPEED * passed;
      if (time > data.length) time = 0;
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
    offset = Math.min(Math.max(target, 0), offsetEnd);
    wake();
  };

  // --- Drawing ------------------------------------------------------------------------------------

  const paint = () => {
    const style = getComputedStyle(root);
    const color = (name) => style.getPropertyValue(name).trim();
    return { cameras: [color("--cam1"), color("--cam2")], gap: color("--gap"), ink: color("--ink"),
      faint: color("--faint"), halo: color("--screen") };
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
    const { t, xy, p } = view.events;
    const pixels = view.image.data;
    pixels.fill(0);
    for (let i = firstAfter(t, now - data.trail), end = firstAfter(t, now + data.window); i < end; i++) {
      const past = now - data.window - t[i], at = 4 * xy[i];
      const rgb = data.colors[camera][1 - p[i]];
      pixels[at] = rgb[0];
      pixels[at + 1] = rgb[1];
      pixels[at + 2] = rgb[2];
      pixels[at + 3] = past <= 0 ? 255 : 255 * data.faded * Math.exp(-past / data.fade);
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

  const drawView = (view, camera, points) => {
    const now = time + camera * offset;
    drawEvents(view, camera, now);
    const ratio = fit(view.canvas);
    const pen = view.canvas.getContext("2d"), scale = view.canvas.width / data.width;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, view.canvas.width, view.canvas.height);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(view.small, 0, 0, view.canvas.width, view.canvas.height);
    view.clock.textContent = `${(data.start + now).toFixed(2)} s`;
    // Pixel centres are at whole coordinates.
    pen.setTransform(scale, 0, 0, scale, 0.5 * scale, 0.5 * scale);
    const unit = ratio / scale; // one CSS pixel
    pen.lineCap = "round";
    const [point, other] = [points[camera], points[1 - camera]];
    let distance = null;
    if (other) {
      const line = lineOf(camera, other);
      const length = Math.hypot(line[0], line[1]);
      const foot = footOf(line, point || [data.width / 2, data.height / 2]);
      const along = [-line[1] / length, line[0] / length].map((c) => 2 * data.width * c);
      const ends = [1, -1].map((side) => [foot[0] + side * along[0], foot[1] + side * along[1]]);
      stroke(pen, ends[0], ends[1], colors.halo, 5 * unit);
      stroke(pen, ends[0], ends[1], colors.cameras[1 - camera], 2 * unit);
      if (point) {
        distance = Math.hypot(point[0] - foot[0], point[1] - foot[1]);
        stroke(pen, point, foot, colors.gap, 3 * unit);
      }
    }
    if (point) {
      pen.lineWidth = 2 * unit;
      spot(pen, point, 6.5 * unit, colors.halo, true);
      spot(pen, point, 4.5 * unit, colors.ink, true);
    }
    return distance;
  };

  const plan = find("plan");
  const drawPlan = () => {
    const ratio = fit(plan), pen = plan.getContext("2d");
    const { cameras, sights, path } = data.plan;
    const at = (t) => path[Math.round(Math.min(Math.max(t / data.step, 0), path.length - 1))];
    const xs = [...cameras, ...path].map((c) => c[0]), ys = [...cameras, ...path].map((c) => c[1]);
    const [left, right] = [Math.min(...xs) - 1, Math.max(...xs) + 1];
    const [low, high] = [Math.min(...ys) - 0.8, Math.max(...ys) + 0.8];
    const scale = Math.min(plan.width / (right - left), plan.height / (high - low));
    const shift = [plan.width / 2 - scale * (left + right) / 2, plan.height / 2 + scale * (low + high) / 2];
    const to = (c) => [shift[0] + scale * c[0], shift[1] - scale * c[1]];
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, plan.width, plan.height);
    pen.lineCap = pen.lineJoin = "round";
    pen.strokeStyle = colors.faint;
    pen.lineWidth = 1.5 * ratio;
    pen.beginPath();
    path.forEach((c, i) => (i ? pen.lineTo(...to(c)) : pen.moveTo(...to(c))));
    pen.stroke();
    // Where the drone is when camera 1's clock shows t, and when camera 2's shows t + offset.
    const seen = [at(time + data.true), at(time + offset)];
    cameras.forEach((centre, i) => {
      stroke(pen, to(centre), to(seen[i]), colors.cameras[i], 1.5 * ratio);
      const [c, s] = sights[i];
      pen.fillStyle = colors.cameras[i];
      pen.beginPath();
      [[0, 0], [0.75, 0.42], [0.75, -0.42]].forEach(([ahead, side], k) => {
        const corner = to([centre[0] + ahead * c - side * s, centre[1] + ahead * s + side * c]);
        if (k) pen.lineTo(...corner); else pen.moveTo(...corner);
      });
      pen.fill();
      pen.font = `600 ${12 * ratio}px system-ui, sans-serif`;
      pen.textAlign = "center";
      pen.textBaseline = "middle";
      pen.fillText(String(i + 1), ...to([centre[0] - 0.55 * c, centre[1] - 0.55 * s]));
    });
    seen.forEach((c, i) => {
      pen.lineWidth = 2 * ratio;
      spot(pen, to(c), (i ? 4.5 : 7.5) * ratio, colors.cameras[i], i === 1);
    });
  };

  const draw = () => {
    const points = [between(views[0].track, time), between(views[1].track, time + offset)];
    const distances = views.map((view, i) => drawView(view, i, points));
    drawPlan();
    const mean = curveAt(offset), ms = Math.round(1000 * offset);
    dot.style.left = `${100 * offset / offsetEnd}%`;
    dot.style.top = `${100 * (1 - mean / data.top)}%`;
    root.classList.toggle("together", mean < FAR_PX);
    slider.value = String(ms);
    slider.setAttribute("aria-valuetext", `${ms} milliseconds, mean distance ${mean.toFixed(1)} pixels`);
    find("offset").textContent = `${ms} ms`;
    find("mean").textContent = `${mean.toFixed(1)} px`;
    find("now").textContent = distances[0] === null ? "out of view" : `${distances[0].toFixed(1)} px`;
  };

  // --- The reader ---------------------------------------------------------------------------------

  slider.max = String(Math.round(1000 * offsetEnd));
  slider.addEventListener("input", () => take(Number(slider.value) / 1000));
  playButton.addEventListener("click", () => setPlaying(!playing));
  find("before").addEventListener("click", () => goTo(0));
  find("after").addEventListener("click", () => goTo(data.found));

  const plot = find("plot");
  const drag = (event) => {
    const box = plot.getBoundingClientRect();
    take(offsetEnd * (event.clientX - box.left) / box.width);
  };
  plot.addEventListener("pointerdown", (event) => {
    plot.setPointerCapture(event.pointerId);
    drag(event);
  });
  plot.addEventListener("pointermove", (event) => {
    if (plot.hasPointerCapture(event.pointerId)) drag(event);
  });

  const repaint = () => { colors = paint(); wake(); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  addEventListener("resize", wake);
  new IntersectionObserver(([entry]) => {
    visible = entry.isIntersecting;
    if (visible) wake();
  }).observe(root);

  document.documentElement.classList.add("js");
  setPlaying(!calm.matches);
  draw();
})();
