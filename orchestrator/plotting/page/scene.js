"use strict";
/* The docking motion in space: the rod's tip between the surfaces, and both satellites. Drawn on a plain canvas.

   scene: {time, tip: {offset, commanded, actual}, surfaces: [{name, distance}], normal, force, bodies}, where
   poses are {position: [id...], orientation: [id...] or null} and null stands for a coordinate that is 0. */
(() => {
  const scene = report.scene, box = document.getElementById("scene");
  if (!scene || !box) return;
  const canvas = box.querySelector("canvas"), context = canvas.getContext("2d");
  const time = report.values(scene.time), last = time.length - 1;
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  /* Vectors and quaternions (w, x, y, z). */
  const add = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const scaled = (a, k) => a.map((v) => v * k);
  const length = (a) => Math.sqrt(dot(a, a));
  const turned = ([w, ...u], v) => add(add(v, cross(u, v), 2 * w), cross(u, cross(u, v)), 2);
  const product = ([a, ...u], [b, ...v]) => [a * b - dot(u, v), ...add(add(scaled(v, a), u, b), cross(u, v))];
  const inverse = ([w, x, y, z]) => [w, -x, -y, -z];

  const reader = (id) => (id === null ? () => 0 : ((all) => (n) => all[n] ?? 0)(report.values(id, scene.time)));
  const vector = (ids) => { const all = ids.map(reader); return (n) => all.map((one) => one(n)); };
  const pose = (given) => ({ position: vector(given.position),
    orientation: given.orientation ? vector(given.orientation) : () => [1, 0, 0, 0] });
  const tips = {};
  for (const kind of ["commanded", "actual"]) {
    const frame = pose(scene.tip[kind]);
    tips[kind] = (n) => { const q = frame.orientation(n);
      return { at: add(frame.position(n), turned(q, scene.tip.offset)), along: turned(q, [1, 0, 0]) }; };
  }
  const force = vector(scene.force);
  const normal = scaled(scene.normal, 1 / length(scene.normal)), way = scaled(normal, -1);
  const bodies = (scene.bodies || []).map((one) => ({ ...one, ...pose(one) }));

  /* What the close view has to hold. */
  const distances = scene.surfaces.map((one) => one.distance);
  const gap = Math.max(...distances) - Math.min(...distances);
  let largest = 0, reach = gap, sum = [0, 0, 0], count = 0;
  const every = Math.max(1, Math.floor(last / 2000));
  for (let n = 0; n <= last; n += every) {
    largest = Math.max(largest, length(force(n)));
    sum = add(sum, tips.actual(n).at);
    count++;
  }
  const middleTip = scaled(sum, 1 / count);
  const center = add(middleTip, way, (Math.max(...distances) + Math.min(...distances)) / 2 - dot(way, middleTip));
  for (let n = 0; n <= last; n += every) {
    const off = add(tips.actual(n).at, center, -1);
    reach = Math.max(reach, length(add(off, way, -dot(off, way))) * 1.25);
  }
  const side = Math.abs(way[2]) < 0.9 ? cross(way, [0, 0, 1]) : cross(way, [0, 1, 0]);
  const across = scaled(side, 1 / length(side)), up = cross(across, way);

  const state = { view: "tip", yaw: -0.75, pitch: 0.42, zoom: 1, at: 0, playing: false, speed: 0.25, factor: 1 };
  let camera = null;

  function aim(target, size) {
    const [cy, sy, cp, sp] = [Math.cos(state.yaw), Math.sin(state.yaw), Math.cos(state.pitch), Math.sin(state.pitch)];
    const forward = [-cp * sy, cp * cy, -sp], right = [cy, sy, 0], upward = cross(right, forward);
    const scale = (state.zoom * Math.min(canvas.width * 0.62, canvas.height)) / size;
    camera = { scale, project(p) {
      const d = add(p, target, -1);
      return [canvas.width / 2 + scale * dot(d, right), canvas.height / 2 - scale * dot(d, upward), dot(d, forward)];
    } };
  }

  function path(points, close) {
    context.beginPath();
    points.forEach((p, i) => { const [x, y] = camera.project(p); i ? context.lineTo(x, y) : context.moveTo(x, y); });
    if (close) context.closePath();
  }

  function line(points, color, width, dash = []) {
    path(points, false);
    context.strokeStyle = color; context.lineWidth = width * devicePixelRatio; context.lineCap = "round";
    context.setLineDash(dash.map((d) => d * devicePixelRatio));
    context.stroke(); context.setLineDash([]);
  }

  function face(points, color, alpha, edge) {
    path(points, true);
    context.globalAlpha = alpha; context.fillStyle = color; context.fill(); context.globalAlpha = 1;
    context.strokeStyle = edge || color; context.lineWidth = devicePixelRatio; context.stroke();
  }

  function words(text, p, color, dx = 6, dy = -6) {
    const [x, y] = camera.project(p);
    context.font = `${12.5 * devicePixelRatio}px system-ui, sans-serif`;
    context.fillStyle = color;
    context.fillText(text, x + dx * devicePixelRatio, y + dy * devicePixelRatio);
  }

  function ball(p, radius, color, hollow) {
    const [x, y] = camera.project(p), r = Math.max(radius * camera.scale, 3 * devicePixelRatio);
    context.beginPath(); context.arc(x, y, r, 0, 2 * Math.PI);
    if (hollow) {
      context.strokeStyle = color; context.lineWidth = 1.5 * devicePixelRatio;
      context.setLineDash([4 * devicePixelRatio, 3 * devicePixelRatio]); context.stroke(); context.setLineDash([]);
      return;
    }
    const shade = context.createRadialGradient(x - r / 3, y - r / 3, r / 8, x, y, r);
    shade.addColorStop(0, "#fff"); shade.addColorStop(0.35, color); shade.addColorStop(1, color);
    context.fillStyle = shade; context.fill();
  }

  function arrow(from, to, color) {
    line([from, to], color, 3);
    const [x0, y0] = camera.project(from), [x1, y1] = camera.project(to);
    const turn = Math.atan2(y1 - y0, x1 - x0), s = 9 * devicePixelRatio;
    if (Math.hypot(x1 - x0, y1 - y0) < s / 2) return;
    context.beginPath(); context.moveTo(x1 + s * 0.6 * Math.cos(turn), y1 + s * 0.6 * Math.sin(turn));
    for (const w of [2.6, -2.6]) context.lineTo(x1 + s * Math.cos(turn + w), y1 + s * Math.sin(turn + w));
    context.closePath(); context.fillStyle = color; context.fill();
  }

  function axes(origin, size) {
    [["x", 1], ["y", 2], ["z", 3]].forEach(([name], i) => {
      const end = origin.map((v, k) => v + (k === i ? size : 0));
      line([origin, end], style("--soft"), 1.2);
      words(name, end, style("--soft"), 3, 3);
    });
  }

  function drawTip(n) {
    aim(center, 2.3 * Math.max(reach, gap * 1.3));
    const actual = tips.actual(n), commanded = tips.commanded(n), push = force(n), size = Math.max(reach, gap) * 0.75;
    const pressed = dot(push, way);
    const items = scene.surfaces.map((surface) => {
      const middle = add(center, way, surface.distance - dot(way, center));
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) =>
        add(add(middle, across, a * size), up, b * size));
      /* The front surface pushes against the way, the rear one along it. */
      const touched = surface.name === "front" ? pressed < 0 : pressed > 0;
      return [camera.project(middle)[2], () => {
        const color = style(touched ? "--series-1" : "--series-2");
        face(corners, color, touched ? 0.38 : 0.16);
        words(`${surface.name} surface`, corners[2], color, 4, -4);
      }];
    });
    const back = (tip) => add(tip.at, tip.along, -Math.max(2.2 * gap, 1.6 * reach));
    items.push([camera.project(actual.at)[2], () => {
      const trail = [];
      for (let k = n; k >= 0 && time[n] - time[k] < 0.4; k -= Math.max(1, Math.floor(every / 2))) trail.push(tips.actual(k).at);
      if (trail.length > 1) line(trail, style("--series-3"), 1.2);
      line([back(actual), actual.at], style("--series-0"), 5);
      ball(actual.at, gap * 0.09, style("--series-0"));
      line([back(commanded), commanded.at], style("--text"), 1, [4, 4]);
      ball(commanded.at, gap * 0.11, style("--text"), true);
      if (largest > 0 && length(push) > 1e-9 * largest) {
        /* Beside the rod, along which it may point. */
        const from = add(actual.at, up, 0.2 * gap);
        arrow(from, add(from, push, (1.1 * gap) / largest), style("--series-1"));
      }
    }]);
    items.sort((a, b) => b[0] - a[0]).forEach((one) => one[1]());
    axes(add(add(center, across, -1.15 * size), up, -1.15 * size), 0.35 * gap);
    const apart = length(add(actual.at, commanded.at, -1)), x = dot(actual.at, way);
    const free = scene.surfaces.map((one) => `${one.name} ${(Math.abs(one.distance - x) * 1e3).toFixed(2)} mm`
      + ((one.name === "front" ? x > one.distance : x < one.distance) ? " deep" : " off"));
    return [`robot (solid) off the satellites (dashed): ${(apart * 1e3).toFixed(3)} mm`, free.join(", "),
      `force ${length(push).toFixed(1)} N (largest ${largest.toFixed(1)} N)`];
  }

  function enlarged(body, n) {
    /* The motion from the start, times a factor. */
    const k = state.factor, p0 = body.position(0), q0 = body.orientation(0);
    const at = add(p0, add(body.position(n), p0, -1), k);
    let turn = product(body.orientation(n), inverse(q0));
    const angle = 2 * Math.atan2(length(turn.slice(1)), turn[0]), axis = turn.slice(1), size = length(axis);
    if (size > 1e-12) {
      turn = [Math.cos((k * angle) / 2), ...scaled(axis, Math.sin((k * angle) / 2) / size)];
    }
    return { at, q: product(turn, q0) };
  }

  function drawBodies(n) {
    const starts = bodies.map((one) => one.position(0));
    const middle = scaled(starts.reduce((a, b) => add(a, b)), 1 / starts.length);
    const extent = Math.max(...bodies.map((one, i) => length(add(starts[i], middle, -1)) + length(one.size) / 2));
    aim(middle, 2.3 * extent);
    const light = [0.4, -0.75, 0.9];
    const faces = [];
    bodies.forEach((body, index) => {
      const { at, q } = enlarged(body, n), half = scaled(body.size, 0.5);
      for (const axis of [0, 1, 2]) for (const sign of [-1, 1]) {
        const [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
        const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([s, t]) => {
          const local = [0, 0, 0];
          local[axis] = sign * half[axis]; local[b] = s * half[b]; local[c] = t * half[c];
          return add(at, turned(q, local));
        });
        const direction = [0, 0, 0]; direction[axis] = sign;
        const bright = 0.45 + 0.3 * Math.max(0, dot(turned(q, direction), light) / length(light));
        const depth = corners.reduce((s, p) => s + camera.project(p)[2], 0) / 4;
        faces.push([depth, () => face(corners, style(`--series-${index}`), bright, style("--back"))]);
      }
    });
    faces.sort((a, b) => b[0] - a[0]).forEach((one) => one[1]());
    bodies.forEach((body, index) => {
      const { at } = enlarged(body, n);
      words(body.name, add(at, [0, 0, body.size[2] * 0.62]), style(`--series-${index}`), -40, -4);
    });
    axes(add(middle, [-extent * 0.9, -extent * 0.6, -extent * 0.6]), extent * 0.25);
    return ["boxes of the satellites' mass and inertia, in the inertial frame", `motion enlarged ${state.factor} times`];
  }

  const slider = box.querySelector("input"), output = box.querySelector("output"), play = box.querySelector(".play");
  let wanted = false;

  function draw() {
    wanted = false;
    const wide = Math.max(box.clientWidth, 280), ratio = devicePixelRatio;
    const high = Math.round(Math.min(wide * 0.55, 480));
    if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
      canvas.width = Math.round(wide * ratio); canvas.height = Math.round(high * ratio);
    }
    context.clearRect(0, 0, canvas.width, canvas.height);
    const lines = state.view === "tip" ? drawTip(state.at) : drawBodies(state.at);
    context.font = `${12.5 * ratio}px system-ui, sans-serif`;
    context.fillStyle = style("--text");
    lines.forEach((text, i) => context.fillText(text, 10 * ratio, (20 + 17 * i) * ratio));
    slider.value = state.at;
    slider.setAttribute("aria-valuetext", `${time[state.at].toFixed(3)} s`);
    output.textContent = `${time[state.at].toFixed(3)} of ${time[last].toFixed(3)} s`;
  }
  const redraw = () => { if (!wanted) { wanted = true; requestAnimationFrame(draw); } };

  function rowAt(instant) {
    let low = 0, high = last;
    while (low < high) { const n = (low + high + 1) >> 1; if (time[n] <= instant) low = n; else high = n - 1; }
    return low;
  }

  let clock = null;
  function tick(now) {
    if (!state.playing) return;
    clock.instant += ((now - clock.now) / 1000) * state.speed;
    clock.now = now;
    if (clock.instant >= time[last]) { state.at = last; setPlaying(false); } else { state.at = rowAt(clock.instant); }
    redraw();
    requestAnimationFrame(tick);
  }
  function setPlaying(on) {
    state.playing = on;
    play.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (state.at >= last) state.at = 0;
    clock = { now: performance.now(), instant: time[state.at] };
    requestAnimationFrame(tick);
  }

  slider.max = last;
  play.addEventListener("click", () => setPlaying(!state.playing));
  slider.addEventListener("input", () => { state.at = Number(slider.value); if (clock) clock.instant = time[state.at]; redraw(); });
  for (const select of box.querySelectorAll("select")) {
    select.addEventListener("change", () => {
      const given = select.value;
      state[select.name] = select.name === "view" ? given : Number(given);
      state.zoom = select.name === "view" ? 1 : state.zoom;
      redraw();
    });
  }
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    let [x, y] = [event.clientX, event.clientY];
    const move = (moved) => {
      state.yaw -= (moved.clientX - x) * 0.008;
      state.pitch = Math.min(Math.max(state.pitch + (moved.clientY - y) * 0.008, -1.5), 1.5);
      [x, y] = [moved.clientX, moved.clientY];
      redraw();
    };
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerup", () => canvas.removeEventListener("pointermove", move), { once: true });
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.zoom = Math.min(Math.max(state.zoom * (event.deltaY < 0 ? 1.15 : 1 / 1.15), 0.2), 30);
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (turns) { state.yaw += turns[0]; state.pitch += turns[1]; }
    else if (event.key === "+" || event.key === "=") state.zoom *= 1.2;
    else if (event.key === "-") state.zoom /= 1.2;
    else if (event.key === " ") setPlaying(!state.playing);
    else return;
    event.preventDefault();
    redraw();
  });
  new ResizeObserver(redraw).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  /* The first contact says more than the start. */
  for (let n = 0; n <= last; n += every) if (length(force(n)) > 0.6 * largest && largest > 0) { state.at = n; break; }
  draw();
})();
