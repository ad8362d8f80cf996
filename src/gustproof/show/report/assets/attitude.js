"use strict";
// A quadrotor X in 3D as SVG, turned by q_NB = [w, x, y, z]; north-east-down, seen from a camera that a drag moves.
const camera = { azimuth: -0.45, elevation: 0.42, views: [] };

function rotated([w, x, y, z], [a, b, c]) {
  const u = 2 * (y * c - z * b), v = 2 * (z * a - x * c), s = 2 * (x * b - y * a);
  return [a + w * u + y * s - z * v, b + w * v + z * u - x * s, c + w * s + x * v - y * u];
}

// The rotation from level with its angle enlarged, to show small motions.
function magnified([w, x, y, z], factor) {
  const sine = Math.hypot(x, y, z);
  if (factor === 1 || sine < 1e-12) return [w, x, y, z];
  let half = Math.atan2(sine, w);
  if (half > Math.PI / 2) half -= Math.PI;
  const scale = Math.sin(factor * half) / sine;
  return [Math.cos(factor * half), scale * x, scale * y, scale * z];
}

// Parallel projection of a point in N to the screen. The y axis of SVG points down, as the z axis of N does.
function projected([north, east, down]) {
  const { azimuth, elevation } = camera, cos = Math.cos(azimuth), sin = Math.sin(azimuth);
  const ahead = north * cos + east * sin;
  return [east * cos - north * sin, down * Math.cos(elevation) - ahead * Math.sin(elevation)];
}

function pathOf(points, closed = false) {
  return `M${points.map((point) => projected(point).map((v) => v.toFixed(4)).join(" ")).join("L")}${closed ? "Z" : ""}`;
}

const ARM = 0.62, PROP = 0.36, GROUND = 0.55;
const ROTORS = [[1, 1], [-1, -1], [1, -1], [-1, 1]].map(([x, y]) => [x * ARM * Math.SQRT1_2, y * ARM * Math.SQRT1_2, -0.08]);
const TURN = Array.from({ length: 33 }, (_, i) => [Math.cos((i * Math.PI) / 16), Math.sin((i * Math.PI) / 16)]);

function attitudeView(host, colour, name) {
  const svg = host.appendChild(document.createElementNS("http://www.w3.org/2000/svg", "svg"));
  svg.setAttribute("viewBox", "-1.25 -1 2.5 2");
  svg.setAttribute("class", "attitude");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", name);
  svg.style.setProperty("--body", colour);
  const part = (kind, name) => {
    const element = svg.appendChild(document.createElementNS("http://www.w3.org/2000/svg", kind));
    element.setAttribute("class", name);
    return element;
  };
  const ground = [part("path", "ground"), part("path", "ground"), part("path", "ground north")];
  const letters = [["N", 1.12, 0], ["E", 0, 1.12], ["S", -1.12, 0], ["W", 0, -1.12]].map(([letter, n, e]) => {
    const text = part("text", "");
    text.textContent = letter;
    return [text, [n, e, GROUND]];
  });
  const gust = part("path", "gust");
  const arms = ROTORS.map(([x]) => part("path", x > 0 ? "arm front" : "arm"));
  const up = part("path", "up");
  const discs = ROTORS.map(([x]) => part("path", x > 0 ? "rotor front" : "rotor"));
  let shown = { q: [1, 0, 0, 0], arrow: null };
  const view = {
    svg,
    // q: q_NB; arrow: a vector in B from the centre, in lengths of an arm
    update(q, arrow) {
      shown = { q, arrow };
      const turned = (point) => rotated(q, point);
      ROTORS.forEach((rotor, i) => {
        arms[i].setAttribute("d", pathOf([turned([0, 0, 0]), turned(rotor)]));
        discs[i].setAttribute("d", pathOf(TURN.map(([c, s]) => turned([rotor[0] + PROP * c, rotor[1] + PROP * s, rotor[2]])), true));
      });
      up.setAttribute("d", pathOf([turned([0, 0, 0]), turned([0, 0, -0.3])]));
      gust.setAttribute("d", arrow ? arrowOf(turned(arrow)) : "");
    },
    redraw() {
      ground[0].setAttribute("d", pathOf(TURN.map(([c, s]) => [c, s, GROUND]), true));
      ground[1].setAttribute("d", pathOf([[0, -1, GROUND], [0, 1, GROUND]]) + pathOf([[0, 0, GROUND], [-1, 0, GROUND]]));
      ground[2].setAttribute("d", pathOf([[0, 0, GROUND], [1, 0, GROUND]]));
      for (const [text, point] of letters) {
        const [x, y] = projected(point);
        text.setAttribute("x", x.toFixed(4));
        text.setAttribute("y", y.toFixed(4));
      }
      view.update(shown.q, shown.arrow);
    },
  };
  camera.views.push(view);
  svg.addEventListener("pointerdown", (event) => svg.setPointerCapture(event.pointerId));
  svg.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    camera.azimuth -= event.movementX * 0.01;
    camera.elevation = Math.min(1.5, Math.max(0.02, camera.elevation + event.movementY * 0.01));
    for (const each of camera.views) each.redraw();
  });
  view.redraw();
  return view;
}

function arrowOf(tip) {
  const [x, y] = projected(tip), length = Math.hypot(x, y);
  const shaft = pathOf([[0, 0, 0], tip]);
  if (length < 0.05) return shaft;
  const barb = (side) => [x - (0.1 * (x * 0.87 - side * y * 0.5)) / length, y - (0.1 * (y * 0.87 + side * x * 0.5)) / length];
  return `${shaft}M${barb(1).join(" ")}L${x} ${y}L${barb(-1).join(" ")}`;
}
