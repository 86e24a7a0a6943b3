"use strict";
// What is drawn of a real flight's log: no valley is known, only what the scans have seen, and the safety layer's states.

const STATES = data.states ?? {};

function seen(place) { // the points of all scans, by their height
  const points = columns(place.world);
  return { type: "scatter3d", mode: "markers", ...still, ...points,
    marker: { size: 1.8, opacity: 0.75, color: points.z, colorscale: [[0, "#8a8170"], [0.5, "#6b8f5e"], [1, "#5c6773"]] } };
}

function level({ box: [[left, right], [front, back]] }) { // a grid of 5 m at z = 0, where the autopilot's origin is
  const out = { x: [], y: [], z: [] }, add = (...ends) => {
    for (const [x, y] of ends) { out.x.push(x); out.y.push(y); out.z.push(0); }
    for (const axis of ["x", "y", "z"]) out[axis].push(null);
  };
  for (let x = 5 * Math.ceil(left / 5); x <= right; x += 5) add([x, front], [x, back]);
  for (let y = 5 * Math.ceil(front / 5); y <= back; y += 5) add([left, y], [right, y]);
  if (!out.x.length) add([left, front], [right, front]);
  return line({ ...out, opacity: 0.7, line: { width: 2, color: "#8b949e" } });
}

const stateColours = (flight) => Array.from(flight.told_at, (at) => STATES[flight.told[at][0]]);

function tell(flight, moment) { // what the safety layer did, and why, and who flew
  const [state, reason, sentence, control] = flight.told[flight.told_at[moment]];
  $("told").style.borderLeftColor = STATES[state];
  $("told").replaceChildren();
  element("b", {}, $("told"), `${state} (${reason})`);
  element("span", {}, $("told"), sentence);
  element("span", {}, $("told"), control);
}

function loggedCharts(flight) {
  const of = (values, part, width) => Array.from({ length: flight.moments }, (_, i) => values[width * i + part]);
  const speed = Array.from({ length: flight.moments }, (_, i) => Math.hypot(...row(flight.velocities, i)));
  const one = (title, unit, values, colour, more = {}) => ({ title, unit, series: [{ name: title, colour, values }], ...more });
  const both = (title, unit, part) => ({ title, unit, series: [
    { name: "policy", colour: "#56B4E9", values: of(flight.actions, part, 4) },
    { name: "sent", colour: "#0072B2", values: of(flight.setpoints, part, 4) }] });
  const bands = [];
  flight.told_at.forEach((at, moment) => {
    const [state] = flight.told[at], last = bands[bands.length - 1];
    if (last?.name === state) last.to = moment; else bands.push({ name: state, colour: STATES[state], from: moment, to: moment });
  });
  return [
    { title: "Safety layer", unit: "", series: [], bands },
    one("Distance to goal", "m, horizontally", flight.distances, "#0072B2", { low: 0 }),
    one("Nearest return", "m from the sensor", flight.nearest, "#009E73", { low: 0 }),
    both("Forward", "m/s", 0),
    both("Yaw rate", "rad/s, left positive", 3),
    one("Altitude", "m above the origin", of(flight.positions, 2, 3), "#CC79A7", { low: 0, high: 5 }),
    one("Speed", "m/s", speed, "#E69F00", { low: 0 }),
  ];
}
