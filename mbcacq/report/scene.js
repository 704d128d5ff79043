"use strict";
// The view that turns: points and the arm on a canvas, drawn from back to front by depth. data: groups of points by name and colour, the
// arm; of a plan also boxes, and poses with their own arm, field of view and balls seen. Returns a function that shows a pose by its number.
const turningView = (canvas, data) => {
  const context = canvas.getContext("2d"), poses = data.poses || [], boxes = data.boxes || [];
  const colour = (name, usual) => getComputedStyle(canvas).getPropertyValue(name).trim() || usual;
  const all = data.groups.flatMap((g) => g.points).concat(data.arm, boxes.flat(), poses.flatMap((pose) => pose.arm));
  let shown = 0;
  const low = [0, 1, 2].map((k) => Math.min(0, ...all.map((p) => p[k])));
  const high = [0, 1, 2].map((k) => Math.max(0, ...all.map((p) => p[k])));
  const step = 200;  // mm, of the floor's grid, which is widened to whole fields
  for (const k of [0, 1]) low[k] = Math.floor(low[k] / step) * step, high[k] = Math.ceil(high[k] / step) * step;
  const middle = low.map((v, k) => (v + high[k]) / 2);
  const corners = Array.from({ length: 8 }, (_, n) => low.map((v, k) => ((n >> k) & 1 ? high[k] : v)));
  let turn = -0.9, tilt = 0.45, zoom = 1;
  const ratio = window.devicePixelRatio || 1;
  const shape = () => {
    canvas.width = Math.round(ratio * (canvas.clientWidth || 1000));
    canvas.height = Math.round(canvas.width * (canvas.clientWidth < 600 ? 0.8 : 0.52));
  };
  const turned = (p) => {  // mm to the right, up and away from the viewer
    const [x, y, z] = p.map((v, k) => v - middle[k]);
    const right = x * Math.cos(turn) - y * Math.sin(turn), away = x * Math.sin(turn) + y * Math.cos(turn);
    return [right, z * Math.cos(tilt) + away * Math.sin(tilt), away * Math.cos(tilt) - z * Math.sin(tilt)];
  };
  const span = [0, 1].map((k) => 2 * Math.max(1, ...corners.map((p) => Math.abs(turned(p)[k]))));  // as the view opens, all of it is seen
  const links = (arm, radii) => {  // from the farthest to the nearest; three corners a link, then the scanner
    const each = arm.slice(1).map((p, k) => [arm[k], p, k < 3 * radii.length - 1 ? radii[Math.floor(k / 3)] : 8]);
    const away = ([a, b]) => turned(a)[2] + turned(b)[2];
    return each.sort((a, b) => away(b) - away(a));
  };
  const draw = () => {
    const width = canvas.width, height = canvas.height, unit = zoom * 0.94 * Math.min(width / span[0], height / span[1]);
    const place = (p) => {
      const [right, up, away] = turned(p);
      return [width / 2 + unit * right, height / 2 - unit * up, away];
    };
    const line = (points, shade, thick) => {
      context.strokeStyle = shade;
      context.lineWidth = thick * ratio;
      context.beginPath();
      points.map(place).forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.stroke();
    };
    context.clearRect(0, 0, width, height);
    context.lineJoin = context.lineCap = "round";
    const floor = low[2], grid = colour("--scene-grid", "#e4e4e4"), pose = poses[shown];
    for (let x = low[0]; x <= high[0]; x += step) line([[x, low[1], floor], [x, high[1], floor]], grid, 1);
    for (let y = low[1]; y <= high[1]; y += step) line([[low[0], y, floor], [high[0], y, floor]], grid, 1);
    const frame = (c, shade, thick) => {
      for (const k of [0, 4]) line([c[k], c[k + 1], c[k + 2], c[k + 3], c[k]], shade, thick);
      for (const k of [0, 1, 2, 3]) line([c[k], c[k + 4]], shade, thick);
    };
    boxes.forEach((c) => frame(c, colour("--scene-box", "#b08d57"), 1));
    const arm = pose ? pose.arm : data.arm;
    links(arm, data.radii || []).forEach(([a, b, radius]) => {  // a capsule is a broad line, darker along its edges
      line([a, b], colour("--scene-bone", "#6b7178"), (1.6 * radius * unit) / ratio);
      line([a, b], colour("--scene-arm", "#b9bec4"), (1.2 * radius * unit) / ratio);
    });
    if (pose) {
      frame(pose.view, colour("--scene-view", "#0072b2"), 1.2);
      const eye = pose.arm[pose.arm.length - 1];
      pose.seen.forEach((ball) => line([eye, ball], colour("--scene-view", "#0072b2"), 0.6));
    }
    context.font = `${14 * ratio}px Helvetica, Arial, sans-serif`;
    [["X", [150, 0, 0], "#c0392b"], ["Y", [0, 150, 0], "#1e8449"], ["Z", [0, 0, 150], "#3b82c4"]].forEach(([name, end, shade]) => {
      line([[0, 0, 0], end], shade, 3);
      const [x, y] = place(end);
      context.fillStyle = shade;
      context.fillText(name, x + 4, y - 4);
    });
    const seen = pose ? [{ name: "seen from this pose", colour: pose.colour, points: pose.seen, size: 5.5 }] : [];
    const groups = data.groups.concat(seen);
    const dots = groups.flatMap((g) => g.points.map((p) => [...place(p), g.colour, g.size || 3.2]));
    dots.sort((a, b) => b[2] - a[2]).forEach(([x, y, , shade, size]) => {
      context.fillStyle = shade;
      context.beginPath();
      context.arc(x, y, size * ratio, 0, 7);
      context.fill();
    });
    groups.forEach((g, k) => {
      context.fillStyle = g.colour;
      context.fillRect(12 * ratio, (12 + 22 * k) * ratio, 12 * ratio, 12 * ratio);
      context.fillStyle = colour("--scene-ink", "#222");
      context.fillText(g.name, 30 * ratio, (23 + 22 * k) * ratio);
    });
  };
  const held = new Map();
  let apart = 0;
  canvas.addEventListener("pointerdown", (e) => { held.set(e.pointerId, e); canvas.setPointerCapture(e.pointerId); apart = 0; });
  ["pointerup", "pointercancel"].forEach((name) => canvas.addEventListener(name, (e) => { held.delete(e.pointerId); apart = 0; }));
  canvas.addEventListener("pointermove", (e) => {
    const before = held.get(e.pointerId);
    if (!before) return;
    held.set(e.pointerId, e);
    if (held.size > 1) {
      const [a, b] = Array.from(held.values()), now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      if (apart) zoom = Math.min(8, Math.max(0.3, (zoom * now) / apart));
      apart = now;
    } else {
      turn += 0.008 * (e.clientX - before.clientX);
      tilt = Math.min(1.57, Math.max(-1.57, tilt + 0.008 * (e.clientY - before.clientY)));
    }
    draw();
  });
  canvas.tabIndex = 0;
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1], "+": 1.15, "-": 1 / 1.15 };
  canvas.addEventListener("keydown", (e) => {
    const by = keys[e.key];
    if (!by || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    if (typeof by === "number") zoom = Math.min(8, Math.max(0.3, zoom * by));
    else turn += by[0], tilt = Math.min(1.57, Math.max(-1.57, tilt + by[1]));
    draw();
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom = Math.min(8, Math.max(0.3, zoom * Math.exp(-0.001 * e.deltaY))); draw(); }, { passive: false });
  shape();
  draw();
  window.addEventListener("resize", () => { shape(); draw(); });
  return (number) => { shown = number; draw(); };
};
if (document.getElementById("scene-data")) {
  turningView(document.getElementById("scene"), JSON.parse(document.getElementById("scene-data").textContent));
}
