"use strict";
// The page's data: see page.rs. Lengths are in the clouds' units, and the first cloud's frame is that of the scene.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const canvas = byId("scene");

// --- Vectors and matrices; a matrix is 16 numbers, row by row, and acts on columns.

const add = (a, b, scale = 1) => a.map((v, i) => v + b[i] * scale);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
const multiply = (a, b) => a.map((_, i) => [0, 1, 2, 3].reduce((s, k) => s + a[i - (i % 4) + k] * b[k * 4 + (i % 4)], 0));
const apply = (m, p) => [0, 4, 8].map((row) => m[row] * p[0] + m[row + 1] * p[1] + m[row + 2] * p[2] + m[row + 3]);
const scaled = (s, t) => [s[0], 0, 0, t[0], 0, s[1], 0, t[1], 0, 0, s[2], t[2], 0, 0, 0, 1];

// --- The scene: both clouds in the first one's frame, moved and shrunk so that all lies within the unit sphere.

const poses = data.clouds.map((_, i) => (i === 0 ? scaled([1, 1, 1], [0, 0, 0]) : data.pair.t_first_second.flat()));
const corners = data.clouds.flatMap(({ points: { low, high } }, i) =>
  [...Array(8).keys()].map((c) => apply(poses[i], low.map((v, axis) => ((c >> axis) & 1 ? high[axis] : v)))));
const low = [0, 1, 2].map((axis) => Math.min(...corners.map((p) => p[axis])));
const high = [0, 1, 2].map((axis) => Math.max(...corners.map((p) => p[axis])));
const extent = high.map((v, axis) => v - low[axis]);
const radius = Math.hypot(...extent) / 2 || 1;
const toScene = scaled([1, 1, 1].map((v) => v / radius), low.map((v, axis) => -(v + high[axis]) / 2 / radius));
const placed = poses.map((pose) => multiply(toScene, pose));

const keypoints = data.clouds.flatMap((cloud, of) => cloud.keypoints.map((keypoint, rank) => {
  const at = apply(placed[of], [keypoint.x, keypoint.y, keypoint.z]);
  return { ...keypoint, of, rank, at, link: null };
}));
const numOfFirst = data.clouds[0].keypoints.length;
const links = (data.pair ? data.pair.links : []).map(([first, second, distance]) => {
  const link = { first: keypoints[first], second: keypoints[numOfFirst + second], distance };
  for (const end of [link.first, link.second]) {
    if (!end.link || distance < end.link.distance) end.link = link;
  }
  return link;
});

// A cloud that is much flatter along one axis probably lies on the ground of the other two.
const flattest = extent.indexOf(Math.min(...extent));
const guessedUp = extent[flattest] < 0.6 * Math.min(...extent.filter((_, axis) => axis !== flattest)) ? flattest : 2;
const start = { yaw: -0.9, pitch: 0.5, zoom: 1, target: [0, 0, 0], up: guessedUp };
const view = { ...start };
const shown = { clouds: data.clouds.map(() => true), points: true, keypoints: true, surface: false, links: true };
const size = Math.min(6, Math.max(1.6, 260 / Math.sqrt(data.clouds[0].points.count)));
const style = { point: size, apart: 1 };
let hovered = null;

// --- WebGL.

const HEAD = `#version 300 es
precision highp float;`;
const FOG = `
uniform vec3 background; uniform vec2 fog;
vec3 faded(vec3 color, float depth) { return mix(color, background, fog.y * smoothstep(fog.x - 1.0, fog.x + 1.0, depth)); }`;
const SHADERS = {
  points: [`
uniform mat4 model, camera, projection; uniform float point_size; uniform sampler2D colors;
in vec3 position; in float saliency; out vec3 color; out float depth;
void main() {
  vec4 seen = camera * (model * vec4(position, 1.0));
  gl_Position = projection * seen;
  depth = -seen.z;
  gl_PointSize = max(1.0, point_size / depth);
  color = texture(colors, vec2((saliency * 255.0 + 0.5) / 256.0, 0.5)).rgb;
}`, `${FOG}
in vec3 color; in float depth; out vec4 result;
void main() {
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  result = vec4(faded(color, depth), 1.0);
}`],
  surface: [`
uniform mat4 model, camera, projection; uniform mat3 turn; uniform sampler2D colors;
in vec3 position, normal; in float saliency; out vec3 color, facing, place; out float depth;
void main() {
  vec4 seen = camera * (model * vec4(position, 1.0));
  gl_Position = projection * seen;
  depth = -seen.z; place = seen.xyz;
  facing = mat3(camera) * (turn * normal);
  color = texture(colors, vec2((saliency * 255.0 + 0.5) / 256.0, 0.5)).rgb;
}`, `${FOG}
in vec3 color, facing, place; in float depth; out vec4 result;
void main() {
  vec3 normal = normalize(facing), eye = normalize(-place);
  float lit = abs(dot(normal, eye));
  float sky = 0.5 + 0.5 * normalize(facing).y;
  vec3 shaded = color * (0.3 + 0.55 * lit + 0.2 * sky) + 0.12 * pow(lit, 24.0);
  result = vec4(faded(shaded, depth), 1.0);
}`],
  discs: [`
uniform mat4 camera, projection; uniform float disc_size, hovered; uniform vec3 plain, repeated;
in vec4 disc; out vec3 color;
void main() {
  vec4 seen = camera * vec4(disc.xyz, 1.0);
  seen.z += 0.03;
  gl_Position = projection * seen;
  gl_PointSize = disc_size * (float(gl_VertexID) == hovered ? 1.5 : 1.0);
  color = disc.w > 0.5 ? repeated : plain;
}`, `
uniform float opacity; in vec3 color; out vec4 result;
void main() {
  float r = length(gl_PointCoord - 0.5) * 2.0, soft = fwidth(r);
  float inside = 1.0 - smoothstep(1.0 - soft, 1.0, r);
  if (inside <= 0.0) discard;
  result = vec4(mix(color, vec3(1.0), smoothstep(0.66 - soft, 0.66, r)), inside * opacity);
}`],
  lines: [`
uniform mat4 camera, projection; uniform vec2 viewport; uniform float width;
in vec3 here, there; in vec2 corner;
void main() {
  vec4 a = projection * (camera * vec4(here, 1.0)), b = projection * (camera * vec4(there, 1.0));
  vec2 along = normalize((b.xy / b.w - a.xy / a.w) * viewport + vec2(1e-6, 0.0));
  vec4 end = corner.x > 0.5 ? b : a;
  end.xy += vec2(-along.y, along.x) * corner.y * width / viewport * end.w;
  gl_Position = end;
}`, `
uniform vec3 repeated; uniform float opacity; out vec4 result;
void main() { result = vec4(repeated, opacity); }`],
};

let gl = null;
let programs = {};
let buffers = {};

function compile(vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, HEAD + source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

/** Uploads arrays; `layout` has for each attribute its data, number of components, and type. */
function upload(of, layout, indices) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  for (const [name, [content, components, type]] of Object.entries(layout)) {
    const place = gl.getAttribLocation(programs[of].program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, content, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, components, type, type !== gl.FLOAT, 0, 0);
  }
  if (indices) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  }
  gl.bindVertexArray(null);
  return array;
}

/** Takes 16-bit positions, which arrive in [0, 1], to the scene. */
const unpacked = (of, { low, high }) => multiply(placed[of], scaled(high.map((v, axis) => v - low[axis]), low));

function prepare() {
  gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
  if (!gl) return false;
  for (const [name, [vertex, fragment]] of Object.entries(SHADERS)) programs[name] = compile(vertex, fragment);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, bytes(data.colors));
  for (const [key, value] of [[gl.TEXTURE_MIN_FILTER, gl.NEAREST], [gl.TEXTURE_MAG_FILTER, gl.NEAREST]]) {
    gl.texParameteri(gl.TEXTURE_2D, key, value);
  }
  const common = ({ positions, saliency }) => ({
    position: [bytes(positions), 3, gl.UNSIGNED_SHORT], saliency: [bytes(saliency), 1, gl.UNSIGNED_BYTE],
  });
  buffers.points = data.clouds.map(({ points }) => upload("points", common(points)));
  buffers.surface = data.clouds.map(({ surface }) => surface && upload("surface",
    { ...common(surface.vertices), normal: [bytes(surface.normals), 4, gl.BYTE] }, bytes(surface.triangles)));
  return true;
}

// --- The camera.

/** Unit vectors of a view: to the right, up, and to the eye. */
function basis(view) {
  const unit = (axis) => [0, 1, 2].map((i) => (i === axis % 3 ? 1 : 0));
  const [a, b, up] = [unit(view.up + 1), unit(view.up + 2), unit(view.up)];
  const level = add(a.map((v) => v * Math.cos(view.yaw)), b, Math.sin(view.yaw));
  const eye = add(level.map((v) => v * Math.cos(view.pitch)), up, Math.sin(view.pitch));
  const right = add(a.map((v) => -v * Math.sin(view.yaw)), b, Math.cos(view.yaw));
  return { right, up: cross(eye, right), eye };
}

const FIELD_OF_VIEW = 0.6;

/** The corners of the clouds' boxes as the first view sees them: right, up, towards the eye. */
function firstSeen() {
  const { right, up, eye } = basis({ ...start, up: view.up });
  return corners.map((corner) => apply(toScene, corner)).map((p) => [right, up, eye].map((axis) => dot(axis, p)));
}

function camera() {
  const { right, up, eye } = basis(view);
  const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
  const tangent = Math.tan(FIELD_OF_VIEW / 2);
  const needed = ([x, y, z]) => z + 1.06 * Math.max((Math.abs(x) + gap()) / aspect, Math.abs(y)) / tangent;
  const distance = Math.max(...firstSeen().map(needed)) * view.zoom;
  const at = add(view.target, eye, distance);
  const rows = [right, up, eye];
  const matrix = [...rows.flatMap((row) => [...row, -dot(row, at)]), 0, 0, 0, 1];
  const reach = 2 + gap() + Math.hypot(...view.target);
  const [near, far] = [Math.max(0.01, distance - reach), distance + reach];
  const f = 1 / tangent;
  const projection = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, -(far + near) / (far - near), -2 * far * near / (far - near),
    0, 0, -1, 0];
  return { right, up, eye, distance, matrix, projection };
}

/** How far each of two clouds is moved aside, so that links can be seen: at first a little more than its width. */
const gap = () => (data.clouds.length > 1 ? 1.08 * style.apart * Math.max(0.4, ...firstSeen().map(([x]) => Math.abs(x))) : 0);
const aside = (of, { right }) => right.map((v) => v * gap() * (of === 0 ? -1 : 1));
const moved = (shift) => scaled([1, 1, 1], shift);

// --- Drawing.

const color = (name) => {
  const hex = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
};

function use(name, seen, values) {
  const { program, uniforms } = programs[name];
  gl.useProgram(program);
  const all = { camera: seen.matrix, projection: seen.projection, ...values };
  for (const [key, location] of Object.entries(uniforms)) {
    const value = [].concat(all[key] ?? 0);
    if (value.length === 16) gl.uniformMatrix4fv(location, true, value);
    else if (value.length === 9) gl.uniformMatrix3fv(location, true, value);
    else if (key === "colors") gl.uniform1i(location, 0);
    else gl[`uniform${value.length}fv`](location, value);
  }
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const seen = camera();
  const background = color("--scene");
  const fog = [seen.distance, parseFloat(getComputedStyle(document.documentElement).getPropertyValue("--fog"))];
  gl.viewport(0, 0, width, height);
  gl.clearColor(...background, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  data.clouds.forEach(({ points, surface }, of) => {
    if (!shown.clouds[of]) return;
    const shift = moved(aside(of, seen));
    if (shown.surface && surface) {
      const turn = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((i) => poses[of][i]);
      use("surface", seen, { model: multiply(shift, unpacked(of, surface.vertices)), turn, background, fog });
      gl.bindVertexArray(buffers.surface[of]);
      gl.drawElements(gl.TRIANGLES, surface.count * 3, gl.UNSIGNED_INT, 0);
    }
    if (shown.points) {
      // A point of the size that was asked for is in the middle of the first view.
      const pointSize = style.point * ratio * seen.distance / view.zoom;
      use("points", seen, { model: multiply(shift, unpacked(of, points)), point_size: pointSize, background, fog });
      gl.bindVertexArray(buffers.points[of]);
      gl.drawArrays(gl.POINTS, 0, points.count);
    }
  });
  drawKeypoints(seen, ratio, [width, height]);
  drawAxes(seen);
}

const isShown = ({ of }) => shown.keypoints && shown.clouds[of];

function drawKeypoints(seen, ratio, viewport) {
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  const [plain, repeated] = [color("--accent"), color("--repeated")];
  const place = (keypoint) => add(keypoint.at, aside(keypoint.of, seen));
  gl.disable(gl.DEPTH_TEST);
  const both = shown.links ? links.filter(({ first, second }) => isShown(first) && isShown(second)) : [];
  const about = (link) => hovered && (hovered === link.first || hovered === link.second);
  for (const [some, width, opacity] of [[both, 1.5, hovered ? 0.2 : 0.6], [both.filter(about), 3, 1]]) {
    const ends = some.flatMap(({ first, second }) => {
      const [a, b] = [place(first), place(second)];
      return [[0, -1], [0, 1], [1, -1], [1, -1], [0, 1], [1, 1]].flatMap((corner) => [...a, ...b, ...corner]);
    });
    use("lines", seen, { viewport, width: width * ratio, repeated, opacity });
    stream("lines", ends, [["here", 3], ["there", 3], ["corner", 2]], gl.TRIANGLES);
  }
  const discs = keypoints.filter(isShown);
  const vertices = discs.flatMap((keypoint) => [...place(keypoint), keypoint.link ? 1 : 0]);
  // What is hidden by points still shines through.
  for (const opacity of [0.3, 1]) {
    const disc_size = (discs.length > 300 ? 9 : 13) * ratio;
    use("discs", seen, { disc_size, hovered: discs.indexOf(hovered), plain, repeated, opacity });
    stream("discs", vertices, [["disc", 4]], gl.POINTS);
    gl.enable(gl.DEPTH_TEST);
  }
  gl.disable(gl.BLEND);
}

/** Draws vertices that change with the view, one attribute after the other in each. */
function stream(of, vertices, layout, mode) {
  buffers.stream ??= gl.createBuffer();
  gl.bindVertexArray(null);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffers.stream);
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(vertices), gl.STREAM_DRAW);
  const stride = layout.reduce((sum, [, components]) => sum + components, 0);
  let offset = 0;
  const places = layout.map(([name]) => gl.getAttribLocation(programs[of].program, name));
  layout.forEach(([, components], i) => {
    gl.enableVertexAttribArray(places[i]);
    gl.vertexAttribPointer(places[i], components, gl.FLOAT, false, stride * 4, offset * 4);
    offset += components;
  });
  gl.drawArrays(mode, 0, vertices.length / stride);
  places.forEach((place) => gl.disableVertexAttribArray(place));
}

/** The directions of the first cloud's axes, the nearest drawn last. */
function drawAxes({ right, up, eye }) {
  const axes = ["x", "y", "z"].map((name, axis) => ({ name, axis, x: right[axis] * 34, y: -up[axis] * 34, z: eye[axis] }));
  const colors = ["#e5484d", "#30a46c", "#3e8bff"];
  byId("axes").innerHTML = axes.sort((a, b) => a.z - b.z).map(({ name, axis, x, y }) =>
    `<line x2="${x}" y2="${y}" stroke="${colors[axis]}"/>` +
    `<text x="${x * 1.32}" y="${y * 1.32}" fill="${colors[axis]}">${name}</text>`).join("");
}

let waiting = false;
function redraw() {
  if (waiting || !gl) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    draw();
    document.documentElement.dataset.state = "drawn";
  });
}

// --- Turning, moving, zooming, hovering.

const pointers = new Map();

function pan(dx, dy) {
  const { right, up, distance } = camera();
  const unit = 2 * distance * Math.tan(FIELD_OF_VIEW / 2) / canvas.clientHeight;
  view.target = add(add(view.target, right, -dx * unit), up, dy * unit);
}

function zoom(factor) {
  view.zoom = Math.min(4, Math.max(0.03, view.zoom * factor));
}

function onMove(event) {
  const before = pointers.get(event.pointerId);
  if (!before) return hover(event);
  const now = [event.clientX, event.clientY];
  const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
  if (pointers.size > 1) {
    const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
    const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
    zoom(apart(before) / Math.max(1, apart(now)));
    pan(dx / 2, dy / 2);
  } else if (event.buttons & 6 || event.shiftKey) {
    pan(dx, dy);
  } else {
    view.yaw -= dx * 0.008;
    view.pitch = Math.min(1.57, Math.max(-1.57, view.pitch + dy * 0.008));
  }
  pointers.set(event.pointerId, now);
  redraw();
}

/** The keypoint under the pointer, the nearest to the eye of several. */
function pick(x, y) {
  const seen = camera();
  const both = multiply(seen.projection, seen.matrix);
  let best = null;
  for (const keypoint of keypoints.filter(isShown)) {
    const p = add(keypoint.at, aside(keypoint.of, seen));
    const w = dot(both.slice(12, 15), p) + both[15];
    const [sx, sy] = apply(both, p).map((v) => v / w);
    const [px, py] = [(sx + 1) / 2 * canvas.clientWidth, (1 - sy) / 2 * canvas.clientHeight];
    if (w > 0 && Math.hypot(px - x, py - y) < 9 && (!best || w < best.w)) best = { keypoint, w, px, py };
  }
  return best;
}

function hover(event) {
  const box = canvas.getBoundingClientRect();
  const found = pick(event.clientX - box.left, event.clientY - box.top);
  const tooltip = byId("tooltip");
  tooltip.hidden = !found;
  if (hovered !== (found && found.keypoint)) redraw();
  hovered = found && found.keypoint;
  if (!found) return;
  describe(tooltip, hovered);
  const [width, height] = [tooltip.offsetWidth, tooltip.offsetHeight];
  tooltip.style.left = `${Math.max(4, found.px + 16 + width > box.width ? found.px - 16 - width : found.px + 16)}px`;
  tooltip.style.top = `${Math.max(4, Math.min(found.py - height / 2, box.height - height - 4))}px`;
}

const number = (value, digits = 4) => (value === null ? "–" : Number(value.toPrecision(digits)).toString());

function describe(tooltip, { of, rank, saliency, occupancy, x, y, z, nearest_index, link }) {
  const head = element("strong", data.clouds.length > 1 ? `Keypoint ${rank + 1} of ${"AB"[of]}` : `Keypoint ${rank + 1}`);
  const rows = [["score (saliency)", number(saliency)], ["occupancy", number(occupancy)],
    ["position", [x, y, z].map((v) => number(v)).join(", ")], ["nearest point", nearest_index]];
  if (link) {
    const partner = of === 0 ? link.second : link.first;
    rows.push([`repeats ${"AB"[partner.of]}`, `${partner.rank + 1}, at ${number(link.distance, 3)}`]);
  }
  tooltip.replaceChildren(head, list(rows));
}

function reset() {
  Object.assign(view, start, { up: view.up });
  redraw();
}

function listen() {
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.classList.add("turning");
    byId("tooltip").hidden = true;
    if (event.pointerType === "touch") hover(event);
  });
  canvas.addEventListener("pointermove", onMove);
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => {
      pointers.delete(event.pointerId);
      canvas.classList.toggle("turning", pointers.size > 0);
    });
  }
  canvas.addEventListener("pointerleave", () => { byId("tooltip").hidden = true; hovered = null; redraw(); });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", reset);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * 0.002));
    redraw();
  }, { passive: false });
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    gl = null;
    fail("The graphics driver dropped the picture. Load the page again.");
  });
  new ResizeObserver(redraw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

// --- The panel. Text from files only ever becomes text, never markup.

function element(tag, text, attributes = {}) {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...[].concat(text ?? []));
  return made;
}

const list = (rows) => element("dl", rows.flatMap(([name, value]) => [element("dt", name), element("dd", String(value))]));

function toggle(name, holder, key, { disabled = false, why = "" } = {}) {
  const box = element("input", null, { type: "checkbox", checked: holder[key] && !disabled, disabled });
  box.addEventListener("change", () => { holder[key] = box.checked; redraw(); });
  return element("label", [element("span", name), box], { title: why });
}

function slider(name, key, min, max) {
  const range = element("input", null, { type: "range", min, max, step: (max - min) / 100 });
  range.value = style[key];
  range.addEventListener("input", () => { style[key] = Number(range.value); redraw(); });
  return element("label", [element("span", name), range]);
}

function upButtons() {
  const buttons = ["x", "y", "z"].map((name, axis) => {
    const button = element("button", name, { type: "button" });
    button.addEventListener("click", () => { view.up = axis; show(); reset(); });
    return button;
  });
  const show = () => buttons.forEach((button, axis) => button.setAttribute("aria-pressed", axis === view.up));
  show();
  const back = element("button", "Reset", { type: "button" });
  back.addEventListener("click", reset);
  return element("div", [element("span", "Up"), ...buttons, back], { className: "buttons" });
}

const baseName = (path) => path.split(/[/\\]/).pop() || path;
const count = (value) => value.toLocaleString("en").replaceAll(",", " ");

function cloudFacts(cloud, of) {
  const { counts, normalization, points } = cloud;
  const box = points.high.map((v, axis) => number(v - points.low[axis], 4)).join(" × ");
  const rows = [["points", count(cloud.num_points)]];
  if (cloud.num_encoded < cloud.num_points) rows.push(["encoded", count(cloud.num_encoded)]);
  if (points.count < cloud.num_points) rows.push(["shown", count(points.count)]);
  rows.push(["extent", box], ["center", normalization.center.map((v) => number(v)).join(", ")],
    ["scale", number(normalization.scale)], ["queries", count(counts.queries)], ["occupied", count(counts.occupied)],
    ["above threshold", count(counts.above_threshold)], ["keypoints", count(counts.keypoints)]);
  if (cloud.surface) rows.push(["triangles", count(cloud.surface.count)]);
  const name = data.clouds.length > 1 ? `${"AB"[of]}: ${baseName(cloud.name)}` : baseName(cloud.name);
  return [element("h2", name, { title: cloud.name }), list(rows)];
}

function pairFacts({ links: found, epsilon, registration, t_first_second }) {
  const share = numOfFirst ? `${Math.round(100 * found.length / numOfFirst)} %` : "–";
  const what = `${found.length} of ${numOfFirst} keypoints of A repeat in B within ${number(epsilon, 3)}`;
  const rows = t_first_second.slice(0, 3).map((row, i) => [i ? "" : "B to A", row.map((v) => v.toFixed(3)).join("  ")]);
  if (registration) {
    const { num_inliers, num_correspondences } = registration;
    rows.push(["registration", `${num_inliers} of ${num_correspondences} matches agree`]);
  } else {
    rows.push(["transform", "given"]);
  }
  return [element("p", [share, element("small", what)], { className: "share" }), list(rows)];
}

function panel() {
  const names = data.clouds.map(({ name }) => baseName(name));
  byId("title").append(element("small", `Keypoints · snake-rs ${data.version}`), names.join(" + "));
  const palette = bytes(data.colors);
  const stops = [...Array(33).keys()].map((i) => Math.min(255, i * 8)).map((i) => `rgb(${palette.slice(i * 3, i * 3 + 3)})`);
  document.querySelector("#legend .bar").style.background = `linear-gradient(90deg, ${stops})`;
  const key = (name, background) => {
    const mark = element("i");
    mark.style.background = `var(${background})`;
    return element("div", [mark, name], { className: "key" });
  };
  const two = data.clouds.length > 1;
  byId("legend").append(key(two ? "keypoint of one cloud only" : "keypoint", "--accent"));
  if (two) byId("legend").append(key("keypoint that repeats", "--repeated"));
  const hasSurface = data.clouds.some(({ surface }) => surface);
  const why = hasSurface ? "" : "The field has no surface.";
  byId("controls").append(toggle("Points", shown, "points"), toggle("Keypoints", shown, "keypoints"),
    toggle("Surface", shown, "surface", { disabled: !hasSurface, why }));
  if (two) {
    byId("controls").append(toggle("Links", shown, "links"),
      ...names.map((name, of) => toggle(`${"AB"[of]}: ${name}`, shown.clouds, of)), slider("Apart", "apart", 0, 1.5));
  }
  byId("controls").append(slider("Point size", "point", 1, 10), upButtons());
  if (data.pair) byId("facts").append(...pairFacts(data.pair));
  data.clouds.forEach((cloud, of) => byId("facts").append(...cloudFacts(cloud, of)));
  const options = Object.entries({ model: data.model, ...data.options.encode, ...data.options.detect });
  const values = options.map(([name, value]) => [name.replaceAll("_", " "),
    typeof value === "number" ? number(value) : value === null ? "all" : String(value)]);
  byId("facts").append(element("details", [element("summary", "Parameters"), list(values)]));
}

function fail(text) {
  byId("message").textContent = text;
  byId("message").hidden = false;
  document.documentElement.dataset.state = "failed";
}

panel();
if (prepare()) {
  listen();
  redraw();
} else {
  fail("This browser has no WebGL 2, which the picture needs. Update it, or switch hardware acceleration on; the figures on this page are complete without it.");
}
