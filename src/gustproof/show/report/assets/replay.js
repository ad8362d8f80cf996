"use strict";
// All flights at one time, which is played, scrubbed or picked in a chart.
const replay = { runs: [], time: 0, end: 0, playing: false, last: 0 };
const ANGLES = ["φ", "θ", "ψ"];

// ZYX Euler angles [deg] of q_NB.
function eulerOf([w, x, y, z]) {
  const degrees = 180 / Math.PI;
  return [
    degrees * Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
    degrees * Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - x * z)))),
    degrees * Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
  ];
}

// Index of the last sample at or before a time.
function sampleAt(times, time) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time + 1e-4) low = middle;
    else high = middle - 1;
  }
  return low;
}

function addRun(run, i) {
  const figure = document.getElementById("views").appendChild(document.createElement("figure"));
  figure.appendChild(document.createElement("figcaption")).textContent = run.label;
  const view = attitudeView(figure, `var(--c${i % 7})`, `attitude of the vehicle, ${run.label}`);
  const angles = figure.appendChild(document.createElement("div"));
  angles.className = "angles";
  const outputs = ANGLES.map(() => angles.appendChild(document.createElement("output")));
  const time = numbers.at(run.time), q_NB = run.q_NB.map((place) => numbers.at(place)), gust_B = run.gust_B.map((place) => numbers.at(place));
  let strongest = 0;
  for (let k = 0; k < time.length; k++) strongest = Math.max(strongest, Math.hypot(gust_B[0][k], gust_B[1][k], gust_B[2][k]) || 0);
  const small = document.getElementById("minis").appendChild(document.createElement("figure"));
  const mini = attitudeView(small, `var(--c${i % 7})`, run.label), told = small.appendChild(document.createElement("span"));
  replay.runs.push({ view, outputs, mini, told, time, q_NB, gust_B, strongest });
  replay.end = Math.max(replay.end, time[time.length - 1]);
}

function showMoment(time) {
  replay.time = Math.min(Math.max(time, 0), replay.end);
  const factor = Number(document.getElementById("magnify").value);
  const strongest = Math.max(...replay.runs.map((run) => run.strongest));
  const stuck = document.getElementById("dock").classList.contains("stuck");
  for (const run of replay.runs) {
    const k = sampleAt(run.time, replay.time), q = run.q_NB.map((column) => column[k]);
    const arrow = strongest > 0 ? run.gust_B.map((column) => (0.95 * column[k]) / strongest) : null;
    run.view.update(magnified(q, factor), arrow);
    if (stuck) {
      run.mini.update(magnified(q, factor), arrow);
      run.told.textContent = eulerOf(q).map((angle, i) => `${ANGLES[i]} ${angle.toFixed(2).replace("-", "−")}°`).join("  ");
    }
    eulerOf(q).forEach((angle, i) => { run.outputs[i].value = `${ANGLES[i]} ${angle.toFixed(3).replace("-", "−")}°`; });
  }
  document.getElementById("scrub").value = replay.time;
  document.getElementById("clock").value = `${replay.time.toFixed(2)} s`;
  markTime(replay.time);
}

// Play the shown part of the flight.
function shownEnd() { return Math.min(replay.end, charts.shown[1]); }

function setPlaying(playing) {
  const [start] = charts.shown;
  if (playing && (replay.time >= shownEnd() || replay.time < start)) showMoment(Math.max(start, 0));
  replay.playing = playing;
  const button = document.getElementById("play");
  button.textContent = playing ? "Pause" : "Play";
  button.setAttribute("aria-pressed", playing);
  replay.last = performance.now();
  if (playing) requestAnimationFrame(advance);
}

function advance(now) {
  if (!replay.playing) return;
  const speed = Number(document.getElementById("speed").value);
  showMoment(replay.time + (Math.max(now - replay.last, 0) / 1000) * speed);
  replay.last = now;
  if (replay.time >= shownEnd()) {
    showMoment(shownEnd());
    setPlaying(false);
  }
  else requestAnimationFrame(advance);
}

function startReplay(runs) {
  runs.forEach(addRun);
  document.getElementById("scrub").max = replay.end;
  document.getElementById("scrub").addEventListener("input", (event) => showMoment(Number(event.target.value)));
  document.getElementById("play").addEventListener("click", () => setPlaying(!replay.playing));
  document.getElementById("magnify").addEventListener("change", () => showMoment(replay.time));
  charts.onPick = showMoment;
  showMoment(0);
}
