"use strict";
// Figures are drawn one after the other when the page has time, the visible ones first; before printing all are, at the paper's width.
(() => {
  const plots = Array.from(document.querySelectorAll(".plot"));
  const layouts = new Map();
  const PAPER = 0.8;
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
    if (width && width < 400) tall(plot, PAPER);
  };
  const tall = (plot, share) => {  // figures that stand beside each other are lower on paper
    const height = share * layouts.get(plot).height;
    plot.style.height = height + "px";
    Plotly.relayout(plot, { height: height });
  };
  const small = (figure, plot) => {
    const layout = figure.layout;
    Object.assign(layout.font, { size: 11 });
    Object.assign(layout.margin, { l: 48, r: 6 });
    for (const key of Object.keys(layout)) {
      if (/^[xy]axis/.test(key)) layout[key].title = Object.assign({}, layout[key].title, { font: { size: 11 } });
    }
    if (layout.updatemenus) Object.assign(layout.legend, { x: 0, xanchor: "left", y: -0.34, yanchor: "top" });  // above stands the list, below the names of the axis
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
  const screen = () => plots.forEach((plot) => { tall(plot, 1); Plotly.relayout(plot, { width: undefined, autosize: true }); });
  window.addEventListener("beforeprint", () => { document.querySelectorAll("details.print").forEach((d) => { d.open = true; }); paper(); });
  window.addEventListener("afterprint", screen);
  document.querySelectorAll(".slide").forEach((slide) => {  // before covers after up to the handle; without a script both stand one under the other
    const label = document.createElement("label"), range = Object.assign(document.createElement("input"), { type: "range", value: 50 });
    const move = () => {
      slide.style.setProperty("--at", `${range.value}%`);
      range.setAttribute("aria-valuetext", `before in the left ${range.value} %, after in the rest`);
    };
    label.append("move from after to before calibration", range);
    slide.append(label);
    slide.classList.add("slides");
    range.addEventListener("input", move);
    move();
  });
})();
