// The live page: read updates, keep a clock between them, draw at the rate of the screen. A flight in lockstep comes
// faster than the eye follows: it is played at the clock's pace, and can be played again once it is over.
import { camera, colours, drawHorizon, drawVehicle, euler, fresh, magnified, readColours } from "./picture.js";

const WINDOW_S = 20, MOST_S = 60, DEGREES = 180 / Math.PI;
const byId = (id) => document.getElementById(id);
const SERIES = ["attitude", "wind", "torque", "age", "angles", "rates"]; // each row: time [s], then its numbers
// One track a flight of this page, the last one flying; that of `shown.track` is drawn, `against` is behind it.
const newTrack = (law) => ({ law, peak: 0, landed: false, rows: Object.fromEntries(SERIES.map((name) => [name, []])) });
const tracks = [newTrack("")], choice = { track: 0, against: null };
const MOST_TRACKS = 8;
const main = () => tracks[choice.track].rows;
const behind = () => (choice.against === null ? null : tracks[choice.against].rows);
const facts = {};
const LEFT = 42; // pixels of a chart's labels
const cursor = { share: null }; // of the charts' width under the pointer
const clock = { t: 0, rate: 0, latest: 0, received: 0 };
const play = { on: true, pace: 1 }; // seconds of the flight a second; without end: each sample as it comes
// State that is drawn now, for tests of the page.
const shown = { frames: 0, t: 0, q: null, wind_N: null, updates: 0, changed: true };
let settle;
globalThis.ready = new Promise((settled) => (settle = settled)); // the first rows, or a page that waits, are drawn
globalThis.gustproof = { tracks, choice, facts, shown, play, get rows() { return main(); } };

const CHARTS = [
  { title: "attitude [deg]", series: "angles", names: ["roll φ", "pitch θ", "yaw ψ"], least: 1, digits: 3 },
  { title: "rates [deg/s]", series: "rates", names: ["roll", "pitch", "yaw"], least: 2, digits: 2 },
  { title: "commanded torque [N m]", series: "torque", names: ["roll", "pitch", "yaw"], least: 0.05, digits: 3 },
  { title: "wind velocity at the vehicle [m/s]", series: "wind", names: ["north", "east", "down"], least: 0.5, digits: 2 },
  { title: "delay from gyro to torque [ms]", series: "age", names: ["of the torque in effect"], least: 8, digits: 1, positive: true },
].map((chart) => {
  const figure = byId("charts").appendChild(document.createElement("figure"));
  const caption = figure.appendChild(document.createElement("figcaption"));
  caption.append(chart.title);
  chart.names.forEach((name, i) => {
    const item = caption.appendChild(document.createElement("span"));
    item.appendChild(document.createElement("i")).className = `k${i}`;
    item.append(`${name} `);
    item.appendChild(document.createElement("b")).textContent = "–";
    caption.append(" ");
  });
  const canvas = figure.appendChild(document.createElement("canvas"));
  canvas.className = chart.positive ? "low strip" : chart.series === "angles" ? "tall strip" : "strip";
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${chart.title} over time`);
  for (const kind of ["pointermove", "pointerleave"]) {
    canvas.addEventListener(kind, (event) => {
      cursor.share = kind === "pointermove" ? (event.offsetX - LEFT) / (canvas.clientWidth - LEFT) : null;
      shown.changed = true;
    });
  }
  return { ...chart, canvas, values: [...caption.querySelectorAll("b")], span: chart.least, stale: true };
});

// Return the index of the first row at or after time t.
function indexAt(list, t) {
  let low = 0, high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle][0] < t) low = middle + 1;
    else high = middle;
  }
  return low;
}

// Return the numbers of a series at time t, interpolated between two rows; null if there are none.
function valueAt(list, t) {
  if (!list.length) return null;
  const after = Math.min(indexAt(list, t), list.length - 1), b = list[after], a = list[Math.max(after - 1, 0)];
  const share = b[0] > a[0] ? Math.min(1, Math.max(0, (t - a[0]) / (b[0] - a[0]))) : 1;
  return a.slice(1).map((value, i) => (value === null || b[i + 1] === null ? null : value + share * (b[i + 1] - value)));
}

function attitudeAt(rows, t) {
  const numbers = valueAt(rows.attitude, t);
  if (!numbers) return null;
  const length = Math.hypot(...numbers.slice(0, 4));
  return numbers.slice(0, 4).map((part) => part / length);
}

function applyUpdate(update) {
  shown.updates += 1;
  if (update.flight) beginTrack();
  const rows = tracks.at(-1).rows;
  for (const name of ["attitude", "wind", "torque", "age"]) for (const row of update[name] ?? []) rows[name].push(row);
  let last = rows.angles.at(-1);
  for (const [t, w, x, y, z, p, q, r] of update.attitude ?? []) {
    const angles = euler([w, x, y, z]).map((angle) => angle * DEGREES);
    if (last) for (const i of [0, 2]) angles[i] += 360 * Math.round((last[i + 1] - angles[i]) / 360); // full turns count
    last = [t, ...angles];
    rows.angles.push(last);
    tracks.at(-1).peak = Math.max(tracks.at(-1).peak, ...angles.map(Math.abs));
    rows.rates.push([t, p * DEGREES, q * DEGREES, r * DEGREES]);
  }
  if (update.attitude) {
    const now = performance.now() / 1000, latest = rows.attitude.at(-1)[0];
    if (clock.received) clock.rate += 0.15 * ((latest - clock.latest) / Math.max(now - clock.received, 0.005) - clock.rate);
    clock.latest = latest;
    clock.received = now;
  }
  if (update.facts) {
    Object.assign(facts, update.facts);
    tracks.at(-1).law = facts.law;
    if (shown.updates === 1 && facts.phase === "over") land(); // a page that was loaded again
    showFacts();
    showTracks();
  }
  shown.changed = true;
}

// The last flight has been seen to its end.
function land() {
  tracks.at(-1).landed = true;
  play.on = false;
  clock.t = clock.latest;
  showFacts();
}

// The last flight is over, and has been seen to its end.
const landed = () => facts.phase === "over" && tracks.at(-1).landed;
// Samples are shown as they come.
const follows = () => facts.phase !== "over" && (facts.real_time || play.pace === Infinity);

// The time axis [s]: the scenario's length, or the last seconds of a long flight.
function span() {
  if (facts.duration_s <= MOST_S) return [0, facts.duration_s];
  if (landed()) return [0, Math.max(clock.latest, 1)];
  const to = Math.max(clock.t, WINDOW_S);
  return [to - WINDOW_S, to];
}

// How many times the tilt is drawn.
function factor() {
  const chosen = byId("magnify").value, { peak } = tracks[choice.track];
  return chosen === "auto" ? (peak < 1 ? 20 : peak < 4 ? 5 : 1) : Number(chosen);
}

// Another flight begins: it is drawn before the one that was shown until now.
function beginTrack() {
  if (tracks.length === MOST_TRACKS) {
    tracks.shift();
    choice.track = Math.max(choice.track - 1, 0);
  }
  tracks.push(newTrack(facts.law));
  choice.against = choice.track;
  choice.track = tracks.length - 1;
  Object.assign(clock, { t: 0, rate: 0, latest: 0, received: 0 });
  play.on = true;
  shown.t = 0;
  byId("clock").textContent = "";
  for (const chart of CHARTS) chart.span = chart.least;
}

// The two choices of a flight: the one that is drawn, and the one behind it.
function showTracks() {
  const names = tracks.map(({ law }, i) => `${i + 1}: ${law}`);
  byId("compare").hidden = tracks.length < 2;
  for (const [id, chosen, options] of [["track", choice.track, names], ["against", choice.against ?? "", names]]) {
    const empty = id === "against" ? [["", "none"]] : [];
    byId(id).replaceChildren(...[...empty, ...options.map((name, i) => [String(i), name])].map(([value, text]) => new Option(text, value)));
    byId(id).value = String(chosen);
  }
}

function choose(track, against) {
  Object.assign(choice, { track, against: against === track ? null : against });
  if (facts.phase === "over") {
    clock.latest = clock.t = main().attitude.at(-1)?.[0] ?? 0;
    land();
  }
  shown.changed = true;
  showTracks();
}

// Advance the clock of the picture: it plays, or follows the newest sample at the flight's own speed, slightly delayed.
function tick(now, dt) {
  if (!follows()) {
    if (!play.on || facts.paused) return;
    clock.t = Math.min(clock.latest, clock.t + (play.pace === Infinity ? Infinity : play.pace * Math.min(dt, 0.25)));
    if (facts.phase === "over" && clock.t >= clock.latest) land();
    return;
  }
  const stopped = facts.phase === "over" || facts.paused || now - clock.received > 0.5;
  if (stopped) clock.rate = 0;
  const behind = clock.latest - 0.08 * clock.rate - clock.t;
  clock.t = stopped && Math.abs(behind) < 0.02 ? clock.latest : Math.min(clock.latest, clock.t + (clock.rate + 8 * behind) * Math.min(dt, 0.12));
}

function niceStep(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return decade * ([1, 2, 5].find((step) => step * decade >= value * 0.999) ?? 10);
}

// Draw column k of rows. Of each `every` rows draw the lowest and the highest, so no peak is lost; null leaves a gap.
function trace(g, list, k, first, last, every, x, y) {
  let gap = true;
  const point = (row) => {
    if (row[k] !== null) g[gap ? "moveTo" : "lineTo"](x(row[0]), y(row[k]));
    gap = row[k] === null;
  };
  g.beginPath();
  for (let i = first - (first % every); i < last; i += every) {
    const end = Math.min(i + every, last);
    let low = i, high = i;
    for (let j = i + 1; j < end; j++) {
      if (list[j][k] < list[low][k]) low = j;
      if (list[j][k] > list[high][k]) high = j;
    }
    point(list[Math.min(low, high)]);
    if (low !== high) point(list[Math.max(low, high)]);
  }
  if (last > first) point(list[last - 1]);
  g.stroke();
}

function drawStrip(chart, from, to) {
  const [g, width, height] = fresh(chart.canvas), list = main()[chart.series], other = behind()?.[chart.series] ?? [], left = LEFT, bottom = height - 16;
  const first = Math.max(indexAt(list, from) - 1, 0), known = Math.min(indexAt(list, to) + 1, list.length);
  const last = landed() ? known : Math.min(indexAt(list, clock.t) + 1, known); // what comes is not told before
  const every = Math.max(1, Math.ceil((last - first) / ((width - left) / 2)));
  const columns = chart.names.map((_, i) => i + 1);
  let largest = chart.least;
  const begin = Math.max(indexAt(other, from) - 1, 0), end = Math.min(indexAt(other, to) + 1, other.length);
  for (let i = first; i < known; i++) for (const k of columns) largest = Math.max(largest, Math.abs(list[i][k]));
  for (let i = begin; i < end; i++) for (const k of columns) largest = Math.max(largest, Math.abs(other[i][k]));
  chart.span = largest > chart.span ? largest : Math.max(largest, chart.span * 0.995);
  const span = 1.08 * chart.span, low = chart.positive ? 0 : -span;
  const y = (value) => (bottom * (span - value)) / (span - low), step = niceStep((span - low) / (chart.positive ? 2.2 : 4.4));
  const x = (t) => left + ((t - from) / (to - from)) * (width - left);
  g.font = "11px system-ui, sans-serif";
  g.textBaseline = "middle";
  g.lineWidth = 1;
  g.strokeStyle = colours.grid;
  g.fillStyle = colours.muted;
  g.beginPath();
  g.textAlign = "right";
  for (let value = Math.ceil(low / step) * step; value <= span; value += step) {
    g.moveTo(left, y(value));
    g.lineTo(width, y(value));
    g.fillText(+value.toPrecision(6), left - 5, Math.min(Math.max(y(value), 6), bottom - 5));
  }
  const ticks = niceStep((to - from) / 6);
  g.textAlign = "center";
  for (let t = Math.ceil(Math.max(from, 0) / ticks) * ticks; t <= to; t += ticks) {
    g.moveTo(x(t), 0);
    g.lineTo(x(t), bottom);
    g.fillText(`${+t.toPrecision(6)} s`, Math.min(Math.max(x(t), left + 8), width - 14), height - 6);
  }
  g.stroke();
  g.save();
  g.beginPath();
  g.rect(left, 0, width - left, bottom);
  g.clip();
  drawBehind(g, chart, x, y, bottom);
  g.lineWidth = 1;
  for (const k of columns) {
    g.strokeStyle = colours[`c${k - 1}`];
    g.globalAlpha = 0.45;
    g.setLineDash([4, 3]);
    trace(g, other, k, begin, end, every, x, y);
    g.globalAlpha = 1;
    g.setLineDash([]);
    trace(g, list, k, first, last, every, x, y);
  }
  g.restore();
}

// Bands of gusts, faults and events; limits where they are in sight, which never widen the axis; the cursor.
function drawBehind(g, chart, x, y, bottom) {
  for (const { from_s, to_s, kind } of facts.bands ?? []) {
    g.fillStyle = kind === "event" ? colours.ink : colours.wind;
    g.globalAlpha = 0.14;
    g.fillRect(x(from_s), 0, Math.max(x(to_s) - x(from_s), 1.5), bottom);
  }
  g.globalAlpha = 1;
  const limits = facts.limits?.[chart.series] ?? [];
  g.setLineDash([3, 3]);
  for (const { axis, value, from_s, to_s } of limits) {
    g.strokeStyle = axis === null ? colours.limit : colours[`c${axis}`];
    for (const sign of [1, -1]) {
      g.beginPath();
      g.moveTo(x(from_s), y(sign * value));
      g.lineTo(x(to_s), y(sign * value));
      g.stroke();
    }
  }
  g.setLineDash([]);
  g.fillStyle = colours.ink;
  if (landed() && clock.t < clock.latest) g.fillRect(x(clock.t), 0, 1, bottom);
  if (cursor.share === null || cursor.share < 0) return;
  g.fillStyle = colours.muted;
  g.fillRect(LEFT + cursor.share * (chart.canvas.clientWidth - LEFT), 0, 1, bottom);
}

// Values at the cursor, or the newest.
function tellValues(chart, from, to) {
  const t = cursor.share === null || cursor.share < 0 ? clock.t : from + cursor.share * (to - from);
  const values = valueAt(main()[chart.series], Math.min(t, landed() ? clock.latest : clock.t)) ?? [];
  const told = (value) => {  // three digits, and no more decimals than the quantity has
    if (Math.abs(value) < 0.5 * 10 ** -chart.digits) return "0";
    const places = Math.min(chart.digits, Math.max(0, 2 - Math.floor(Math.log10(Math.abs(value)))));
    return value.toFixed(places).replace("-", "−");
  };
  chart.values.forEach((place, i) => { place.textContent = values[i] == null ? "–" : told(values[i]); });
}

const counters = { numbersAt: 0 };

function draw(milliseconds) {
  const now = milliseconds / 1000, dt = Math.max(now - (draw.last ?? now), 0);
  draw.last = now;
  shown.frames += 1;
  const before = clock.t;
  tick(performance.now() / 1000, dt);
  if (clock.t !== before || shown.changed) {
    shown.changed = false;
    // after the landing the pictures are those of the time under the pointer
    const pointed = landed() && !play.on && cursor.share !== null && cursor.share >= 0, [from, to] = span();
    shown.t = pointed ? Math.min(from + Math.min(cursor.share, 1) * (to - from), clock.latest) : clock.t;
    shown.q = attitudeAt(main(), shown.t) ?? [1, 0, 0, 0];
    shown.wind_N = valueAt(main().wind, shown.t);
    const times = factor(), other = behind() && attitudeAt(behind(), shown.t);
    const drawn = magnified(shown.q, times);
    drawVehicle(byId("vehicle"), drawn, shown.wind_N, other && magnified(other, times));
    drawHorizon(byId("horizon"), drawn, times);
    byId("scrub").value = shown.t;
    for (const chart of CHARTS) chart.stale = true;
  }
  // Draw one chart a frame: it moves a few pixels until its next turn, at a fraction of the cost.
  const chart = CHARTS[shown.frames % CHARTS.length];
  if (chart.stale) {
    chart.stale = false;
    drawStrip(chart, ...span());
  }
  if (shown.updates && shown.frames > CHARTS.length) settle();
  if (now - counters.numbersAt > 0.1) {
    counters.numbersAt = now;
    showNumbers();
  }
  requestAnimationFrame(draw);
}

const signed = (value, digits) => (value < 0 ? "−" : "+") + Math.abs(value).toFixed(digits);

// All numbers are of one time, so that legend and horizon agree.
function showNumbers() {
  const rows = main();
  for (const chart of CHARTS) tellValues(chart, ...span());
  if (rows.attitude.length) {
    const [phi, theta, psi] = euler(shown.q).map((angle) => signed(angle * DEGREES, 2));
    byId("angles").textContent = `roll ${phi}°  pitch ${theta}°  yaw ${psi}°${factor() === 1 ? "" : `, drawn ${factor()} times`}`;
    byId("clock").textContent = `${shown.t.toFixed(2)} s of ${facts.duration_s} s`;
  }
  if (rows.age.length) {
    const [, age] = rows.age[Math.min(indexAt(rows.age, clock.t), rows.age.length - 1)];
    byId("age").textContent = age === null ? "no command in effect" : `${age} ms old`;
  }
  if (shown.wind_N) {
    const [north, east, down] = shown.wind_N, from = (Math.atan2(-east, -north) * DEGREES + 360) % 360;
    const level = Math.hypot(north, east), whence = level < 0.05 ? "" : ` from ${Math.round(from) % 360}°`;
    const vertical = Math.abs(down) < 0.05 ? "" : `, ${Math.abs(down).toFixed(1)} m/s ${down > 0 ? "down" : "up"}`;
    byId("wind").textContent = `wind ${level.toFixed(1)} m/s${whence}${vertical}`;
  }
}

const PHASES = { ready: "ready: press Start", starting: "starting the vehicle", flying: "flying", over: "over" };

function showFacts() {
  const { phase, link } = facts, ready = phase === "ready", over = phase === "over", seen = landed() || follows();
  byId("title").textContent = document.title = `${facts.scenario} · ${facts.law}`;
  byId("phase").textContent = seen && over ? facts.message : facts.paused ? "paused" : PHASES[over ? "flying" : phase];
  if (facts.compiling && !over) byId("phase").textContent += `; compiling the simulator, once: some ${facts.compiling} s`;
  const mayStart = ready || (over && facts.goes_on);
  byId("start").disabled = !mayStart;
  byId("start").textContent = over ? "Fly again" : "Start";
  byId("choice").hidden = facts.laws.length < 2;
  byId("laws").disabled = !mayStart;
  const first = byId("laws").options.length !== facts.laws.length;
  if (first) {
    byId("laws").replaceChildren(...facts.laws.map((name, i) => new Option(name, i)));
  }
  if (ready || first) byId("laws").value = String(facts.laws.indexOf(facts.law)); // another window may choose
  byId("report").hidden = !(over && facts.has_report && facts.goes_on);
  byId("pause").hidden = facts.real_time && !over;
  byId("pause").disabled = !over && phase !== "flying";
  byId("pause").textContent = facts.paused ? "Resume" : play.on ? "Pause" : "Play";
  byId("player").hidden = ready || phase === "starting" || (facts.real_time && !over);
  byId("scrub").max = Math.max(facts.duration_s, clock.latest);
  const slider = byId("gust");
  slider.disabled = over;
  [slider.min, slider.max] = facts.gust_scale_limits;
  if (document.activeElement !== slider) slider.value = facts.gust_scale;
  byId("scale").textContent = `× ${facts.gust_scale.toFixed(2)}`;
  byId("mode").textContent = facts.mode ? `${facts.mode}${facts.armed ? ", armed" : ""}` : "–";
  byId("law").textContent = `${facts.law} on vehicle ${facts.vehicle}`;
  byId("link").textContent = link
    ? `${link.rate} ${link.rate === 1 ? "message" : "messages"}/s, ${link.lost} lost, ${link.bad} damaged${link.round_trip_ms === null ? "" : `, ${link.round_trip_ms.toFixed(1)} ms round trip`}`
    : "–";
  byId("lights").replaceChildren(
    ...facts.lights.map(({ text, value, held }) =>
      Object.assign(document.createElement("li"), {
        textContent: value === null || !seen ? text : `${text}: ${+value.toPrecision(3)}`,
        className: held === null || !seen ? "dark" : held ? "held" : "failed",
      }),
    ),
  );
  byId("next").hidden = !facts.commands?.length;
  byId("next").replaceChildren(
    byId("next").firstElementChild,
    ...(facts.commands ?? []).map((text) => Object.assign(document.createElement("code"), { textContent: text, tabIndex: 0 })),
  );
  byId("texts").replaceChildren(
    ...facts.texts.map((text) => Object.assign(document.createElement("li"), { textContent: text })),
  );
}

const pending = new Map(), inFlight = new Set();

// Send one value of a kind at a time, then the newest: a slider sends many, and none may overtake another.
async function send(name, value) {
  pending.set(name, value);
  if (inFlight.has(name)) return;
  inFlight.add(name);
  try {
    while (pending.has(name)) {
      const body = JSON.stringify(pending.get(name));
      pending.delete(name);
      const response = await fetch(name, { method: "POST", body });
      if (!response.ok) byId("phase").textContent = await response.text();
    }
  } catch {
    // the program has ended; the event source reports it
  } finally {
    inFlight.delete(name);
  }
}

byId("start").addEventListener("click", () => send("start", true));
// One button for the flight, while it comes, and for what is played of it.
byId("pause").addEventListener("click", () => {
  play.on = facts.paused || !play.on;
  if (facts.phase === "over" && play.on && clock.t >= clock.latest) clock.t = 0;
  if (facts.phase !== "over") send("pause", !play.on);
  showFacts();
});
byId("speed").addEventListener("change", () => {
  play.pace = Number(byId("speed").value);
  showFacts();
});
byId("scrub").addEventListener("input", () => {
  clock.t = Math.min(Number(byId("scrub").value), clock.latest);
  play.on = play.on && facts.phase !== "over";
  shown.changed = true;
  showFacts();
});
byId("laws").addEventListener("change", () => send("law", Number(byId("laws").value)));
for (const id of ["track", "against"]) {
  byId(id).addEventListener("change", () => choose(Number(byId("track").value), byId("against").value === "" ? null : Number(byId("against").value)));
}
byId("gust").addEventListener("input", () => send("gust", Number(byId("gust").value)));
byId("vehicle").addEventListener("pointermove", (event) => {
  if (!event.buttons) return;
  camera.azimuth -= event.movementX * 0.01;
  camera.elevation = Math.min(1.4, Math.max(0.05, camera.elevation + event.movementY * 0.01));
  shown.changed = true;
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  readColours();
  shown.changed = true;
});
byId("magnify").addEventListener("change", () => (shown.changed = true));
addEventListener("resize", () => (shown.changed = true));

const updates = new EventSource("events");
updates.onmessage = (event) => {
  applyUpdate(JSON.parse(event.data));
};
updates.onerror = () => {
  updates.close();
  facts.goes_on = false;
  if (facts.phase === "over") showFacts();
  else byId("phase").textContent = "connection to gustproof lost";
};
readColours();
requestAnimationFrame(draw);
