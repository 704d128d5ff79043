"use strict";
// A run that goes on: its figures and log are read every second; when its state changes, the page is loaded again.
(() => {
  const live = document.getElementById("live"), log = document.getElementById("log");
  log.scrollTop = log.scrollHeight;
  if (!live) return;
  const set = (id, text) => { document.getElementById(id).textContent = text; };
  const inWords = (s) => (s < 100 ? `${Math.round(s)} s` : `${Math.round(s / 60)} min`);
  const show = (now) => {
    set("count", `${now.done} of ${now.total || "?"} poses`);
    set("left", now.left_s === null ? "" : `, about ${inWords(now.left_s)} left`);
    set("what", now.what);
    const bar = document.getElementById("bar");
    bar.max = now.total || 1;
    bar.value = now.done;
    const atEnd = log.scrollTop + log.clientHeight >= log.scrollHeight - 4;
    log.textContent = now.log.map((line) => line.join(" ")).join("\n") + "\n";
    if (atEnd) log.scrollTop = log.scrollHeight;
  };
  const next = async () => {
    try {
      const answer = await fetch(live.dataset.live);
      if (!answer.ok) throw new Error(String(answer.status));
      const now = await answer.json();
      if (now.state !== live.dataset.state) {
        location.replace(location.pathname);
        return;
      }
      show(now);
    } catch (error) {
      set("what", "mbcacq serve does not answer; what stands here may be old, and the run may go on");
    }
    setTimeout(next, 1000);
  };
  setTimeout(next, 1000);
})();

// The plan: drawn when it has been computed, with a slider over its poses.
(() => {
  const plan = document.getElementById("plan");
  if (!plan) return;
  const said = document.getElementById("plan-said"), slider = document.getElementById("pose");
  const draw = (data) => {
    if (data.error) { said.textContent = `The plan cannot be drawn: ${data.error}`; document.getElementById("scene").hidden = true; return; }
    const show = turningView(document.getElementById("scene"), data);
    const lacking = data.unreachable ? ` ${data.unreachable} more cannot be reached.` : "";
    const pose = () => {
      said.textContent = (data.poses.length ? data.poses[slider.value].label : "The plan has no pose that can be reached.") + lacking;
      show(Number(slider.value));
    };
    slider.max = Math.max(0, data.poses.length - 1);
    slider.addEventListener("input", pose);
    document.getElementById("poses").hidden = !data.poses.length;
    pose();
    document.documentElement.dataset.plan = "drawn";
  };
  fetch(plan.dataset.scene).then((answer) => answer.json()).then(draw).catch(() => { said.textContent = "The plan could not be read."; });
})();
