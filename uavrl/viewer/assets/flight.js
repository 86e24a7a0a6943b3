"use strict";
// The three-dimensional scene, its camera, and the clock.

const TERM_COLOURS = { progress: "#0072B2", altitude: "#E69F00", heading: "#009E73", elevation: "#CC79A7",
  reward: "#0072B2" };
const EVENTS = ["arrival", "collision"];
const { body: BODY, plane: PLANE, goal: GOAL, seen: SEEN, led: LED } = data.colours, CELLS = "#fdc066";
const OUTCOMES = Object.fromEntries([["arrived", data.states ? "arrived" : "success"], ["collided", "collision"],
  ["timed_out", "time-out"], ["ended", "ended"]].map(([key, name]) => [key, [name, data.colours[key]]]));

// ------------------------------------------------------------------ what is drawn

const sceneries = Object.fromEntries(Object.entries(data.sceneries).map(([seed, item]) =>
  [seed, { ...unpackAll(item), grid: item.heights?.shape }]));
const flights = data.flights.map((item) => ({ ...unpackAll(item), moments: item.times.shape[0],
  planeCount: item.planes?.shape[1] ?? 0, objectCount: item.objects?.shape[1] ?? 0,
  rewardCount: item.rewards?.shape[1] ?? 0 }));

function ground({ heights, grid: [rows, across], size }) {
  const x = [], y = [], i = [], j = [], k = [];
  for (let r = 0; r < rows; r++) for (let c = 0; c < across; c++) {
    x.push(size[0] * (r / (rows - 1) - 0.5));
    y.push(size[1] * (c / (across - 1) - 0.5));
    if (r < rows - 1 && c < across - 1) {
      const a = r * across + c, b = a + across;
      i.push(a, a); j.push(b, b + 1); k.push(b + 1, a + 1);
    }
  }
  const colorscale = [[0, "#c9c1a5"], [0.35, "#ddd6bf"], [0.6, "#cfc9b8"], [1, "#f3f1ea"]];
  return mesh({ x, y, z: heights, i, j, k, intensity: heights, colorscale, cmin: -0.6, cmax: 7.5 });
}

function obstacles(place) {
  const facecolor = Array.from(place.kinds, (kind) => place.kind_colours[kind]);
  return mesh({ ...columns(place.vertices), ...corners(place.triangles), facecolor });
}

function goalShape([x, y, z], [radius, height]) {
  const sides = 40, out = { x: [], y: [], z: [], i: [], j: [], k: [] }, ring = { x: [], y: [], z: [] };
  for (let n = 0; n < sides; n++) {
    const angle = 2 * Math.PI * n / sides, next = (n + 1) % sides;
    for (const end of [-1, 1]) {
      out.x.push(x + radius * Math.cos(angle)); out.y.push(y + radius * Math.sin(angle)); out.z.push(z + end * height / 2);
    }
    out.i.push(2 * n, 2 * n + 1); out.j.push(2 * next, 2 * next); out.k.push(2 * n + 1, 2 * next + 1);
  }
  for (const level of [1, 0.5, 0]) {
    for (let n = 0; n <= sides; n++) {
      const angle = 2 * Math.PI * n / sides;
      ring.x.push(x + radius * Math.cos(angle)); ring.y.push(y + radius * Math.sin(angle));
      ring.z.push(z + (level - 0.5) * height);
    }
    ring.x.push(null); ring.y.push(null); ring.z.push(null);
  }
  return [mesh({ ...out, color: GOAL, opacity: 0.28 }), line({ ...ring, line: { color: "#b8860b", width: 3 } })];
}

// Index of each trace; those from FLOWN on move.
const [GROUND, OBSTACLES, GOAL_WALL, GOAL_RINGS, GOAL_NAME, OTHERS, WAY, START, FLOWN, DROP, PLANES, OBJECTS, LEAD, VEHICLE, MARK,
  POINTS, EDGES, FACES] = Array(18).keys();
const LAYERS = [["planes", [PLANES], PLANE], ["seen to move", [OBJECTS], SEEN], ["map's direction", [LEAD], LED],
  ["point cloud", [POINTS], "#f0653a"], ["cells", [FACES, EDGES], CELLS],
  [data.states ? "all scans" : "obstacles", [OBSTACLES], "#6b8f5e"], ["path", [WAY, FLOWN, START], null], ["other flights", [OTHERS], OTHERS]];
const hidden = new Set();

function traces(flight) {
  const place = sceneries[flight.world_seed], colour = OUTCOMES[flight.outcome][1], way = columns(flight.positions);
  const others = { x: [], y: [], z: [], colour: [] };
  for (const other of flights) {
    if (other === flight || other.world_seed !== flight.world_seed) continue;
    const path = columns(other.positions);
    for (const axis of ["x", "y", "z"]) others[axis].push(...path[axis], null);
    others.colour.push(...new Array(other.moments + 1).fill(OUTCOMES[other.outcome][1]));
  }
  const [wall, rings] = goalShape(flight.goal, place.goal), all = [];
  const share = data.flights.length > 1;
  all[GROUND] = place.heights ? ground(place) : level(place);
  all[OBSTACLES] = place.world ? seen(place) : obstacles(place);
  all[GOAL_WALL] = wall;
  all[GOAL_RINGS] = rings;
  all[GOAL_NAME] = { type: "scatter3d", mode: "text", ...still, x: [flight.goal[0]], y: [flight.goal[1]],
    z: [flight.goal[2] + place.goal[1] / 2 + 0.6], text: ["<b>goal</b>"], textfont: { color: theme("goal-name"), size: 14 } };
  all[OTHERS] = line({ ...others, opacity: 0.75, line: { width: 3, color: others.colour } });
  all[WAY] = line({ ...way, opacity: share ? 0.9 : 0.7, line: flight.told ? { width: 5, color: stateColours(flight) } :
    { width: 3, color: colour, dash: "dot" } });
  all[START] = { type: "scatter3d", mode: "markers+text", ...still, x: [way.x[0]], y: [way.y[0]], z: [way.z[0]],
    text: ["start"], textposition: "bottom center", textfont: { color: theme("ink"), size: 12 },
    marker: { size: 5, color: theme("paper"), line: { color: theme("ink"), width: 2 } } };
  all[FLOWN] = line({ x: [], y: [], z: [], opacity: flight.told ? 0.4 : 1, line: { width: 8, color: colour } });
  all[DROP] = line({ x: [], y: [], z: [], line: { width: 2, color: BODY } });
  all[PLANES] = mesh({ x: [0], y: [0], z: [0], ...(flight.planeCount ? manyPlanes(place, flight.planeCount) : corners([])), color: PLANE, flatshading: true,
    lighting: { ...light, ambient: 0.9, diffuse: 0.4 } });
  all[OBJECTS] = line({ x: [], y: [], z: [], line: { width: 6, color: SEEN } });
  all[LEAD] = line({ x: [], y: [], z: [], line: { width: 6, color: LED } });
  all[VEHICLE] = vehicleTrace();
  all[MARK] = { type: "scatter3d", mode: "markers", ...still, x: [], y: [], z: [],
    marker: { size: 9, symbol: "circle-open", color: BODY, line: { width: 2 } } };
  all[POINTS] = cloudTrace(place.ball);
  all[EDGES] = edgesTrace();
  all[FACES] = facesTrace();
  for (const [index, { colour: shades, ...numbers }] of Object.entries(changes(flight, 0))) {
    Object.assign(all[index], numbers);
    if (shades) all[index].marker.color = shades;
  }
  for (const [name, which] of LAYERS) for (const trace of which) all[trace].visible = !hidden.has(name);
  return all;
}

function manyPlanes(place, count) {
  const step = place.plane_vertices.length / 3, triangles = [];
  for (let n = 0; n < count; n++) triangles.push(...place.plane_triangles.map((v) => v + n * step));
  return corners(triangles);
}

// What the vehicle sees to move at a moment: a ring of its size, and where it will be within a second if it flies on.
function movingObjects({ objects, objectCount }, moment) {
  const out = { x: [], y: [], z: [] }, sides = 16;
  const add = (x, y, z) => { out.x.push(x); out.y.push(y); out.z.push(z); };
  for (let n = 0; n < objectCount; n++) {
    const [x, y, z, u, v, w, size] = row(objects, moment * objectCount + n, 7);
    if (!size) continue;
    for (let side = 0; side <= sides; side++) {
      const angle = 2 * Math.PI * side / sides;
      add(x + size / 2 * Math.cos(angle), y + size / 2 * Math.sin(angle), z);
    }
    add(null, null, null);
    add(x, y, z); add(x + u, y + v, z + w); add(null, null, null);
  }
  return out.x.length ? out : { x: [null], y: [null], z: [null] };
}

// Where a memory leads at a moment: an arrow.
function memoryArrow({ bearings, positions }, moment) {
  if (!bearings?.length) return { x: [null], y: [null], z: [null] };
  const [x, y, z] = row(positions, moment), bearing = bearings[moment], long = 2.5, barb = 0.5;
  const ends = [[0, 0], [long, 0], [long - barb, barb / 2], [long, 0], [long - barb, -barb / 2]];
  const cos = Math.cos(bearing), sin = Math.sin(bearing);
  return { x: ends.map(([a, b]) => x + cos * a - sin * b), y: ends.map(([a, b]) => y + sin * a + cos * b), z: ends.map(() => z) };
}

// What changes at a moment, by trace.
function changes(flight, moment) {
  const place = sceneries[flight.world_seed], position = row(flight.positions, moment);
  const turn = row(flight.attitudes, moment, 4), reported = row(flight.faces, moment, flight.faces.length / flight.moments);
  const from = moment ? flight.point_ends[moment - 1] : 0, cloud = flight.points.subarray(3 * from, 3 * flight.point_ends[moment]);
  const range = Array.from({ length: cloud.length / 3 }, (_, i) => Math.hypot(...row(cloud, i)));
  const shell = cells(reported, place.ball, place.statistic, turn, position, place.sensor);
  const fleet = { x: [], y: [], z: [] };
  for (let n = 0; n < flight.planeCount; n++) {
    const [x, y, z, yaw] = row(flight.planes, moment * flight.planeCount + n, 4);
    const one = placed(place.plane_vertices, [0, 0, Math.sin(yaw / 2), Math.cos(yaw / 2)], [x, y, z]);
    for (const axis of ["x", "y", "z"]) fleet[axis].push(...one[axis]);
  }
  const [x, y, z] = position, below = groundAt(place, x, y);
  const nowhere = { x: [null], y: [null], z: [null], colour: [0] }; // Plotly hides a trace of no points for good
  return {
    [FLOWN]: columns(flight.positions.subarray(0, 3 * (moment + 1))),
    [DROP]: { x: [x, x], y: [y, y], z: [z, below] },
    [PLANES]: flight.planeCount ? fleet : { x: [0], y: [0], z: [0] },
    [OBJECTS]: movingObjects(flight, moment),
    [LEAD]: memoryArrow(flight, moment),
    [VEHICLE]: placed(vehicle.vertices, turn, position),
    [MARK]: { x: [x], y: [y], z: [z] },
    [POINTS]: range.length ? { ...placed(cloud, turn, position, place.sensor), colour: range } : nowhere,
    [EDGES]: shell.edges,
    [FACES]: shell.faces,
  };
}

function groundAt({ heights, grid, size }, x, y) {
  if (!heights) return 0;
  const [rows, across] = grid;
  const at = (share, count) => Math.min(Math.max(Math.round((share + 0.5) * (count - 1)), 0), count - 1);
  return heights[at(x / size[0], rows) * across + at(y / size[1], across)];
}

// ------------------------------------------------------------------ camera

const ASPECT = 1 / 18; // of the scene's units to a metre
const boxOf = ({ size, box }) => box ?? [[-size[0] / 2 - 1, size[0] / 2 + 1], [-size[1] / 2 - 1, size[1] / 2 + 1], [-2, 9]];
const VIEWS = {
  overview: (p, h, [x, y, far]) => ({ eye: [x, y - 32 * far, 30 * far], center: [x, y - 0.8, 0] }),
  top: (p, h, [x, y, far]) => ({ eye: [x, y - 0.5, 46 * far], center: [x, y, 0] }),
  follow: (p, h) => ({ eye: [p[0] - 9 * h[0] - 4 * h[1], p[1] - 9 * h[1] + 4 * h[0], p[2] + 8], center: p }),
  chase: (p, h) => ({ eye: [p[0] - 5.4 * h[0], p[1] - 5.4 * h[1], p[2] + 2.3], // outside of the faces
    center: [p[0] + 2 * h[0], p[1] + 2 * h[1], p[2]] }),
};
const OPENING = 2000; // ms for which the page shows where everything is, before it follows the UAV
let view = "chase", offset = null, reach = 1, opening = null;

function look(name) {
  clearTimeout(opening);
  view = name;
  for (const button of $("views").children) button.classList.toggle("on", button.textContent === name);
  Plotly.relayout($("scene"), { "scene.camera": camera(flight, moment, true) });
}

// The share of the way from one point to another that no obstacle blocks (Möller and Trumbore 1997, all triangles).
function clearShare({ vertices: v, triangles: t }, from, to) {
  const d = to.map((x, i) => x - from[i]);
  let share = 1;
  for (let n = 0; n < t.length; n += 3) {
    const a = 3 * t[n], b = 3 * t[n + 1], c = 3 * t[n + 2];
    const e = [v[b] - v[a], v[b + 1] - v[a + 1], v[b + 2] - v[a + 2]], f = [v[c] - v[a], v[c + 1] - v[a + 1], v[c + 2] - v[a + 2]];
    const p = [d[1] * f[2] - d[2] * f[1], d[2] * f[0] - d[0] * f[2], d[0] * f[1] - d[1] * f[0]];
    const volume = e[0] * p[0] + e[1] * p[1] + e[2] * p[2];
    if (Math.abs(volume) < 1e-9) continue;
    const s = [from[0] - v[a], from[1] - v[a + 1], from[2] - v[a + 2]];
    const u = (s[0] * p[0] + s[1] * p[1] + s[2] * p[2]) / volume;
    if (u < 0 || u > 1) continue;
    const q = [s[1] * e[2] - s[2] * e[1], s[2] * e[0] - s[0] * e[2], s[0] * e[1] - s[1] * e[0]];
    const w = (d[0] * q[0] + d[1] * q[1] + d[2] * q[2]) / volume;
    const at = (f[0] * q[0] + f[1] * q[1] + f[2] * q[2]) / volume;
    if (w >= 0 && u + w <= 1 && at > 0.02 && at < share) share = at;
  }
  return share;
}

function away() { // a narrow stage is looked at from farther away, so that the valley fits
  const { width, height } = $("scene").getBoundingClientRect();
  return Math.max(1, 1.45 * height / Math.max(width, 1));
}

function inScene(point, box) { // metres to the camera's units, whose origin is the middle of the box
  const [x, y, z] = point.map((v, i) => (v - (box[i][0] + box[i][1]) / 2) * ASPECT);
  return { x, y, z };
}
const minus = (a, b) => ({ x: a.x - b.x, y: a.y - b.y, z: a.z - b.z });
const plus = (a, b) => ({ x: a.x + b.x, y: a.y + b.y, z: a.z + b.z });

function headings(flight) { // seen from above, smoothed so that the camera does not swing
  let x = null, y = null;
  return Array.from({ length: flight.moments }, (_, n) => {
    const [a, b, c, d] = row(flight.attitudes, n, 4), yaw = Math.atan2(2 * (d * c + a * b), 1 - 2 * (b * b + c * c));
    x = x === null ? Math.cos(yaw) : 0.8 * x + 0.2 * Math.cos(yaw);
    y = y === null ? Math.sin(yaw) : 0.8 * y + 0.2 * Math.sin(yaw);
    const size = Math.hypot(x, y) || 1;
    return [x / size, y / size];
  });
}

function camera(flight, moment, fresh) {
  const box = boxOf(sceneries[flight.world_seed]), p = Array.from(row(flight.positions, moment));
  const middle = [0, 1].map((axis) => (box[axis][0] + box[axis][1]) / 2);
  const wide = Math.max((box[0][1] - box[0][0]) / 32, (box[1][1] - box[1][0]) / 24, 0.3); // of what is in sight
  const far = away() * (data.states ? wide : 1);
  let { eye, center } = VIEWS[view](p, flight.headings[moment], [...middle, far]);
  if (view === "chase" && sceneries[flight.world_seed].triangles && !hidden.has("obstacles")) { // in front of what would hide the UAV, and slowly back again
    const free = Math.max(0.9 * clearShare(sceneries[flight.world_seed], p, eye), 0.3);
    reach = fresh ? free : Math.min(free, reach + 0.04);
    eye = eye.map((x, i) => p[i] + reach * (x - p[i]));
  }
  const aim = inScene(center, box), place = inScene(eye, box), up = { x: 0, y: 0, z: 1 };
  if (view !== "follow") return { eye: place, center: aim, up };
  if (fresh || !offset) offset = minus(place, aim); // until the viewer turns the scene
  return { eye: plus(aim, offset), center: aim, up };
}

// ------------------------------------------------------------------ the clock

let flight = null, moment = 0, charts = [], playing = null;

function show(next) {
  moment = Math.min(Math.max(next, 0), flight.moments - 1);
  hand($("scene"), changes(flight, moment));
  if (view === "follow" || view === "chase") Plotly.relayout($("scene"), { "scene.camera": camera(flight, moment, false) });
  for (const chart of charts) chart.move(moment);
  if (flight.told) tell(flight, moment);
  $("slider").value = moment;
  $("clock").textContent = `${number(flight.times[moment], 1)} s · ${flight.told ? "cycle" : "step"} ${moment} / ${flight.moments - 1}`;
}

function play(on) {
  if (playing) cancelAnimationFrame(playing);
  playing = null;
  $("play").textContent = on ? "❚❚" : "▶";
  if (!on) return;
  if (moment >= flight.moments - 1) show(0);
  const pace = 1000 * (flight.times[flight.moments - 1] - flight.times[0]) / Math.max(flight.moments - 1, 1); // 0.1 s
  let last = performance.now(), owed = 0;
  const tick = (now) => {
    owed += (now - last) / pace * Number($("speed").value);
    last = now;
    if (owed >= 1) { show(moment + Math.floor(owed)); owed %= 1; }
    if (moment >= flight.moments - 1) play(false); else playing = requestAnimationFrame(tick);
  };
  playing = requestAnimationFrame(tick);
}

function choose(index) {
  play(false);
  flight = flights[index];
  flight.headings ??= headings(flight);
  const place = sceneries[flight.world_seed], box = boxOf(place), [name, colour] = OUTCOMES[flight.outcome];
  $("outcome").textContent = name;
  $("outcome").style.background = colour;
  list($("facts"), flight.facts ?? { task: flight.task, valley: flight.world_seed, time: `${number(flight.steps / 10, 1)} s`,
    "path efficiency": number(flight.path_efficiency), "minimum clearance": `${number(flight.clearance)} m` });
  list($("position_stats"), flight.position_stats ? went(flight.position_stats) : {});
  list($("smoothness"), flight.smoothness ?? {});
  $("notes").replaceChildren();
  for (const note of flight.notes ?? []) element("p", {}, $("notes"), note);
  $("flight").value = index;
  $("slider").max = flight.moments - 1;
  drawCharts();
  const axis = (range) => ({ range, visible: false, showspikes: false });
  const scene = { xaxis: axis(box[0]), yaxis: axis(box[1]), zaxis: axis(box[2]), aspectmode: "manual",
    aspectratio: Object.fromEntries(box.map(([low, high], i) => ["xyz"[i], (high - low) * ASPECT])),
    dragmode: "turntable", bgcolor: "rgba(0,0,0,0)", camera: camera(flight, 0, true) };
  const layout = { scene, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false };
  return Plotly.react($("scene"), traces(flight), layout, { responsive: true, displayModeBar: false })
    .then(() => show(0));
}

function went({ altitude, height_quarters: quarters, wall_distance: wall }) { // the 5th, 50th and 95th percentile
  const spread = ({ p5, p50, p95 }) => `${[p5, p50, p95].map((value) => number(value, 1)).join(" / ")} m`;
  return { "altitude": spread(altitude), "to the nearest wall": spread(wall),
    "time in each quarter of the height": `${quarters.map((share) => Math.round(100 * share)).join(" / ")} %` };
}

function drawCharts() {
  const specs = flight.told ? loggedCharts(flight) : simulatedCharts();
  $("charts").replaceChildren();
  charts = specs.map((spec) => makeChart($("charts"), spec, flight.moments, (next) => { play(false); show(next); }));
  for (const chart of charts) chart.move(0); // the names take their place
  for (const chart of charts) chart.draw();
}

function simulatedCharts() {
  const take = (name) => Array.from({ length: flight.moments - 1 },
    (_, i) => flight.rewards[i * flight.rewardCount + flight.reward_names.indexOf(name)]);
  const happened = EVENTS.filter((name) => flight.reward_names.includes(name))
    .map((name) => [name, take(name).reduce((sum, v) => sum + v, 0)]).filter(([, sum]) => sum !== 0)
    .map(([name, sum]) => `${name} ${sum > 0 ? "+" : "−"}${Math.abs(sum)}`).join(", ");
  const terms = flight.reward_names.filter((name) => !EVENTS.includes(name));
  const speed = Array.from({ length: flight.moments }, (_, i) => Math.hypot(...row(flight.velocities, i)));
  const altitude = Array.from({ length: flight.moments }, (_, i) => flight.positions[3 * i + 2]);
  const [goalRadius] = sceneries[flight.world_seed].goal;
  const distance = Array.from({ length: flight.moments }, (_, i) => { // the goal reaches from the ground to the ceiling
    const [x, y] = row(flight.positions, i);
    return Math.max(Math.hypot(x - flight.goal[0], y - flight.goal[1]) - goalRadius, 0);
  });
  const one = (title, unit, values, colour, more = {}) => ({ title, unit, series: [{ name: title, colour, values }], ...more });
  return [
    { title: "Reward", unit: happened ? `at the end: ${happened}` : "per step", low: 0,
      series: terms.map((name) => ({ name, colour: TERM_COLOURS[name] ?? "#64707d", values: take(name) })) },
    one("Distance to goal", "m", distance, "#0072B2", { low: 0 }),
    one("Clearance", "m to the nearest obstacle", flight.clearances, "#009E73", { low: 0 }),
    ...(flight.risks.length ? [one("Collision risk", "of LifeGuard", flight.risks, "#D55E00", { low: 0, high: 1 })] : []),
    one("Altitude", "m", altitude, "#CC79A7", { low: 3, high: 4 }),
    one("Speed", "m/s", speed, "#E69F00", { low: 0 }),
  ];
}

// ------------------------------------------------------------------ controls

function othersColours() { // equal stripes of the colours that the flights have
  const colours = [...new Set(flights.map((item) => OUTCOMES[item.outcome][1]))];
  const stripes = colours.map((colour, i) => `${colour} ${100 * i / colours.length}% ${100 * (i + 1) / colours.length}%`);
  return `linear-gradient(90deg,${stripes})`;
}

function start() {
  const { source } = data;
  const name = source.log ?? source.run ?? source.policy;
  const trained = source.training_steps ? `, ${source.training_steps.toLocaleString("en")} training steps` : "";
  $("source").textContent = name + trained;
  const parts = source.log ? [source.started.replace("T", " ").slice(0, 19), "UTC"] :
    ["a quadrotor finds its way by LiDAR", source.env && `${source.env} valley`, source.seed !== undefined && `tasks of seed ${source.seed}`];
  $("setting").textContent = parts.filter(Boolean).join(" · ");
  document.title = `${name}${trained} – uavrl replay`;
  flights.forEach((item, i) => element("option", { value: i }, $("flight"),
    `task ${item.task}: ${OUTCOMES[item.outcome][0]}, ${item.steps} steps`));
  $("flight").hidden = flights.length < 2;
  $("flight").addEventListener("change", (event) => choose(Number(event.target.value)));
  const moving = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (moving) view = "overview";
  for (const name of Object.keys(VIEWS))
    element("button", { class: name === view ? "on" : "" }, $("views"), name).addEventListener("click", () => look(name));
  for (const touch of ["pointerdown", "wheel"]) $("scene").addEventListener(touch, () => clearTimeout(opening));
  for (const [name, which, colour] of LAYERS) {
    if (name === "planes" && flights.every((item) => !item.planeCount)) continue;
    if (name === "seen to move" && flights.every((item) => !item.objectCount)) continue;
    if (name === "map's direction" && flights.every((item) => !item.bearings?.length)) continue;
    if (name === "other flights" && flights.length < 2) continue;
    const button = element("button", { class: "on" }, $("layers"));
    if (colour) element("i", { style: `background:${colour === OTHERS ? othersColours() : colour}` }, button);
    button.append(name);
    button.addEventListener("click", () => {
      const visible = !button.classList.toggle("on") ? false : true;
      if (visible) hidden.delete(name); else hidden.add(name);
      Plotly.restyle($("scene"), { visible }, which).then(() => show(moment));
    });
  }
  const legend = (colour, text) => {
    const item = element("div", {}, $("legend"));
    element("i", { style: `background:${colour}` }, item);
    item.append(text);
  };
  legend(BODY, "UAV (its nose pink)");
  const happened = new Set(flights.map((item) => item.outcome));
  for (const [key, [name, colour]] of Object.entries(OUTCOMES)) if (happened.has(key) && !data.states) legend(colour, `path: ${name}`);
  for (const [state, colour] of Object.entries(STATES)) legend(colour, `path: ${state}`);
  legend(GOAL, "goal");
  legend(CELLS, "cells and points, by distance:");
  const { ball: radius } = Object.values(sceneries)[0];
  distanceScale($("legend"), radius);
  $("slider").addEventListener("input", (event) => { play(false); show(Number(event.target.value)); });
  $("play").addEventListener("click", () => play(!playing));
  document.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const on = event.target.tagName;
    if (on === "SELECT") return;
    if (event.key === " " && on !== "BUTTON") { event.preventDefault(); play(!playing); }
    if (steps && on !== "INPUT") { play(false); show(moment + steps); }  // the slider moves by itself
  });
  // A button that the mouse has pressed gives the keys back; one that the keyboard has pressed (detail 0) keeps them.
  document.addEventListener("click", (event) => { if (event.detail) event.target.closest("button")?.blur(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => choose(flights.indexOf(flight)));
  window.addEventListener("resize", () => { for (const chart of charts) { chart.draw(); chart.move(moment); } });
  choose(0).then(() => {
    if (moving) { opening = setTimeout(() => look("chase"), OPENING); play(true); }
    $("scene").on("plotly_relayout", (event) => {
      const now = event["scene.camera"];
      if (now && view === "follow") offset = minus(now.eye, now.center);
    });
    document.body.dataset.ready = "true";
  });
}

start();
