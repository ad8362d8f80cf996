"use strict";
// Unpack and draw. The promise `ready` tells a driver of the page that it is done.
const page = JSON.parse(document.getElementById("page-data").textContent);
const ready = (async () => {
  await numbers.unpack(document.getElementById("page-numbers").textContent);
  charts.name = page.name;
  charts.bands = page.bands;
  charts.hidden = new Set(page.hidden);
  const alike = document.getElementById("alike");
  charts.alike = alike.checked = differMuch(page.sections.time ?? []);
  charts.flights = new Set(page.runs.map((run) => run.label));
  for (const [name, groups] of Object.entries(page.sections)) {
    const section = document.getElementById(name);
    for (const group of groups) addGroup(section, group);
    if (!groups.length && name !== "poles") section.hidden = true;
  }
  for (const link of document.querySelectorAll("nav a")) link.hidden = document.querySelector(link.hash)?.hidden ?? true;
  [charts.start, charts.end] = page.span;
  const from = document.getElementById("from"), to = document.getElementById("to");
  charts.onZoom = (min, max) => {
    from.value = Number(min.toFixed(3));
    to.value = Number(max.toFixed(3));
    requestAnimationFrame(() => markTime(replay.time));
  };
  for (const input of [from, to]) input.addEventListener("change", () => zoom(Number(from.value), Number(to.value)));
  document.getElementById("whole").addEventListener("click", () => zoom(charts.start, charts.end));
  zoom(charts.start, charts.end);
  startReplay(page.runs);
  showLegend(page.runs.map((run, i) => ({ label: run.label, colour: i, style: "solid" })));
  listBands(document.getElementById("bands"));
  alike.addEventListener("change", () => scaleAlike(alike.checked));
  // Small views while the large ones are out of sight.
  new IntersectionObserver(([seen]) => {
    document.getElementById("dock").classList.toggle("stuck", !seen.isIntersecting && seen.boundingClientRect.top < 0);
    showMoment(replay.time);
  }).observe(document.getElementById("views"));
  const redraw = () => charts.drawn.forEach(({ plot }) => plot.redraw(false));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("resize", () => requestAnimationFrame(() => markTime(replay.time)));
})();
