"use strict";
// Small charts over time: lines, a cursor, and the values under the cursor. A click or drag asks for a moment.

const SVG = "http://www.w3.org/2000/svg";
const PAD = { left: 34, right: 6, top: 5, bottom: 5 };

function element(name, attributes = {}, parent = null, text = null) {
  const made = name.startsWith("svg:") ? document.createElementNS(SVG, name.slice(4)) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== null) made.textContent = text;
  if (parent) parent.appendChild(made);
  return made;
}

function number(value, digits = 2) {
  return Number.isFinite(value) ? value.toFixed(digits).replace("-", "−") : "–";
}

// Round numbers at the ends of an axis that holds all values.
function limits(series, low, high) {
  let least = low ?? Infinity, most = high ?? -Infinity;
  for (const { values } of series) for (const v of values) if (Number.isFinite(v)) { least = Math.min(least, v); most = Math.max(most, v); }
  if (!Number.isFinite(least)) least = 0;
  if (!(most > least)) { most = least + 1; }
  const step = 10 ** Math.floor(Math.log10(most - least)) / 2;
  return [Math.floor(least / step + 1e-6) * step, Math.ceil(most / step - 1e-6) * step];
}

// The pieces of a line between values that are missing.
function pieces(values) {
  const found = [];
  values.forEach((value, i) => {
    if (!Number.isFinite(value)) return;
    if (i === 0 || !Number.isFinite(values[i - 1])) found.push([]);
    found[found.length - 1].push([i, value]);
  });
  return found;
}

// spec: {title, unit, series: [{name, colour, values}], low, high, note}; moments: of the whole flight. In place of
// lines there may be bands: [{name, colour, from, to}].
// Values may be one fewer than the moments: those of steps stand at the moment that ends them.
function makeChart(parent, spec, moments, seek) {
  const box = element("div", { class: spec.bands ? "chart band" : spec.series.length > 1 ? "chart tall" : "chart" }, parent);
  const head = element("h2", {}, box);
  head.append(spec.title);
  element("span", {}, head, spec.unit ?? "");
  const single = spec.series.length < 2, bands = spec.bands ?? [];
  const names = single ? null : element("div", { class: "names" }, box);
  const outputs = spec.series.map(({ name, colour }) => {
    const style = `color:color-mix(in srgb, ${colour} 60%, var(--ink))`; // to be read on any ground
    if (single) return element("output", { style }, head);
    return element("span", { style, "data-name": name }, names);
  });
  const named = bands.length ? element("output", {}, head) : null;
  if (spec.note) element("span", { style: "margin-left:auto" }, head, spec.note);
  const svg = element("svg:svg", {}, box);
  const [low, high] = limits(spec.series, spec.low, spec.high);
  let place = () => 0, cursor = null;

  function draw() {
    const { width, height } = svg.getBoundingClientRect();
    const across = width - PAD.left - PAD.right, along = height - PAD.top - PAD.bottom;
    place = (moment) => PAD.left + across * moment / Math.max(moments - 1, 1);
    const up = (value) => PAD.top + along * (1 - (value - low) / (high - low));
    svg.replaceChildren();
    for (const { colour, from, to } of bands) {
      const x = place(from), width = Math.max(place(Math.min(to + 1, moments - 1)) - x, 1);
      element("svg:rect", { x, y: PAD.top, width, height: Math.max(along, 1), fill: colour }, svg);
    }
    const ticks = bands.length ? [] : low < 0 && high > 0 ? [low, 0, high] : [low, high];
    for (const tick of ticks) {
      element("svg:line", { x1: PAD.left, x2: width - PAD.right, y1: up(tick), y2: up(tick), class: "rule" }, svg);
      const label = String(+tick.toPrecision(3)).replace("-", "−");
      const y = Math.min(Math.max(up(tick) + 3.5, 9), height - 1);
      element("svg:text", { x: PAD.left - 5, y, "text-anchor": "end" }, svg, label);
    }
    for (const { values, colour } of spec.series) {
      const shift = moments - values.length;
      for (const piece of pieces(values)) {
        const path = piece.map(([i, v]) => `${place(i + shift).toFixed(1)},${up(v).toFixed(1)}`).join(" ");
        element("svg:polyline", { points: path, fill: "none", stroke: colour, "stroke-width": 1.6,
          "stroke-linejoin": "round" }, svg);
      }
    }
    cursor = element("svg:line", { y1: 0, y2: height, class: "cursor" }, svg);
  }

  function move(moment) {
    if (cursor) { const x = place(moment).toFixed(1); cursor.setAttribute("x1", x); cursor.setAttribute("x2", x); }
    if (named) named.textContent = bands.findLast(({ from }) => from <= moment).name;
    spec.series.forEach(({ name, values }, i) => {
      const value = values[moment - (moments - values.length)];
      outputs[i].textContent = (single ? "" : `${name} `) + number(value);
    });
  }

  const ask = (event) => {
    const { left, width } = svg.getBoundingClientRect();
    const share = (event.clientX - left - PAD.left) / (width - PAD.left - PAD.right);
    seek(Math.round(Math.min(Math.max(share, 0), 1) * (moments - 1)));
  };
  svg.addEventListener("pointerdown", (event) => { svg.setPointerCapture(event.pointerId); ask(event); });
  svg.addEventListener("pointermove", (event) => { if (event.buttons) ask(event); });
  return { draw, move };
}
