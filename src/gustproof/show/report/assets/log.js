"use strict";
// Unpack and draw. The promise `ready` tells a driver of the page that it is done.
const page = JSON.parse(document.getElementById("page-data").textContent);
const ready = (async () => {
  await numbers.unpack(document.getElementById("page-numbers").textContent);
  charts.name = page.name;
  [charts.start, charts.end] = page.span;
  for (const [name, groups] of Object.entries(page.sections)) {
    const section = document.getElementById(name);
    for (const group of groups) addGroup(section, group);
    if (section.children.length < 2) section.hidden = true;
  }
  for (const link of document.querySelectorAll("nav a")) link.hidden = document.querySelector(link.hash)?.hidden ?? true;
  zoom(charts.start, charts.end);
  markTime(NaN);  // nothing is replayed
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.drawn.forEach(({ plot }) => plot.redraw(false)));
})();
