"use strict";
// Charts by uPlot in the colours of the page's theme. Charts of time share zoom and cursor; groups export as PNG.
const charts = {
  drawn: [],  // {chart, plot, marker}, in the order of the page
  waiting: new Map(),  // place -> chart, of those that have not come near the window
  start: 0, end: 1,  // [s] the longest flight
  shown: [0, 0],  // [s] the zoom
  time: NaN,  // [s] of the replay
  bands: [],  // {from, to, kind, text} behind all charts of time
  flights: new Set(),  // labels of the page's legend
  hidden: new Set(),
  alike: false,  // one y scale for the charts of a row
  paper: [],  // plots of the charts while the page is printed
  onZoom() {},
  onPick() {},
  ofTime() { return this.drawn.filter(({ chart }) => chart.kind === "time"); },
};
const isPhone = matchMedia("(max-width: 599px)");

function themed(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }
function colourOf(curve) { return themed(curve.colour === null ? "--c6" : `--c${curve.colour % 7}`); }
function format(value) { return value == null ? "–" : Number(value).toPrecision(4).replace("-", "−"); }

// uPlot takes one x for all curves of a chart, and null for missing values.
function tableOf(chart) {
  const holes = (values) => (values.some(Number.isNaN) ? Array.from(values, (v) => (Number.isNaN(v) ? null : v)) : values);
  const curves = chart.curves.map((curve) => [numbers.at(curve.x), holes(numbers.at(curve.y))]);
  if (chart.kind === "plane") {  // poles may share a real part: joining would keep only one of them
    const all = curves.flatMap(([x, y], i) => Array.from(x, (value, k) => [value, i, y[k]])).sort((a, b) => a[0] - b[0]);
    return [all.map(([x]) => x), ...curves.map((_, i) => all.map(([, j, y]) => (i === j ? y : null)))];
  }
  const same = chart.curves.every((curve) => String(curve.x) === String(chart.curves[0].x));
  return same ? [curves[0][0], ...curves.map(([, y]) => y)] : uPlot.join(curves.map(([x, y]) => [x, y]));
}

function seriesOf(curve, kind, k, faded) {
  const series = { label: curve.label, stroke: () => colourOf(curve), width: 1.3 * k, value: (_, v) => format(v), points: { show: false } };  // null is a gap
  if (faded) series.alpha = 0.75;  // the curves below a noisy one shine through
  if (curve.style === "dashed") series.dash = [7 * k, 5 * k];
  else if (curve.colour >= 7) series.dash = [3 * k, 2 * k];  // the palette a second time
  if (kind === "plane") {
    series.paths = () => null;
    const ring = curve.style === "hollow";
    series.points = { show: true, size: (ring ? 11 : 6) * k, width: 1.6 * k, stroke: () => colourOf(curve), fill: () => (ring ? "transparent" : colourOf(curve)) };
  }
  return series;
}

function axisOf(label, k, side) {
  const axis = {
    stroke: () => themed("--muted"), font: `${11 * k}px system-ui, sans-serif`, labelFont: `${11 * k}px system-ui, sans-serif`,
    grid: { stroke: () => themed("--grid"), width: k }, ticks: { stroke: () => themed("--line"), width: k, size: 5 * k }, gap: 3 * k,
  };
  if (side === "x") return { ...axis, label, labelSize: 17 * k, size: 24 * k, space: (isPhone.matches ? 34 : 60) * k };
  return { ...axis, size: (isPhone.matches ? 40 : 58) * k, space: 26 * k };
}

// k scales everything, for a picture of higher resolution.
function optionsOf(chart, width, height, k = 1) {
  const [distrX, distrY] = { time: [1, 1], linear: [1, 1], frequency: [3, 3], semilog: [3, 1], decibel: [3, 1], plane: [4, 4] }[chart.kind];
  const valuesOf = (distr) => (_, splits) => (distr === 1 ? splits.map(plain) : decades(splits));
  const range = rangesOf(chart), splitsOf = (distr) => distr > 1 && { splits: (_, __, low, high) => (distr === 3 ? lines : linesAboutZero)(low, high) };
  return {
    width, height, padding: [8 * k, (isPhone.matches ? 9 : 16) * k, 0, 0],
    scales: { x: { time: false, distr: distrX, asinh: 0.1, ...range.x }, y: { distr: distrY, asinh: 0.1, ...range.y } },
    axes: [[axisOf(chart.x, k, "x"), distrX], [axisOf("", k, "y"), distrY]].map(([axis, distr]) => ({ ...axis, values: valuesOf(distr), ...splitsOf(distr) })),
    series: [{ label: chart.x.split(" [")[0], value: (_, v) => format(v) }, ...chart.curves.map((curve) => seriesOf(curve, chart.kind, k, chart.kind === "time" && chart.curves.length > 1 && /\[N m\]|\[-\]/.test(chart.title)))],
    hooks: { drawAxes: [(plot) => drawBehind(plot, chart, k)] },
    legend: { live: true, markers: { width: 2, stroke: (_, i) => colourOf(chart.curves[i - 1]), dash: (_, i) => (chart.curves[i - 1].style === "dashed" ? "dashed" : "solid") } },
    cursor: {
      y: false, points: { size: 6 }, drag: { x: chart.kind === "time", y: false, setScale: chart.kind === "time" },
      ...(chart.kind === "time" && { sync: { key: "time", scales: ["x", null], setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } } }),
    },
  };
}

// Frequency charts show six decades at most. Poles keep clear of the edges. A flat curve gets an axis of height 2.
function rangesOf(chart) {
  if (["time", "linear", "semilog"].includes(chart.kind)) {
    return { y: { range: (plot, low, high) => {
      if (charts.alike && chart.group && chart.kind === "time") [low, high] = rangeOfRow(plot, chart, low, high);
      if (chart.kind === "semilog" && high > low) return [low - 0.04 * (high - low), high + 0.12 * (high - low)];
      return low === high ? [low - 1, high + 1] : uPlot.rangeNum(low, high, 0.08, true);
    } } };
  }
  if (chart.kind === "decibel") {
    const limits = (chart.marks ?? []).filter(({ y, colour }) => y !== null && colour === null).map(({ y }) => y);
    return { y: { range: (_, low, high) => {
      const top = Math.max(high, ...limits.filter((y) => y < high + 12));  // a limit that is nearly reached is in sight
      return uPlot.rangeNum(Math.max(low, top - 90), top, 0.08, true);
    } } };
  }
  if (chart.kind === "frequency") return { y: { range: (_, low, high) => [Math.max(low, high * 1e-6) / 1.4, high * 1.4] } };
  const widest = (_, low, high) => 3 * Math.max(-low, high, 1);
  return { x: { range: (_, low, high) => [-widest(_, low, high), Math.max(3 * high, 0.1)] }, y: { range: (...all) => [-widest(...all), widest(...all)] } };
}

// Least and largest shown value of all charts of a row with the same unit.
function rangeOfRow(plot, chart, low, high) {
  const unit = chart.title.split("[")[1], { min, max } = plot.scales.x;
  for (const { chart: other, plot: its } of charts.drawn) {
    if (other.group !== chart.group || other.title.split("[")[1] !== unit) continue;
    const [x, ...columns] = its.data;
    columns.forEach((y, i) => {
      if (!its.series[i + 1].show) return;
      for (let k = 0; k < x.length; k++) {
        if ((min != null && (x[k] < min || x[k] > max)) || y[k] == null) continue;
        low = Math.min(low, y[k]);
        high = Math.max(high, y[k]);
      }
    });
  }
  return [low, high];
}

function rescale() {
  for (const { plot } of charts.ofTime()) {
    const { min, max } = plot.scales.x;
    if (min != null) plot.setScale("x", { min, max });  // a new plot has no scale before its first microtask
  }
}

// Attitudes that differ by more than ten times get one scale: a rest of .05 deg must not look like a peak of 3 deg.
function differMuch(groups) {
  const spans = groups.filter(({ title }) => title === "Attitude").flatMap(({ charts: all }) => all).map(({ curves }) => {
    const known = curves.flatMap(({ y }) => Array.from(numbers.at(y)).filter(Number.isFinite));
    return known.reduce((most, value) => Math.max(most, value), -Infinity) - known.reduce((least, value) => Math.min(least, value), Infinity);
  }).filter((span) => span > 0);
  return spans.length > 1 && Math.max(...spans) > 10 * Math.min(...spans);
}

function scaleAlike(alike) {
  charts.alike = alike;
  rescale();
}

// Bands of gusts, faults and events, then limits and crossovers: all behind the curves, none widens an axis.
function drawBehind(plot, chart, k) {
  const { ctx: ink, bbox } = plot, ratio = window.devicePixelRatio * k;
  ink.save();
  ink.beginPath();
  ink.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ink.clip();
  ink.font = `${10 * ratio}px system-ui, sans-serif`;
  const names = [];
  if (chart.kind === "time") charts.bands.forEach((band, i) => drawBand(plot, ink, band, i, ratio, names));
  const named = new Set(), taken = [];
  for (const mark of chart.marks ?? []) {
    drawMark(plot, ink, mark, ratio, named.has(`${mark.label}${mark.x}${mark.colour}`) ? null : taken);
    named.add(`${mark.label}${mark.x}${mark.colour}`);
  }
  ink.restore();
}

function drawBand(plot, ink, band, i, ratio, names) {
  const { top, height } = plot.bbox, colour = themed(BAND_COLOURS[band.kind]);
  const [left, right] = [band.from, band.to].map((time) => plot.valToPos(time, "x", true));
  ink.fillStyle = ink.strokeStyle = colour;
  ink.globalAlpha = 0.13;
  ink.fillRect(left, top, right - left, height);
  ink.globalAlpha = charts.bands.length < 27 ? 0.8 : 0.2;
  ink.lineWidth = ratio;
  ink.setLineDash([]);
  ink.beginPath();
  ink.moveTo(left, top);
  ink.lineTo(left, top + height);
  ink.stroke();
  ink.globalAlpha = 1;
  ink.fillStyle = themed("--muted");
  ink.textAlign = "left";
  ink.textBaseline = "top";
  if (charts.bands.length >= 27) return;
  const [x, y] = freePlace(names, [left + 3 * ratio, top + 2 * ratio], ink.measureText(bandName(i)).width, 11 * ratio, 1);
  if (y < top + height / 3) ink.fillText(bandName(i), x, y);  // where many begin at once, the list has them all
}

function drawMark(plot, ink, mark, ratio, taken) {
  const { left, top, width, height } = plot.bbox, upward = mark.y === null;
  const [from, to] = mark.x === null ? [left, left + width] : mark.x.map((x) => plot.valToPos(x, "x", true));
  const y = upward ? 0 : plot.valToPos(mark.y, "y", true);
  ink.strokeStyle = ink.fillStyle = themed(mark.colour === null ? "--limit" : `--c${mark.colour % 7}`);
  ink.lineWidth = 1.2 * ratio;
  if (from === to && !upward) {  // a dot
    ink.beginPath();
    ink.arc(from, y, 3.5 * ratio, 0, 2 * Math.PI);
    ink.fill();
  }
  ink.setLineDash([2 * ratio, 3 * ratio]);
  ink.beginPath();
  ink.moveTo(upward ? from : Math.max(from, left), upward ? top : y);
  ink.lineTo(upward ? from : Math.min(to, left + width), upward ? top + height : y);
  ink.stroke();
  if (!taken) return;
  ink.setLineDash([]);
  ink.textAlign = "left";
  ink.textBaseline = "top";
  const wide = ink.measureText(mark.label).width, line = 11 * ratio, low = y > top + height / 2;
  if (from === to && !upward) {
    const beside = from + 6 * ratio + wide < left + width ? from + 6 * ratio : from - 6 * ratio - wide;
    return ink.fillText(mark.label, ...freePlace(taken, [beside, y - line], wide, line, -1));
  }
  const at = upward ? [from + 3 * ratio, top + 2 * ratio] : [Math.min(to, left + width) - 4 * ratio - wide, y + (low ? -line : 2 * ratio)];
  ink.fillText(mark.label, ...freePlace(taken, at, wide, line, !upward && low ? -1 : 1));
}

// The first place at or beyond `at`, line by line, whose text covers no other.
function freePlace(taken, [x, y], wide, line, way) {
  while (taken.some((other) => Math.abs(other.y - y) < line && x < other.x + other.wide + 4 && other.x < x + wide + 4)) y += way * line;
  taken.push({ x, y, wide });
  return [x, y];
}

const BAND_COLOURS = { gust: "--gust", moment: "--moment", link: "--link", event: "--c6" };
const BAND_LETTERS = "abcdefghijklmnopqrstuvwxyz";

// A band is named by its kind; if several are of that kind, by a letter, which the list above the charts explains.
function bandName(i) {
  const { kind } = charts.bands[i];
  return charts.bands.filter((band) => band.kind === kind).length === 1 ? kind : BAND_LETTERS[i];
}

// More bands than there are letters stand as one for each text.
function listBands(list) {
  const lettered = charts.bands.length < 27, kinds = new Map();
  charts.bands.forEach((band, i) => {
    const key = lettered ? i : band.text, known = kinds.get(key) ?? { ...band, count: 0 };
    kinds.set(key, { ...known, from: Math.min(known.from, band.from), to: Math.max(known.to, band.to), count: known.count + 1 });
  });
  [...kinds.values()].forEach(({ from, to, kind, text, count }, i) => {
    const item = list.appendChild(document.createElement("li"));
    item.style.setProperty("--chip", `var(${BAND_COLOURS[kind]})`);
    const times = count > 1 ? `, ${count} times` : "";
    item.textContent = `${lettered && bandName(i) !== kind ? `${BAND_LETTERS[i]}: ` : ""}${rounded(text)}${times}, ${plain(from)}${to > from ? ` to ${plain(to)}` : ""} s`;
  });
}

// Numbers of an event in three digits, without a zero's sign.
function rounded(text) { return text.replace(/(^|[\s,(])-?\d+(\.\d+)?(?![\w.])/g, (found) => found.replace(/-?\d.*/, (value) => plain(Number(Number(value).toPrecision(3))))); }

// The one legend of the page: the flights, and what is common to them. A press hides or shows a curve in all charts.
function showLegend(flights) {
  const legend = document.getElementById("legend"), common = new Map();
  for (const chart of [...charts.waiting.values(), ...charts.drawn.map((drawn) => drawn.chart)]) {
    for (const curve of chart.curves) if (COMMON.test(curve.label)) common.set(curve.label, curve);
  }
  for (const curve of [...flights, ...common.values()]) {
    const button = legend.appendChild(document.createElement("button"));
    button.type = "button";
    button.setAttribute("aria-pressed", String(!charts.hidden.has(curve.label)));
    button.append(keyOf(curve), curve.label);
    button.addEventListener("click", () => {
      const shown = charts.hidden.has(curve.label);
      charts.hidden[shown ? "delete" : "add"](curve.label);
      button.setAttribute("aria-pressed", String(shown));
      for (const { chart, plot } of charts.drawn) {
        chart.curves.forEach((each, i) => { if (each.label === curve.label) plot.setSeries(i + 1, { show: shown }); });
      }
    });
  }
}

const COMMON = /^(all runs|reference.*)$/;

function keyOf(curve) {
  const key = document.createElement("i");
  key.className = "key";
  key.style.borderTopColor = `var(${curve.colour === null ? "--c6" : `--c${curve.colour % 7}`})`;
  if (curve.style === "dashed" || curve.colour >= 7) key.style.borderTopStyle = "dashed";
  return key;
}

// Names of curves that are no flights stand once for their group; the title of a chart names its only curve.
function groupLegend(article, group) {
  const own = new Map();
  for (const chart of group.charts) {
    if (chart.curves.length === 1 && chart.curves[0].label === chart.title) continue;
    for (const curve of chart.curves) if (!charts.flights.has(curve.label) && !COMMON.test(curve.label)) own.set(curve.label, curve);
  }
  if (!own.size) return;
  const line = article.appendChild(document.createElement("p"));
  line.className = "keys";
  for (const curve of own.values()) {
    const item = line.appendChild(document.createElement("span"));
    item.append(keyOf(curve), curve.label);
  }
}

// Grid of a logarithmic axis: powers of ten, and 2 to 9 times each if powers are few: many lines would hide the curves.
// uPlot's own loops for ever on a range just below a power.
function lines(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
    for (let digit = 1; digit < 10; digit++) found.push(Number(`${digit}e${power}`));
  }
  const inside = found.filter((value) => value >= low && value <= high), powers = inside.filter(isPower);
  return powers.length > (isPhone.matches ? 1 : 3) ? powers : inside;
}

// Grid of an axis that is logarithmic away from 0: zero, and powers of ten from .1 on; from 1 on where room is scarce.
function linesAboutZero(low, high) {
  const found = [0];
  for (let power = isPhone.matches ? 0 : -1; 10 ** power <= Math.max(-low, high); power++) found.push(10 ** power, -(10 ** power));
  return found.filter((value) => value >= low && value <= high).sort((a, b) => a - b);
}

function isPower(value) { return value === 0 || Math.abs(Math.log10(Math.abs(value)) % 1) < 1e-6; }

function plain(value) { return value === null ? value : String(Number(value.toPrecision(5))).replace("-", "−"); }

// Labels of a logarithmic axis: powers of ten, and the values between them if powers are few.
function decades(splits) {
  const few = splits.filter((value) => value !== null && isPower(value)).length < 2;
  return splits.map((value) => {
    if (value === null || !(few || isPower(value))) return null;
    const power = Math.round(Math.log10(Math.abs(value)));
    if (value === 0 || Math.abs(power) < 3 || !isPower(value)) return plain(value);
    return `${value < 0 ? "−" : ""}10${String(power).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] ?? "⁻")}`;
  });
}

function addGroup(section, group) {
  const article = section.appendChild(document.createElement("article"));
  article.className = "group";
  const header = article.appendChild(document.createElement("header"));
  header.appendChild(document.createElement("h3")).textContent = group.title;
  for (const [text, what, act] of [["PNG", "a picture", savePicture], ["CSV", "a table of what is shown", saveTable]]) {
    const button = header.appendChild(document.createElement("button"));
    Object.assign(button, { type: "button", textContent: text, title: `Save '${group.title}' as ${what}` });
    button.addEventListener("click", () => act(group));
  }
  if (group.note) Object.assign(article.appendChild(document.createElement("p")), { className: "note", textContent: group.note });
  groupLegend(article, group);
  const row = article.appendChild(document.createElement("div"));
  row.className = group.title === "Attitude" ? "charts tall" : `charts of${group.charts.length}`;
  for (const chart of group.charts) {
    chart.group = group.title;
    addChart(row, chart);
  }
}

// A place of the chart's height; the chart is drawn once it comes near the window.
function addChart(row, chart) {
  const place = row.appendChild(document.createElement("div"));
  place.className = "chart";
  const title = place.appendChild(document.createElement("h4"));
  title.textContent = chart.title;
  const beyond = [...new Set((chart.marks ?? []).filter(({ y, colour }) => y !== null && colour === null && chart.kind === "time").map(({ label }) => label))];
  if (beyond.length) title.appendChild(document.createElement("small")).textContent = ` ${beyond.join(", ")}`;
  place.style.setProperty("--height", `${heightOf(row, chart)}px`);
  charts.waiting.set(place, chart);
  nearby.observe(place);
}

const nearby = new IntersectionObserver((seen) => drawPlaces(seen.filter((each) => each.isIntersecting).map((each) => each.target)), { rootMargin: "400px" });

function drawPlaces(places) {
  for (const place of places) drawChart(place);
  if (places.length) charts.drawn.sort((a, b) => a.order - b.order);
  if (places.length && charts.alike) queueMicrotask(rescale);
}

// Draw all charts, for print and for whoever needs them at once.
function drawAll() { drawPlaces([...charts.waiting.keys()]); }

// On paper each chart is a picture of what is shown, in light colours: it shrinks with the paper, which has no scroll bars.
function drawPaper(k = 2) {
  drawAll();
  document.documentElement.dataset.theme = "paper";
  charts.paper = charts.drawn.map(({ chart, plot: { root } }) => {
    const place = root.parentElement, width = place.parentElement.matches(".tall, .of1") ? 700 : 340;
    const plot = drawAside(chart, width, parseFloat(place.style.getPropertyValue("--height")), k);
    place.append(plot.ctx.canvas);
    return plot;
  });
}

function clearPaper() {
  delete document.documentElement.dataset.theme;
  for (const plot of charts.paper.splice(0)) {
    plot.ctx.canvas.remove();
    plot.destroy();
  }
}
addEventListener("beforeprint", () => { if (!charts.paper.length) drawPaper(); });
addEventListener("afterprint", clearPaper);

function heightOf(row, chart) {
  if (row.classList.contains("tall")) return 190;
  const height = chart.kind === "time" ? 150 : 220;
  return isPhone.matches ? height - 30 : height;
}

function drawChart(place) {
  const chart = charts.waiting.get(place);
  if (!chart) return;
  charts.waiting.delete(place);
  nearby.unobserve(place);
  const height = parseFloat(place.style.getPropertyValue("--height"));
  const plot = new uPlot(optionsOf(chart, Math.max(place.clientWidth, 120), height), tableOf(chart), place);
  plot.root.querySelector(".u-legend").setAttribute("aria-hidden", "true");  // values under a pointer
  plot.over.setAttribute("role", "img");
  plot.over.setAttribute("aria-label", `${chart.group}, ${chart.title} over ${chart.x}: ${chart.curves.map(({ label }) => label).join(", ")}`);
  const drawn = { chart, plot, marker: null, order: [...document.querySelectorAll(".chart")].indexOf(place) };
  charts.drawn.push(drawn);
  new ResizeObserver(() => {
    if (place.clientWidth && place.clientWidth !== plot.width) plot.setSize({ width: place.clientWidth, height });
  }).observe(place);
  chart.curves.forEach(({ label }, i) => { if (charts.hidden.has(label)) plot.setSeries(i + 1, { show: false }); });
  if (chart.kind !== "time") return;
  joinTime(drawn);
  if (!(charts.shown[1] > charts.shown[0])) return;
  plot.setScale("x", { min: charts.shown[0], max: charts.shown[1] });
  requestAnimationFrame(() => markTime(charts.time));
}

function joinTime(drawn) {
  const { plot } = drawn;
  drawn.marker = plot.over.appendChild(document.createElement("div"));
  drawn.marker.className = "now";
  let pressed = 0;
  plot.over.addEventListener("mousedown", (event) => { pressed = event.clientX; });
  plot.over.addEventListener("click", (event) => {
    if (Math.abs(event.clientX - pressed) < 3) charts.onPick(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
  });
  plot.over.addEventListener("dblclick", () => zoom(charts.start, charts.end));
  (plot.hooks.setScale ??= []).push((_, key) => {
    const { min, max } = plot.scales.x;
    if (key === "x" && min != null && plot.status === 1) zoom(min, max);
  });
}

// Zoom all charts to the same time. A chart that shows it already is skipped, which ends the recursion.
function zoom(min, max) {
  if (!(max > min)) return;
  for (const { plot } of charts.ofTime()) {
    if (plot.scales.x.min !== min || plot.scales.x.max !== max) plot.setScale("x", { min, max });
  }
  charts.shown = [min, max];
  charts.onZoom(min, max);
}

function markTime(time) {
  charts.time = time;
  for (const { plot, marker } of charts.ofTime()) {
    const inside = time >= plot.scales.x.min && time <= plot.scales.x.max;
    marker.style.display = inside ? "" : "none";
    if (inside) marker.style.transform = `translateX(${plot.valToPos(time, "x")}px)`;
  }
}

// A chart beside the page, `k` times as large, with the zoom and the hidden curves of the page. uPlot draws in a microtask.
function drawAside(chart, width, height, k) {
  const ratio = window.devicePixelRatio, options = optionsOf(chart, (width * k) / ratio, (height * k) / ratio, k / ratio);
  options.legend = { show: false };
  delete options.cursor.sync;
  const plot = new uPlot(options, tableOf(chart), document.createElement("div"));
  if (chart.kind === "time") plot.setScale("x", { min: charts.shown[0], max: charts.shown[1] });
  chart.curves.forEach(({ label }, i) => { if (charts.hidden.has(label)) plot.setSeries(i + 1, { show: false }); });
  return plot;
}

// A group as one picture for print: always light, charts below each other, each with its legend.
async function picture(group, k = 2.5) {
  const width = 760 * k, height = 250 * k, top = 46 * k, head = 34 * k;
  const canvas = Object.assign(document.createElement("canvas"), { width, height: head + group.charts.length * (height + top) });
  document.documentElement.dataset.theme = "paper";
  try {
    const ink = canvas.getContext("2d");
    ink.fillStyle = themed("--card");
    ink.fillRect(0, 0, canvas.width, canvas.height);
    write(ink, group.title, 12 * k, 22 * k, `600 ${15 * k}px system-ui, sans-serif`, themed("--ink"));
    for (const [i, chart] of group.charts.entries()) {
      const y = head + i * (height + top), plot = drawAside(chart, 760, 250, k);
      await new Promise((done) => queueMicrotask(() => queueMicrotask(done)));  // uPlot draws in a microtask
      write(ink, chart.title, 12 * k, y + 16 * k, `600 ${12 * k}px system-ui, sans-serif`, themed("--ink"));
      legend(ink, chart, 12 * k, y + 36 * k, k);
      ink.drawImage(plot.ctx.canvas, 0, y + top);
      plot.destroy();
    }
  } finally {
    delete document.documentElement.dataset.theme;
  }
  return canvas;
}

function legend(ink, chart, x, y, k) {
  for (const curve of chart.curves.filter(({ label }) => !charts.hidden.has(label))) {
    ink.strokeStyle = colourOf(curve);
    ink.lineWidth = 2.5 * k;
    ink.setLineDash(curve.style === "dashed" ? [5 * k, 3 * k] : []);
    ink.beginPath();
    ink.moveTo(x, y - 4 * k);
    ink.lineTo(x + 20 * k, y - 4 * k);
    ink.stroke();
    ink.setLineDash([]);
    x += 26 * k + write(ink, curve.label, x + 26 * k, y, `${11 * k}px system-ui, sans-serif`, themed("--ink")) + 16 * k;
  }
}

function write(ink, text, x, y, font, colour) {
  Object.assign(ink, { font, fillStyle: colour });
  ink.fillText(text, x, y);
  return ink.measureText(text).width;
}

async function savePicture(group) {
  const canvas = await picture(group);
  canvas.toBlob((blob) => saveAs(group, blob, "png"));
}

// Rows of what is shown: the curves that are not hidden, in the zoom. Columns are those of the figures' own tables.
function tableText(group) {
  const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const rows = ["panel,curve,x_label,y_label,x,y"];
  group.charts.forEach((chart, i) => {
    const [from, to] = chart.kind === "time" ? charts.shown : [-Infinity, Infinity];
    for (const curve of chart.curves) {
      if (charts.hidden.has(curve.label)) continue;
      const x = numbers.at(curve.x), y = numbers.at(curve.y), names = [i + 1, curve.label, chart.x, chart.title].map(String).map(quoted).join(",");
      x.forEach((value, k) => { if (value >= from && value <= to) rows.push(`${names},${short(value)},${Number.isNaN(y[k]) ? "" : short(y[k])}`); });
    }
  });
  return `${rows.join("\n")}\n`;
}

// The least digits that give the same float32.
function short(value) { return Number(value.toPrecision(7)); }

function saveTable(group) { saveAs(group, new Blob([tableText(group)], { type: "text/csv" }), "csv"); }

function saveAs(group, blob, suffix) {
  const link = document.createElement("a");
  link.download = `${charts.name}-${group.title.toLowerCase().replace(/[^\w]+/g, "-")}.${suffix}`;
  link.href = URL.createObjectURL(blob);
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
