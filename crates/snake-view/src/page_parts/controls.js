// The user's interaction with the scene, and the panel beside it.

// --- Rotating, moving, zooming, hovering.

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

/** A position, to a few thousandths of the cloud's size. */
function position(point, { normalization: { scale } }) {
  const decimals = Math.max(0, Math.min(8, 3 - Math.floor(Math.log10(scale))));
  return point.map((v) => v.toFixed(decimals)).join(", ");
}

const number = (value, digits = 4) => (value === null ? "–" : Number(value.toPrecision(digits)).toString());

function describe(tooltip, { of, rank, isAnnotation, saliency, confidence, occupancy, x, y, z, nearest_index, link }) {
  const name = isAnnotation ? "Annotation" : "Keypoint";
  const head = element("strong", data.clouds.length > 1 ? `${name} ${rank + 1} of ${"AB"[of]}` : `${name} ${rank + 1}`);
  const at = ["position", position([x, y, z], data.clouds[of])];
  const rows = isRegistration || isAnnotation ? [at] : [["score (saliency)", number(saliency)],
    ["confidence", number(confidence)], ["occupancy", number(occupancy)], at,
    ["nearest point", nearest_index]];
  if (link) {
    const partner = of === 0 ? link.second : link.first;
    const what = isRegistration ? "matches" : "repeats";
    rows.push([`${what} ${"AB"[partner.of]}`, `${partner.rank + 1}, at ${number(link.distance, 3)}`]);
  }
  tooltip.replaceChildren(head, list(rows));
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
  // Draw at once: one frame later the old picture would appear stretched.
  new ResizeObserver(() => gl && draw()).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

// --- The panel. Text from files is only inserted as text, never as markup.

function element(tag, text, attributes = {}) {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...[].concat(text ?? []));
  return made;
}

const list = (rows) => element("dl", rows.flatMap(([name, value]) => [element("dt", name), element("dd", String(value))]));

function toggle(name, holder, key, { disabled = false, why = "" } = {}) {
  const box = element("input", null, { type: "checkbox", checked: holder[key] && !disabled, disabled });
  box.addEventListener("change", () => { holder[key] = box.checked; redraw(); });
  return element("label", [element("span", name), box], { title: why || name });
}

/** A slider for a value of `style`; `name` is a label, or a function from the value to the label. */
function slider(name, key, min, max, step = (max - min) / 100) {
  const range = element("input", null, { type: "range", min, max, step });
  range.value = style[key];
  const text = element("span");
  const show = () => { text.textContent = typeof name === "string" ? name : name(style[key]); };
  range.addEventListener("input", () => { style[key] = Number(range.value); show(); redraw(); });
  show();
  return element("label", [text, range]);
}

function upButtons() {
  const buttons = [0, 1, 2].map((axis) => {
    const button = element("button", null, { type: "button" });
    button.title = "Again: flip";
    button.addEventListener("click", () => {
      view.down = view.up === axis && !view.down;
      view.up = axis;
      show();
      reset();
    });
    return button;
  });
  const show = () => buttons.forEach((button, axis) => {
    button.setAttribute("aria-pressed", axis === view.up);
    button.textContent = (axis === view.up && view.down ? "−" : "") + "xyz"[axis];
  });
  show();
  const back = element("button", "Reset", { type: "button" });
  back.addEventListener("click", reset);
  return element("div", [element("span", "Up"), ...buttons, back], { className: "buttons" });
}

const baseName = (path) => path.split(/[/\\]/).pop() || path;
const count = (value) => value.toLocaleString("en").replaceAll(",", " ");

/** The figures of a cloud, by name. */
function figures(cloud) {
  const { counts, points } = cloud;
  const box = points.high.map((v, axis) => number(v - points.low[axis], 3)).join(" × ");
  const rows = [["points", count(cloud.num_points)]];
  if (cloud.num_skipped) rows.push(["skipped", count(cloud.num_skipped)]);
  if (cloud.num_encoded < cloud.num_points) rows.push(["encoded", count(cloud.num_encoded)]);
  if (points.count < cloud.num_points) rows.push(["shown", count(points.count)]);
  const middle = points.low.map((v, axis) => (v + points.high[axis]) / 2);
  rows.push(["extent", box], ["middle", position(middle, cloud)]);
  if (cloud.voxel_size) rows.push(["voxel", number(cloud.voxel_size)]);
  if (counts) rows.push(["queries", count(counts.queries)], ["occupied", count(counts.occupied)],
    ["above threshold", count(counts.above_threshold)], ["keypoints", count(counts.keypoints)]);
  if (cloud.surface) rows.push(["triangles", count(cloud.surface.count)]);
  return rows;
}

/** The figures of the clouds, those of two side by side, and their hints. */
function cloudFacts(clouds) {
  const isPair = clouds.length > 1;
  const hints = clouds.flatMap(({ hint }, of) => hint ? [element("p", isPair ? `${"AB"[of]}: ${hint}` : hint)] : []);
  if (!isPair) return [...hints, list(figures(clouds[0]))];
  const columns = clouds.map((cloud) => new Map(figures(cloud)));
  const names = [...new Set(columns.flatMap((column) => [...column.keys()]))];
  const rows = names.map((name) => element("tr", [element("th", name), ...columns.map((c) => element("td", c.get(name) ?? "0"))]));
  const head = element("tr", [element("th"), ...clouds.map(({ name }, of) => element("td", "AB"[of], { title: name }))]);
  return [...hints, element("table", [head, ...rows])];
}

const matrixText = (rows) => rows.map((row) => row.map((v) => v.toFixed(4).padStart(9)).join("")).join("\n");

/** The verdict of a registration: the first cloud is its target. */
function registrationFacts({ links: found, verdict, t_first_second }) {
  const { confidence, is_reliable, is_ambiguous, num_matches, inlier_distance, fitness, notes } = verdict;
  const name = is_reliable ? "reliable" : is_ambiguous ? "ambiguous" : "not reliable";
  const what = `confidence ${confidence.toFixed(2)}; ${found.length} of ${num_matches} matches agree after ICP; ` +
    `${Math.round(100 * fitness)} % of the voxels of B within ${number(inlier_distance, 3)} of A`;
  return [element("p", [name, element("small", what)], { className: "share" }),
    ...notes.map((note) => element("p", note)),
    element("details", [element("summary", "B (source) to A (target)"), element("pre", matrixText(t_first_second))])];
}

function pairFacts({ links: found, epsilon, registration, t_first_second }) {
  const share = numOfFirst ? `${Math.round(100 * found.length / numOfFirst)} %` : "–";
  const what = `${found.length} of ${numOfFirst} keypoints of A repeat in B within ${number(epsilon, 3)}`;
  const from = registration
    ? `registration: ${registration[0]} of ${registration[1]} matches agree` : "as given";
  return [element("p", [share, element("small", what)], { className: "share" }),
    element("details", [element("summary", `B to A, ${from}`), element("pre", matrixText(t_first_second))])];
}

function panel() {
  const names = data.clouds.map(({ name }) => baseName(name));
  const title = element("span", names.join(" + "), { title: names.join("\n") });
  const what = isRegistration ? "Registration" : `Keypoints · ${baseName(data.model)}`;
  byId("title").append(element("small", `${what} · snake-rs ${data.version}`), title);
  const palette = bytes(data.colors);
  const rgb = (index) => `rgb(${palette.slice(index * 3, index * 3 + 3)})`;
  const stops = [...Array(33).keys()].map((i) => Math.min(255, i * 8)).map(rgb);
  document.querySelector("#legend .bar").style.background = `linear-gradient(90deg, ${stops})`;
  const key = (name, background) => {
    const mark = element("i");
    mark.style.background = background;
    return element("div", [mark, name], { className: "key" });
  };
  const two = data.clouds.length > 1;
  if (isRegistration) {
    byId("legend").replaceChildren(key("A: target", rgb(0)), key("B: source", rgb(255)), key("match", "var(--accent)"));
  } else {
    const sized = keypoints.some(({ confidence }) => confidence !== null) ? ", larger with its confidence" : "";
    byId("legend").append(key(two ? "keypoint that repeats" : `keypoint${sized}`, "var(--accent)"));
    if (annotations.length) byId("legend").append(key("annotation", "var(--lone)"));
    if (two) byId("legend").append(key("keypoint of one cloud only", "var(--lone)"));
  }
  const hasSurface = data.clouds.some(({ surface }) => surface);
  const why = hasSurface ? "" : "The field has no surface.";
  byId("controls").append(toggle("Points", shown, "points"), toggle("Keypoints", shown, "keypoints"),
    toggle("Surface", shown, "surface", { disabled: !hasSurface, why }));
  if (annotations.length) byId("controls").append(toggle("Annotations", shown, "annotations"));
  if (two) {
    byId("controls").append(toggle("Links", shown, "links"),
      ...names.map((name, of) => toggle(`${"AB"[of]}: ${name}`, shown.clouds, of)), slider("Apart", "apart", 0, 1.5));
  }
  const most = Math.max(...data.clouds.map((cloud) => cloud.keypoints.length));
  if (most > 1) byId("controls").append(slider((best) => `Best ${best} of ${most}`, "best", 1, most, 1));
  byId("controls").append(slider("Point size", "point", 1, 10), upButtons());
  if (data.pair) byId("facts").append(...(isRegistration ? registrationFacts : pairFacts)(data.pair));
  byId("facts").append(...cloudFacts(data.clouds));
  const { encode, detect, ...flat } = data.options;
  const options = Object.entries(isRegistration ? flat : { model: data.model, ...encode, ...detect });
  const values = options.map(([name, value]) => [name.replaceAll("_", " "),
    typeof value === "number" ? number(value) : value === null ? (isRegistration ? "–" : "all") : String(value)]);
  byId("facts").append(element("details", [element("summary", "Parameters"), list(values)]));
}

function fail(text) {
  byId("message").textContent = text;
  byId("message").hidden = false;
  document.documentElement.dataset.state = "failed";
}

panel();
try {
  if (prepare()) {
    listen();
    reset();
    // A busy browser without a window may never ask for a frame.
    draw();
  } else {
    fail("This browser has no WebGL 2, which the picture needs. Update it, or switch hardware acceleration on; the " +
      "figures on this page are complete without it.");
  }
} catch (error) {
  fail(`The picture could not be drawn: ${error.message}`);
}
