"use strict";
/* A cursor over the pictures and the values under it. The page is complete without; nothing is fetched or stored. */

function element(parent, name, className) {
  const made = document.createElement(name);
  made.className = className;
  parent.append(made);
  return made;
}

function number(value) {
  return value === null ? "\u2013" : String(Number(value.toPrecision(4)));
}

/* Index of the value of an ascending list that is nearest to x. */
function nearest(values, x) {
  let best = 0;
  values.forEach((value, k) => { if (Math.abs(value - x) < Math.abs(values[best] - x)) best = k; });
  return best;
}

function share(panel, x) {
  const [low, high, at] = panel.log ? [panel.low, panel.high, x].map(Math.log) : [panel.low, panel.high, x];
  return (at - low) / (high - low);
}

function valueAt(panel, part) {
  if (!panel.log) return panel.low + part * (panel.high - panel.low);
  return Math.exp(Math.log(panel.low) + part * (Math.log(panel.high) - Math.log(panel.low)));
}

function panelUnder(panels, x, y) {
  return panels.find((p) => x >= p.left && x <= p.right && y >= p.top && y <= p.bottom);
}

/* Where the pointer is, in parts of the picture. */
function placeOf(event, canvas) {
  const box = canvas.getBoundingClientRect();
  return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
}

function readRows(data, canvas, readout, figure) {
  const lines = data.panels.map(() => element(canvas, "div", "cursor"));
  const abscissae = data.groups[0] ? data.groups[0].x : [];
  if (abscissae.length === 0) return;
  const label = element(figure, "label", "slider");
  label.append("Cursor ");
  const slider = element(label, "input", "");
  Object.assign(slider, { type: "range", min: 0, max: abscissae.length - 1, value: 0 });

  function show(x) {
    const at = abscissae[nearest(abscissae, x)];
    data.panels.forEach((panel, k) => {
      const part = share(panel, at);
      lines[k].hidden = part < 0 || part > 1;
      lines[k].style.left = `${100 * (panel.left + part * (panel.right - panel.left))}%`;
      lines[k].style.top = `${100 * panel.top}%`;
      lines[k].style.height = `${100 * (panel.bottom - panel.top)}%`;
    });
    readout.replaceChildren();
    element(readout, "strong", "").textContent = `${data.name} = ${number(at)} ${data.unit}`;
    data.groups.forEach((group) => {
      const k = nearest(group.x, at);
      const away = Math.abs(group.x[k] - at) > 1e-3 * Math.abs(at) ? ` (at ${number(group.x[k])} ${data.unit})` : "";
      const values = data.heads.map((head, n) => `${head} ${number(group.columns[n][k])}`);
      element(readout, "div", "").textContent = `${group.name}${away}: ${values.join(", ")}`;
    });
    slider.value = nearest(abscissae, at);
    slider.setAttribute("aria-valuetext", readout.textContent);
  }

  slider.addEventListener("input", () => show(abscissae[Number(slider.value)]));
  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = placeOf(event, canvas);
    const panel = panelUnder(data.panels, x, y);
    if (panel) show(valueAt(panel, (x - panel.left) / (panel.right - panel.left)));
  });
}

function readPoints(data, canvas, readout) {
  const mark = element(canvas, "div", "mark");
  mark.hidden = true;
  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = placeOf(event, canvas);
    if (!panelUnder(data.panels, x, y) || data.points.length === 0) return;
    const ratio = canvas.clientHeight / canvas.clientWidth;
    const distance = (point) => Math.hypot(point[0] - x, ratio * (point[1] - y));
    const best = data.points.reduce((a, b) => (distance(b) < distance(a) ? b : a));
    mark.hidden = false;
    mark.style.left = `${100 * best[0]}%`;
    mark.style.top = `${100 * best[1]}%`;
    readout.textContent = best[2];
  });
}

document.querySelectorAll("figure").forEach((figure) => {
  const data = JSON.parse(figure.querySelector("script").textContent);
  const canvas = figure.querySelector(".canvas");
  const readout = element(figure, "output", "readout");
  readout.textContent = "Point into the picture to read values.";
  if (data.kind === "rows") readRows(data, canvas, readout, figure);
  else readPoints(data, canvas, readout);
});
