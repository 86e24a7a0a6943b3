"use strict";
// The points of some scans around the vehicle, and the cells of the reduction; the sensor is the origin.

const scans = data.scans.map((item) => ({ ...unpackAll(item), time: item.time }));
const LEVEL = [0, 0, 0, 1], ORIGIN = [0, 0, 0], BELOW = data.sensor.map((v) => -v);
const [VEHICLE, POINTS, EDGES, FACES] = Array(4).keys();
const LAYERS = [["point cloud", [POINTS], "#f0653a"], [data.cells, [FACES, EDGES], "#fdc066"], ["vehicle", [VEHICLE], data.body]];
const REACH = data.reach, HEIGHT = 5;
const VIEWS = { behind: [-1.1, 0, 0.55], top: [-0.01, 0, 1.6], side: [0, -1.3, 0.25] };
let moment = 0, playing = null;

function changes(scan) {
  const { points: cloud } = scan;
  const range = Array.from({ length: cloud.length / 3 }, (_, i) => Math.hypot(...row(cloud, i)));
  const shell = cells(scan.cells, data.radius, data.statistic, LEVEL, ORIGIN, ORIGIN);
  const nowhere = { x: [null], y: [null], z: [null], colour: [0] }; // Plotly hides a trace of no points for good
  return { [POINTS]: range.length ? { ...columns(cloud), colour: range } : nowhere,
    [EDGES]: shell.edges, [FACES]: shell.faces };
}

function traces() {
  const all = [];
  all[VEHICLE] = { ...vehicleTrace(), ...placed(vehicle.vertices, LEVEL, BELOW) };
  all[POINTS] = cloudTrace(data.radius);
  all[EDGES] = edgesTrace();
  all[FACES] = facesTrace();
  for (const [index, { colour, ...numbers }] of Object.entries(changes(scans[0]))) {
    Object.assign(all[index], numbers);
    if (colour) all[index].marker.color = colour;
  }
  return all;
}

function show(next) {
  moment = Math.min(Math.max(next, 0), scans.length - 1);
  const scan = scans[moment];
  hand($("scene"), changes(scan));
  $("slider").value = moment;
  $("clock").textContent = `${number(scan.time, 1)} s`;
  list($("smoothness"), { returns: scan.returns.toLocaleString("en"), misses: percent(scan.misses),
    "cells with something near": `${Array.from(scan.cells).filter((v) => v > 0).length} of ${scan.cells.length}` });
}
const percent = (share) => `${number(100 * share, 1)} %`;

function play(on) {
  if (playing) clearInterval(playing);
  playing = on ? setInterval(() => show((moment + 1) % scans.length), 250) : null;
  $("play").textContent = on ? "❚❚" : "▶";
}

const camera = ([x, y, z]) => ({ eye: { x, y, z }, center: { x: 0, y: 0, z: 0 }, up: { x: 0, y: 0, z: 1 } });

function buttons() {
  for (const [name, eye] of Object.entries(VIEWS)) {
    const button = element("button", {}, $("views"), name);
    button.addEventListener("click", () => Plotly.relayout($("scene"), { "scene.camera": camera(eye) }));
  }
  for (const [name, which, colour] of LAYERS) {
    const button = element("button", { class: "on" }, $("layers"));
    element("i", { style: `background:${colour}` }, button);
    button.append(name);
    button.addEventListener("click", () => Plotly.restyle($("scene"), { visible: button.classList.toggle("on") }, which)
      .then(() => show(moment)));
  }
  $("slider").max = scans.length - 1;
  $("slider").addEventListener("input", (event) => { play(false); show(Number(event.target.value)); });
  $("play").addEventListener("click", () => play(!playing));
  document.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key], on = event.target.tagName;
    if (event.key === " " && on !== "BUTTON") { event.preventDefault(); play(!playing); }
    if (steps && on !== "INPUT") { play(false); show(moment + steps); }
  });
}

function start() {
  const { scans: count, rate_hz: rate, points_median: points, nearest_m: nearest, misses } = data.facts;
  const known = (value, text) => value === null ? "–" : text(value);
  $("source").textContent = data.source;
  list($("facts"), { scans: count, rate: known(rate, (v) => `${number(v)} Hz`),
    "points (median)": known(points, (v) => Math.round(v).toLocaleString("en")),
    nearest: known(nearest, (v) => `${number(v)} m`), misses: known(misses, percent) });
  list($("position_stats"), Object.fromEntries(data.sectors.map(({ name, nearest: far }) =>
    [name, known(far, (v) => `${number(v)} m`)])));
  element("div", {}, $("legend"), "the sensor's frame: x ahead (nose pink), z up");
  distanceScale($("legend"), data.radius);
  buttons();
  const axis = (reach) => ({ range: [-reach, reach], visible: false, showspikes: false });
  const scene = { xaxis: axis(REACH), yaxis: axis(REACH), zaxis: axis(HEIGHT), aspectmode: "manual",
    aspectratio: { x: 2, y: 2, z: 2 * HEIGHT / REACH }, dragmode: "turntable", bgcolor: "rgba(0,0,0,0)",
    camera: camera(VIEWS.behind) };
  const layout = { scene, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false };
  return Plotly.react($("scene"), traces(), layout, { responsive: true, displayModeBar: false }).then(() => {
    show(0);
    document.body.dataset.ready = "true";
  });
}

start();
