"use strict";
// What all pages draw: the vehicle, the cells of the reduction, the points of a scan.

const NEAR = [[0, "#fff3b0"], [0.35, "#fdc066"], [0.7, "#f0653a"], [1, "#9e0f2b"]];
const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const theme = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// ------------------------------------------------------------------ numbers

function unpack({ type, shape, scale, data: text }) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const raw = new { f4: Float32Array, i4: Int32Array, i2: Int16Array }[type](bytes);
  return { values: scale ? Float32Array.from(raw, (v) => v * scale) : raw, shape };
}
const unpackAll = (item) => Object.fromEntries(Object.entries(item).map(
  ([key, value]) => [key, value && value.type && value.shape ? unpack(value).values : value]));
const row = (values, i, width = 3) => values.subarray(i * width, (i + 1) * width);

// Moves points [N, 3] by a quaternion (x, y, z, w) and then by an offset: {x, y, z} of N numbers each.
function placed(points, [a, b, c, d], offset, before = [0, 0, 0]) {
  const m = [1 - 2 * (b * b + c * c), 2 * (a * b - c * d), 2 * (a * c + b * d),
    2 * (a * b + c * d), 1 - 2 * (a * a + c * c), 2 * (b * c - a * d),
    2 * (a * c - b * d), 2 * (b * c + a * d), 1 - 2 * (a * a + b * b)];
  const n = points.length / 3, out = { x: new Array(n), y: new Array(n), z: new Array(n) };
  for (let i = 0; i < n; i++) {
    const x = points[3 * i] + before[0], y = points[3 * i + 1] + before[1], z = points[3 * i + 2] + before[2];
    out.x[i] = m[0] * x + m[1] * y + m[2] * z + offset[0];
    out.y[i] = m[3] * x + m[4] * y + m[5] * z + offset[1];
    out.z[i] = m[6] * x + m[7] * y + m[8] * z + offset[2];
  }
  return out;
}
const columns = (values) => placed(values, [0, 0, 0, 1], [0, 0, 0]);
const corners = (triangles) => {
  const of = (k) => Array.from({ length: triangles.length / 3 }, (_, i) => triangles[3 * i + k]);
  return { i: of(0), j: of(1), k: of(2) };
};

function shade(share) { // of NEAR, as [r, g, b]
  const place = NEAR.findIndex(([at]) => at >= share), upper = NEAR[Math.max(place, 1)], lower = NEAR[Math.max(place, 1) - 1];
  const part = Math.min(Math.max((share - lower[0]) / (upper[0] - lower[0]), 0), 1);
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  return rgb(lower[1]).map((v, i) => Math.round(v + part * (rgb(upper[1])[i] - v)));
}

// ------------------------------------------------------------------ shapes

const ball = unpackAll(data.ball);
const vehicle = (() => {
  const vertices = [], triangles = [], facecolor = [];
  for (const part of data.vehicle.map(unpackAll)) {
    const first = vertices.length / 3;
    vertices.push(...part.vertices);
    triangles.push(...part.triangles.map((v) => v + first));
    facecolor.push(...new Array(part.triangles.length / 3).fill(part.colour));
  }
  return { vertices: Float32Array.from(vertices), ...corners(triangles), facecolor };
})();

const still = { hoverinfo: "skip", showlegend: false, showscale: false };
const light = { ambient: 0.62, diffuse: 0.55, specular: 0.05, roughness: 0.9, fresnel: 0 };
const mesh = (part) => ({ type: "mesh3d", ...still, lighting: light, lightposition: { x: 6000, y: -8000, z: 20000 }, ...part });
const line = (part) => ({ type: "scatter3d", mode: "lines", ...still, ...part });

const cloudTrace = (reach) => ({ type: "scatter3d", mode: "markers", ...still, x: [], y: [], z: [],
  marker: { size: 2, color: [], colorscale: NEAR, reversescale: true, cmin: 0, cmax: reach } });
const edgesTrace = () => line({ x: [], y: [], z: [], opacity: 0.6, line: { width: 1.5, color: "#5c6773" } });
const facesTrace = () => mesh({ x: [0], y: [0], z: [0], ...corners(ball.triangles), facecolor: [], opacity: 0.55,
  lighting: { ambient: 1, diffuse: 0, specular: 0 } });
const vehicleTrace = () => mesh({ x: [0], y: [0], z: [0], i: vehicle.i, j: vehicle.j, k: vehicle.k,
  facecolor: vehicle.facecolor, flatshading: true, lighting: { ...light, ambient: 0.95, diffuse: 0.3 } });

// The edges of the cells, and their triangles in the colours of what they report, where a sensor is.
function cells(reported, reach, statistic, turn, position, sensor) {
  const shell = placed(ball.vertices, turn, position, sensor), edges = { x: [], y: [], z: [] };
  for (let n = 0; n < ball.edges.length; n += 2) for (const axis of ["x", "y", "z"])
    edges[axis].push(shell[axis][ball.edges[n]], shell[axis][ball.edges[n + 1]], null);
  const colours = Array.from(reported, (value) => {
    if (value <= 0) return "rgba(160,175,190,0.10)";
    const near = Math.min(value / reach, 1);
    return `rgba(${shade(statistic === "range" ? 1 - near : near)},0.85)`;
  });
  return { edges, faces: { ...shell, facecolor: Array.from(ball.faces, (face) => colours[face]) } };
}

// Gives traces their new numbers. Plotly's own way of doing so computes all traces of the scene anew, the valley too;
// handing the numbers to the drawn objects does not. Where plotly.js keeps them elsewhere, its own way serves.
function hand(graph, news) {
  const drawn = graph._fullLayout?.scene?._scene?.traces ?? {};
  const left = [];
  for (const [index, { colour, ...numbers }] of Object.entries(news)) {
    const given = graph.data[index], full = graph._fullData?.[index];
    for (const item of [given, full]) {
      if (!item) continue;
      Object.assign(item, numbers);
      if (colour && item.marker) item.marker.color = colour;
      if (item._length !== undefined) item._length = numbers.x.length;
    }
    if (given.visible === false) continue;
    const object = drawn[full?.uid];
    if (object?.update) object.update(full); else left.push(index);
  }
  if (left.length) Plotly.redraw(graph);
}

// ------------------------------------------------------------------ texts

function list(parent, facts) {
  parent.replaceChildren(...Object.entries(facts).map(([term, value]) => {
    const item = element("div");
    element("dt", {}, item, term);
    element("dd", {}, item, value);
    return item;
  }));
}

function distanceScale(parent, reach) { // the colours of distances, for a legend
  const shades = NEAR.map(([at, colour]) => `${colour} ${100 * at}%`);
  element("div", { class: "scale", style: `background:linear-gradient(90deg,${shades})` }, parent);
  const ends = element("div", { class: "ends" }, parent);
  element("span", {}, ends, `${reach} m away`);
  element("span", {}, ends, "0 m");
}
