"use strict";
// The scene: clouds, surfaces, keypoints and links, drawn with WebGL. The data comes from page.rs. Lengths are in the
// clouds' units, and the scene is in the first cloud's frame.

const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const canvas = byId("scene");
/** A page of a registration shows the source on the target; its keypoints are the ends of matches. */
const isRegistration = data.kind === "registration";

// --- Vectors and matrices; a matrix is 16 numbers, row by row, and acts on columns.

const add = (a, b, scale = 1) => a.map((v, i) => v + b[i] * scale);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
const multiply = (a, b) => a.map((_, i) => [0, 1, 2, 3].reduce((s, k) => s + a[i - (i % 4) + k] * b[k * 4 + (i % 4)], 0));
const apply = (m, p) => [0, 4, 8].map((row) => m[row] * p[0] + m[row + 1] * p[1] + m[row + 2] * p[2] + m[row + 3]);
const scaled = (s, t) => [s[0], 0, 0, t[0], 0, s[1], 0, t[1], 0, 0, s[2], t[2], 0, 0, 0, 1];

// --- The scene: both clouds in the first one's frame, translated and scaled into the unit sphere.

const poses = data.clouds.map((_, i) => (i === 0 ? scaled([1, 1, 1], [0, 0, 0]) : data.pair.t_first_second.flat()));
const corners = data.clouds.flatMap(({ points: { low, high } }, i) =>
  [...Array(8).keys()].map((c) => apply(poses[i], low.map((v, axis) => ((c >> axis) & 1 ? high[axis] : v)))));
const low = [0, 1, 2].map((axis) => Math.min(...corners.map((p) => p[axis])));
const high = [0, 1, 2].map((axis) => Math.max(...corners.map((p) => p[axis])));
const extent = high.map((v, axis) => v - low[axis]);
const radius = Math.hypot(...extent) / 2 || 1;
const toScene = scaled([1, 1, 1].map((v) => v / radius), low.map((v, axis) => -(v + high[axis]) / 2 / radius));
const placed = poses.map((pose) => multiply(toScene, pose));

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

/** Takes 16-bit positions, as shares of 65535, to the scene. */
const unpacked = (of, { low, high }) => multiply(placed[of], scaled(high.map((v, axis) => v - low[axis]), low));

// A sample of the clouds' points, enough to frame the first view.
const some = data.clouds.flatMap(({ points }, of) => {
  const packed = new DataView(bytes(points.positions).buffer);
  const step = Math.ceil(points.count / 1000);
  return [...Array(Math.ceil(points.count / step)).keys()].map((i) =>
    apply(unpacked(of, points), [0, 2, 4].map((offset) => packed.getUint16(i * step * 6 + offset, true) / 65535)));
});

const keypoints = data.clouds.flatMap((cloud, of) => cloud.keypoints.map((keypoint, rank) => {
  const at = apply(placed[of], [keypoint.x, keypoint.y, keypoint.z]);
  return { ...keypoint, of, rank, at, link: null };
}));
// Annotations are shown in the colour of lone keypoints, whatever their number.
const annotations = data.clouds.flatMap(({ annotations }, of) => (annotations || []).map(([x, y, z], rank) =>
  ({ x, y, z, of, rank, at: apply(placed[of], [x, y, z]), link: null, isAnnotation: true })));
keypoints.push(...annotations);
const numOfFirst = data.clouds[0].keypoints.length;
const links = (data.pair ? data.pair.links : []).map(([first, second, distance]) => {
  const link = { first: keypoints[first], second: keypoints[numOfFirst + second], distance };
  for (const end of [link.first, link.second]) {
    if (!end.link || distance < end.link.distance) end.link = link;
  }
  return link;
});

/** A guess at the axis that points up, and whether it points down instead. */
function guessUp() {
  // A camera looks along z from the origin, and its y points down.
  const middle = low.map((v, axis) => (v + high[axis]) / 2);
  const ahead = some.filter((p) => {
    const [x, y, z] = add(middle, p, radius);
    return z > 0.1 * high[2] && Math.max(Math.abs(x), Math.abs(y)) < 1.2 * z;
  });
  if (ahead.length > 0.9 * some.length) return { up: 1, down: true };
  // A cloud that is much flatter along one axis has the ground across that axis.
  const flattest = extent.indexOf(Math.min(...extent));
  const isFlat = extent[flattest] < 0.6 * Math.min(...extent.filter((_, axis) => axis !== flattest));
  return { up: isFlat ? flattest : 2, down: false };
}

const view = { yaw: -0.9, pitch: 0.5, zoom: 1, target: [0, 0, 0], ...guessUp() };
const start = { ...view };
const shown = { clouds: data.clouds.map(() => true), points: true, keypoints: true, annotations: true, surface: false, links: true };
// Below this number gaps between points show the far side of a cloud; its surface then hides it.
const SPARSE = 5000;
const size = Math.min(6, Math.max(1.6, 260 / Math.sqrt(data.clouds[0].points.count)));
// More keypoints than this hide the cloud; the panel has a slider for them.
const style = { point: size, apart: isRegistration ? 0 : 1, best: Math.min(500, Math.max(...data.clouds.map((c) => c.keypoints.length))) };
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
uniform mat4 model, camera, projection; uniform mat3 turn; uniform sampler2D colors; uniform float back;
in vec3 position, normal; in float saliency; out vec3 color, facing, place; out float depth;
void main() {
  vec4 seen = camera * (model * vec4(position, 1.0));
  seen.z -= back;
  gl_Position = projection * seen;
  depth = -seen.z; place = seen.xyz;
  facing = mat3(camera) * (turn * normal);
  color = texture(colors, vec2((saliency * 255.0 + 0.5) / 256.0, 0.5)).rgb;
}`, `${FOG}
uniform float opacity; in vec3 color, facing, place; in float depth; out vec4 result;
void main() {
  vec3 normal = normalize(facing), eye = normalize(-place);
  float lit = abs(dot(normal, eye));
  float sky = 0.5 + 0.5 * normal.y;
  vec3 shaded = color * (0.4 + 0.55 * lit + 0.25 * sky) + 0.1 * pow(lit, 24.0);
  result = vec4(faded(shaded, depth), opacity);
}`],
  discs: [`
uniform mat4 camera, projection; uniform float hovered; uniform vec3 plain, repeated;
in vec4 disc; in float size; out vec3 color;
void main() {
  vec4 seen = camera * vec4(disc.xyz, 1.0);
  seen.z += 0.03;
  gl_Position = projection * seen;
  gl_PointSize = size * (float(gl_VertexID) == hovered ? 1.5 : 1.0);
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

/** Unit vectors of the view: to the right, up, and to the eye. */
function basis() {
  const unit = (axis) => [0, 1, 2].map((i) => (i === axis % 3 ? 1 : 0));
  let [a, b, up] = [unit(view.up + 1), unit(view.up + 2), unit(view.up)];
  if (view.down) [a, b, up] = [b, a, up.map((v) => -v)];
  const level = add(a.map((v) => v * Math.cos(view.yaw)), b, Math.sin(view.yaw));
  const eye = add(level.map((v) => v * Math.cos(view.pitch)), up, Math.sin(view.pitch));
  const right = add(a.map((v) => -v * Math.sin(view.yaw)), b, Math.cos(view.yaw));
  return { right, up: cross(eye, right), eye };
}

const FIELD_OF_VIEW = 0.45;

/** What the first view has to show: points as it sees them (right, up, towards the eye), and the middle of them. */
let frame = null;

function reset() {
  Object.assign(view, start, { up: view.up, down: view.down });
  const axes = Object.values(basis());
  const seen = some.map((p) => axes.map((axis) => dot(axis, p)));
  const middle = [0, 1, 2].map((i) => {
    const along = seen.map((p) => p[i]);
    return (Math.min(...along) + Math.max(...along)) / 2;
  });
  view.target = axes.reduce((sum, axis, i) => add(sum, axis, middle[i]), [0, 0, 0]);
  frame = { seen: seen.map((p) => add(p, middle, -1)) };
  frame.width = Math.max(0.4, ...frame.seen.map(([x]) => Math.abs(x)));
  redraw();
}

function camera() {
  const { right, up, eye } = basis();
  const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
  const tangent = Math.tan(FIELD_OF_VIEW / 2);
  const needed = ([x, y, z]) => z + 1.2 * Math.max((Math.abs(x) + gap()) / aspect, Math.abs(y)) / tangent;
  const distance = Math.max(...frame.seen.map(needed)) * view.zoom;
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
const gap = () => (data.clouds.length > 1 ? 1.08 * style.apart * frame.width : 0);
const aside = (of, { right }) => right.map((v) => v * gap() * (of === 0 ? -1 : 1));
const moved = (shift) => scaled([1, 1, 1], shift);

/** How large dots are beside those of a cloud that has 480 pixels for itself. */
const dotScale = () => Math.min(1, canvas.clientWidth / (gap() > 0 ? 2 : 1) / 480);

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
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  data.clouds.forEach(({ points, surface }, of) => {
    if (!shown.clouds[of]) return;
    const shift = moved(aside(of, seen));
    if (shown.points && surface && points.count < SPARSE) hideFarSide(of, surface, shift, seen);
    if (shown.points) {
      // A point in the middle of the first view has the size that the user chose, where the window has room for it.
      const pointSize = style.point * dotScale() * ratio * seen.distance / view.zoom;
      use("points", seen, { model: multiply(shift, unpacked(of, points)), point_size: pointSize, background, fog });
      gl.bindVertexArray(buffers.points[of]);
      gl.drawArrays(gl.POINTS, 0, points.count);
    }
    if (shown.surface && surface) {
      const turn = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((i) => poses[of][i]);
      const opacity = shown.points ? 0.6 : 1;
      use("surface", seen, { model: multiply(shift, unpacked(of, surface.vertices)), turn, background, fog, opacity });
      gl.bindVertexArray(buffers.surface[of]);
      // Depth first, then colour: only the nearest layer of the surface is blended over the points.
      for (const visible of [false, true]) {
        gl.colorMask(visible, visible, visible, visible);
        gl.depthFunc(visible ? gl.EQUAL : gl.LESS);
        gl.drawElements(gl.TRIANGLES, surface.count * 3, gl.UNSIGNED_INT, 0);
      }
      gl.depthFunc(gl.LESS);
    }
  });
  drawKeypoints(seen, ratio, [width, height]);
  drawAxes(seen);
  document.documentElement.dataset.state = "drawn";
}

/** Draws the depth of a surface alone, a little behind the points that it wraps. */
function hideFarSide(of, surface, shift, seen) {
  const uncoloured = { turn: [1, 0, 0, 0, 1, 0, 0, 0, 1], background: [0, 0, 0], fog: [0, 0], opacity: 1 };
  use("surface", seen, { model: multiply(shift, unpacked(of, surface.vertices)), back: 0.12, ...uncoloured });
  gl.bindVertexArray(buffers.surface[of]);
  gl.colorMask(false, false, false, false);
  gl.drawElements(gl.TRIANGLES, surface.count * 3, gl.UNSIGNED_INT, 0);
  gl.colorMask(true, true, true, true);
}

const isShown = ({ of, rank, isAnnotation }) =>
  isAnnotation ? shown.annotations : shown.keypoints && shown.clouds[of] && rank < style.best;

function drawKeypoints(seen, ratio, viewport) {
  const [plain, repeated] = [color(data.pair || annotations.length ? "--lone" : "--accent"), color("--accent")];
  const place = (keypoint) => add(keypoint.at, aside(keypoint.of, seen));
  gl.disable(gl.DEPTH_TEST);
  const both = shown.links ? links.filter(({ first, second }) => isShown(first) && isShown(second)) : [];
  const faint = Math.max(0.08, Math.min(hovered ? 0.2 : 0.6, 40 / both.length));
  const about = (link) => hovered && (hovered === link.first || hovered === link.second);
  for (const [some, width, opacity] of [[both, 1.5, faint], [both.filter(about), 3, 1]]) {
    const ends = some.flatMap(({ first, second }) => {
      const [a, b] = [place(first), place(second)];
      return [[0, -1], [0, 1], [1, -1], [1, -1], [0, 1], [1, 1]].flatMap((corner) => [...a, ...b, ...corner]);
    });
    use("lines", seen, { viewport, width: width * ratio, repeated, opacity });
    stream("lines", ends, [["here", 3], ["there", 3], ["corner", 2]], gl.TRIANGLES);
  }
  const discs = keypoints.filter(isShown);
  const usual = Math.min(13, 170 / Math.sqrt(discs.length)) * Math.max(0.6, dotScale());
  // Below 6 pixels nothing is left of a disc but its white ring.
  const diameter = ({ confidence }) => Math.max(6, usual * (0.5 + (confidence ?? 0.5))) * ratio;
  const isAccented = ({ link, isAnnotation }) => link || (annotations.length && !isAnnotation);
  const vertices = discs.flatMap((keypoint) => [...place(keypoint), isAccented(keypoint) ? 1 : 0, diameter(keypoint)]);
  // Keypoints behind points stay faintly visible.
  for (const opacity of [shown.surface ? 0.6 : 0.3, 1]) {
    use("discs", seen, { hovered: discs.indexOf(hovered), plain, repeated, opacity });
    stream("discs", vertices, [["disc", 4], ["size", 1]], gl.POINTS);
    gl.enable(gl.DEPTH_TEST);
  }
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
  });
}
