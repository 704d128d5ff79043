"use strict";
// Figures are drawn one after the other when the page has time, the visible ones first; before printing all are, at the paper's width.
(() => {
  const plots = Array.from(document.querySelectorAll(".plot"));
  const layouts = new Map();
  const draw = (plot, width) => {
    if (!layouts.has(plot)) {
      const figure = JSON.parse(document.getElementById(plot.dataset.figure).textContent);
      layouts.set(plot, figure.layout);
      if (plot.clientWidth < 420) small(figure, plot);
      figure.layout.width = width || undefined;
      Plotly.newPlot(plot, figure.data, figure.layout, { displayModeBar: false, responsive: !width });
    } else if (width) {
      Plotly.relayout(plot, { width: width });
    }
  };
  const small = (figure, plot) => {
    const layout = figure.layout;
    Object.assign(layout.font, { size: 11 });
    Object.assign(layout.margin, { l: 48, r: 6 });
    for (const key of Object.keys(layout)) {
      if (/^[xy]axis/.test(key)) layout[key].title = Object.assign({}, layout[key].title, { font: { size: 11 } });
    }
    if (layout.updatemenus) Object.assign(layout.legend, { x: 0, xanchor: "left", y: -0.2, yanchor: "top" });  // above stands the list
    const narrow = layout.meta && layout.meta.narrow;
    if (narrow) {
      layout.height = narrow.height;
      plot.style.height = narrow.height + "px";
      for (const key of Object.keys(layout)) {
        if (/^[xy]axis/.test(key)) layout[key].tickfont = { size: narrow.tick };
        if (narrow.angle && key[0] === "x") layout[key].tickangle = narrow.angle;
      }
    }
  };
  const pending = plots.slice();
  const next = () => {
    const plot = pending.shift();
    if (!plot) { document.documentElement.dataset.drawn = "all"; return; }
    draw(plot);
    (window.requestIdleCallback || ((f) => setTimeout(f, 1)))(next, { timeout: 200 });
  };
  const visible = new IntersectionObserver((entries) => entries.forEach((e) => { if (e.isIntersecting) draw(e.target); }), { rootMargin: "300px" });
  plots.forEach((plot) => visible.observe(plot));
  setTimeout(next, 30);
  const paper = () => plots.forEach((plot) => draw(plot, plot.closest(".three") ? 215 : plot.closest(".two") ? 325 : 670));
  const screen = () => plots.forEach((plot) => Plotly.relayout(plot, { width: undefined, autosize: true }));
  window.addEventListener("beforeprint", () => { document.querySelectorAll("details.print").forEach((d) => { d.open = true; }); paper(); });
  window.addEventListener("afterprint", screen);
})();

// The view that turns: points and the arm on a canvas, drawn from front to back by depth.
(() => {
  const canvas = document.getElementById("scene");
  if (!canvas) return;
  const data = JSON.parse(document.getElementById("scene-data").textContent);
  const context = canvas.getContext("2d");
  const all = data.groups.flatMap((g) => g.points).concat(data.arm);
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
  const draw = () => {
    const width = canvas.width, height = canvas.height, unit = zoom * 0.94 * Math.min(width / span[0], height / span[1]);
    const place = (p) => {
      const [right, up, away] = turned(p);
      return [width / 2 + unit * right, height / 2 - unit * up, away];
    };
    const line = (points, colour, thick) => {
      context.strokeStyle = colour;
      context.lineWidth = thick * ratio;
      context.beginPath();
      points.map(place).forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.stroke();
    };
    context.clearRect(0, 0, width, height);
    context.lineJoin = context.lineCap = "round";
    const floor = low[2];
    for (let x = low[0]; x <= high[0]; x += step) line([[x, low[1], floor], [x, high[1], floor]], "#e4e4e4", 1);
    for (let y = low[1]; y <= high[1]; y += step) line([[low[0], y, floor], [high[0], y, floor]], "#e4e4e4", 1);
    if (data.arm.length) line(data.arm, "#b9bec4", 14), line(data.arm, "#6b7178", 3);
    context.font = `${14 * ratio}px Helvetica, Arial, sans-serif`;
    [["X", [150, 0, 0], "#c0392b"], ["Y", [0, 150, 0], "#1e8449"], ["Z", [0, 0, 150], "#1f618d"]].forEach(([name, end, colour]) => {
      line([[0, 0, 0], end], colour, 3);
      const [x, y] = place(end);
      context.fillStyle = colour;
      context.fillText(name, x + 4, y - 4);
    });
    data.groups.flatMap((g) => g.points.map((p) => [...place(p), g.colour])).sort((a, b) => b[2] - a[2]).forEach(([x, y, , colour]) => {
      context.fillStyle = colour;
      context.beginPath();
      context.arc(x, y, 3.2 * ratio, 0, 7);
      context.fill();
    });
    data.groups.forEach((g, k) => {
      context.fillStyle = g.colour;
      context.fillRect(12 * ratio, (12 + 22 * k) * ratio, 12 * ratio, 12 * ratio);
      context.fillStyle = "#222";
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
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom = Math.min(8, Math.max(0.3, zoom * Math.exp(-0.001 * e.deltaY))); draw(); }, { passive: false });
  shape();
  draw();
  window.addEventListener("resize", () => { shape(); draw(); });
})();
