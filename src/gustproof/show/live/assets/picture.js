// Draw the vehicle in 3D and an artificial horizon on canvases. Axes are north-east-down and forward-right-down.

export const colours = {};

export function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ink", "muted", "line", "grid", "accent", "c0", "c1", "c2", "wind", "sky", "ground", "mark", "card", "limit"])
    colours[name] = style.getPropertyValue(`--${name}`).trim();
}

// Return the drawing context of a canvas, cleared, in CSS pixels with its width and height.
export function fresh(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

// Return the Euler angles phi, theta, psi [rad], ZYX, of q_NB = [w, x, y, z].
export function euler([w, x, y, z]) {
  return [
    Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
    Math.asin(Math.min(1, Math.max(-1, 2 * (w * y - z * x)))),
    Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
  ];
}

// Return the attitude with its angle from level enlarged, to show small motions.
export function magnified([w, x, y, z], factor) {
  const sine = Math.hypot(x, y, z);
  if (factor === 1 || sine < 1e-12) return [w, x, y, z];
  let half = Math.atan2(sine, w);
  if (half > Math.PI / 2) half -= Math.PI;
  const scale = Math.sin(factor * half) / sine;
  return [Math.cos(factor * half), scale * x, scale * y, scale * z];
}

function rotate([w, x, y, z], [a, b, c]) {
  const u = 2 * (y * c - z * b), v = 2 * (z * a - x * c), s = 2 * (x * b - y * a);
  return [a + w * u + y * s - z * v, b + w * v + z * u - x * s, c + w * s + x * v - y * u];
}

const ARM = 0.62, PROP = 0.34, FLOOR = 0.75, DISTANCE = 5;
const ROTORS = [[1, 1], [-1, -1], [1, -1], [-1, 1]].map(([x, y]) => [x * ARM * Math.SQRT1_2, y * ARM * Math.SQRT1_2, -0.07]);
const CIRCLE = Array.from({ length: 25 }, (_, i) => [Math.cos((i * Math.PI) / 12), Math.sin((i * Math.PI) / 12)]);
export const camera = { azimuth: -0.5, elevation: 0.38 };

// q: q_NB; wind_N: [m/s], or null; other: q_NB of another flight, drawn as outlines, or null
export function drawVehicle(canvas, q, wind_N, other) {
  const [g, width, height] = fresh(canvas);
  const size = Math.min(width / 3.6, height / 2.7), ca = Math.cos(camera.azimuth), sa = Math.sin(camera.azimuth);
  const ce = Math.cos(camera.elevation), se = Math.sin(camera.elevation);
  const place = ([n, e, d]) => {
    const ahead = n * ca + e * sa, right = e * ca - n * sa;
    const scale = (size * DISTANCE) / (DISTANCE + ahead * ce + d * se);
    return [width / 2 + right * scale, height * 0.38 + (d * ce - ahead * se) * scale];
  };
  const path = (points, closed) => {
    g.beginPath();
    points.forEach((point, i) => (i ? g.lineTo(...place(point)) : g.moveTo(...place(point))));
    if (closed) g.closePath();
  };
  const line = (points, colour, thick) => {
    path(points, false);
    g.strokeStyle = colour;
    g.lineWidth = thick;
    g.stroke();
  };
  g.lineCap = g.lineJoin = "round";
  for (const radius of [0.5, 1, 1.4]) line(CIRCLE.map(([c, s]) => [radius * c, radius * s, FLOOR]), colours.grid, 1.5);
  line([[-1.4, 0, FLOOR], [1.4, 0, FLOOR]], colours.grid, 1.5);
  line([[0, -1.4, FLOOR], [0, 1.4, FLOOR]], colours.grid, 1.5);
  g.fillStyle = colours.muted;
  g.font = "12px system-ui, sans-serif";
  g.textAlign = "center";
  g.textBaseline = "middle";
  for (const [letter, n, e] of [["N", 1.55, 0], ["E", 0, 1.55], ["S", -1.55, 0], ["W", 0, -1.55]]) g.fillText(letter, ...place([n, e, FLOOR]));
  const toNorth = (point) => rotate(q, point);
  const discs = ROTORS.map(([x, y, z]) => CIRCLE.map(([c, s]) => toNorth([x + PROP * c, y + PROP * s, z])));
  g.globalAlpha = 0.16;
  g.fillStyle = colours.ink;
  for (const disc of discs) {
    path(disc.map(([n, e]) => [n, e, FLOOR]), true);
    g.fill();
  }
  g.globalAlpha = 1;
  for (const rotor of ROTORS) line([toNorth([0, 0, 0]), toNorth([rotor[0], rotor[1], 0])], rotor[0] > 0 ? colours.c1 : colours.ink, 5);
  line([toNorth([0, 0, 0]), toNorth([0.42, 0, 0])], colours.c1, 3);
  discs.forEach((disc, i) => {
    path(disc, true);
    g.fillStyle = g.strokeStyle = ROTORS[i][0] > 0 ? colours.c1 : colours.accent;
    g.globalAlpha = 0.3;
    g.fill();
    g.globalAlpha = 1;
    g.lineWidth = 1.5;
    g.stroke();
  });
  if (other) {
    g.setLineDash([4, 3]);
    for (const rotor of ROTORS) {
      line([rotate(other, [0, 0, 0]), rotate(other, rotor)], colours.muted, 1.5);
      line(CIRCLE.map(([c, s]) => rotate(other, [rotor[0] + PROP * c, rotor[1] + PROP * s, rotor[2]])), colours.muted, 1.5);
    }
    g.setLineDash([]);
  }
  if (wind_N) drawArrow(g, place, wind_N);
}

// Draw an arrow along the wind that ends at the vehicle; its length grows with the root of the speed.
function drawArrow(g, place, wind_N) {
  const speed = Math.hypot(...wind_N);
  if (speed < 0.05) return;
  const length = 0.3 * Math.sqrt(speed), tip = place([0, 0, -0.12]);
  const tail = place(wind_N.map((part, i) => (-part / speed) * length - (i === 2 ? 0.12 : 0)));
  const [x, y] = [tip[0] - tail[0], tip[1] - tail[1]], long = Math.hypot(x, y) || 1, head = Math.min(11, long);
  const barb = (side) => [tip[0] - (head * (0.87 * x - side * 0.5 * y)) / long, tip[1] - (head * (0.87 * y + side * 0.5 * x)) / long];
  for (const [colour, thick] of [[colours.card, 7], [colours.wind, 3.5]]) { // set off from the rotors behind it
    g.strokeStyle = colour;
    g.lineWidth = thick;
    stroke(g, [tail, tip]);
    stroke(g, [barb(1), tip, barb(-1)]);
  }
}

// Sky and ground as seen from the vehicle, with a ladder of pitch and a scale of roll; q is turned `times` as far.
export function drawHorizon(canvas, q, times) {
  const [g, width, height] = fresh(canvas);
  const [phi, theta, psi] = euler(q), degree = height / 50, far = 2 * Math.hypot(width, height);
  g.save();
  g.translate(width / 2, height / 2);
  g.rotate(-phi);
  const level = ((theta * 180) / Math.PI) * degree;
  g.fillStyle = colours.sky;
  g.fillRect(-far, -far, 2 * far, far + level);
  g.fillStyle = colours.ground;
  g.fillRect(-far, level, 2 * far, far);
  g.strokeStyle = g.fillStyle = colours.mark;
  g.lineWidth = 2;
  g.font = "11px system-ui, sans-serif";
  g.textBaseline = "middle";
  stroke(g, [[-far, level], [far, level]]);
  g.lineWidth = 1;
  const middle = Math.round((theta * 18) / Math.PI) * 10, radius = height * 0.44, clear = radius - 26;
  for (let angle = Math.max(middle - 30, -90); angle <= Math.min(middle + 30, 90); angle += 5) {
    const half = height * (angle % 10 ? 0.08 : 0.16), y = level - angle * degree;
    if (!angle || Math.abs(y) > clear) continue; // keep the scales of roll and heading legible
    stroke(g, [[-half, y], [half, y]]);
    if (angle % 10 === 0) {
      g.textAlign = "left";
      g.fillText(angle / times, half + 5, y);
      g.textAlign = "right";
      g.fillText(angle / times, -half - 5, y);
    }
  }
  for (const angle of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
    const turn = (angle * Math.PI) / 180, long = angle % 30 ? 6 : 11;
    stroke(g, [[radius * Math.sin(turn), -radius * Math.cos(turn)], [(radius - long) * Math.sin(turn), -(radius - long) * Math.cos(turn)]]);
  }
  g.restore();
  g.strokeStyle = g.fillStyle = colours.c1;
  g.lineWidth = 3;
  const x = width / 2, y = height / 2;
  stroke(g, [[x - width * 0.2, y], [x - width * 0.07, y], [x - width * 0.05, y + 7]]);
  stroke(g, [[x + width * 0.2, y], [x + width * 0.07, y], [x + width * 0.05, y + 7]]);
  stroke(g, [[x - 1, y], [x + 1, y]]);
  stroke(g, [[x - 5, y - radius + 20], [x, y - radius + 12], [x + 5, y - radius + 20]]);
  drawHeading(g, width, height, (psi * 180) / Math.PI);
}

function drawHeading(g, width, height, heading) {
  const degree = width / 90, top = height - 20;
  g.globalAlpha = 0.75;
  g.fillStyle = colours.card;
  g.fillRect(0, top, width, 20);
  g.globalAlpha = 1;
  g.fillStyle = g.strokeStyle = colours.ink;
  g.lineWidth = 1;
  g.textAlign = "center";
  for (let angle = Math.ceil((heading - 45) / 10) * 10; angle <= heading + 45; angle += 10) {
    const x = width / 2 + (angle - heading) * degree, name = { 0: "N", 90: "E", 180: "S", 270: "W" }[(angle + 720) % 360];
    if (angle % 30) stroke(g, [[x, top], [x, top + 6]]);
    else g.fillText(name ?? (angle + 720) % 360, x, top + 11);
  }
  g.strokeStyle = colours.c1;
  g.lineWidth = 2;
  stroke(g, [[width / 2, top - 6], [width / 2, top + 4]]);
}

function stroke(g, points) {
  g.beginPath();
  points.forEach(([x, y], i) => (i ? g.lineTo(x, y) : g.moveTo(x, y)));
  g.stroke();
}
