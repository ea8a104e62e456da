"use strict";
// The live page of a mission: draws what the server tells, asks again when something changes.
const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.hash.slice(1)).get("token") || "";
const asked = (path) => fetch(path, { headers: token ? { Authorization: `Bearer ${token}` } : {} });
const linked = (path) => (token ? `${path}?token=${encodeURIComponent(token)}` : path);
const maps = new Map();
let place = null, story = null, live = null, following = true, playing = null;
let heard = { xy: [], level: [], uav: [] }, newest = 0, shown = null, scale = null, points = [];
// how far a roof is drawn aside and up, in metres of the map for a metre of height
const LEAN = [-0.12, 0.22];
const MAPS_KEPT = 40;

async function json(path) {
  const answer = await asked(path);
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.error || answer.statusText);
  return told;
}

function mapOf(count) {
  if (!maps.has(count)) {
    maps.set(count, asked(`/api/maps/${count}`).then(async (answer) => {
      if (!answer.ok) throw new Error((await answer.json()).error);
      const n = place.rows * place.cols;
      const values = new Float32Array(await answer.arrayBuffer());
      const mean = values.subarray(0, n), std = values.subarray(n);
      return { count, mean, std, error: Number(answer.headers.get("X-Expected-Error")) };
    }));
    maps.get(count).catch(() => maps.delete(count));
    for (const old of maps.keys()) {
      if (maps.size <= MAPS_KEPT) break;
      if (old !== 0) maps.delete(old);
    }
  }
  return maps.get(count);
}

const view = () => document.querySelector("input[name=view]:checked").value;
const moment = () => story.moments[Number($("moment").value)];
const countNow = () => (following ? newest : moment().count);

function range(values) {
  const known = Float32Array.from(values.filter(Number.isFinite)).sort();
  if (!known.length) return [0, 1];
  return [known[Math.floor(known.length * 0.01)], known[Math.floor((known.length - 1) * 0.99)]];
}

// one scale for the whole mission, that of its newest map, so that colours can be compared; in
// steps of 5 dB, so that it does not change with every reading
async function limits() {
  const [first, last] = await Promise.all([mapOf(0), mapOf(newest)]);
  const [low, high] = range(last.mean);
  scale = {
    mean: [5 * Math.floor(low / 5), 5 * Math.ceil(high / 5)],
    std: [0, Math.max(range(first.std)[1] * 0.6, 1)],
  };
}

function coloured(values, [low, high], name) {
  const { rows, cols } = place, table = place.colours[name];
  const image = new ImageData(cols, rows), data = image.data;
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < cols; c++) {
      const v = values[r * cols + c], at = ((rows - 1 - r) * cols + c) * 4;
      if (!Number.isFinite(v)) continue;
      const k = 3 * Math.max(0, Math.min(255, Math.round((255 * (v - low)) / (high - low || 1))));
      data[at] = table[k]; data[at + 1] = table[k + 1]; data[at + 2] = table[k + 2];
      data[at + 3] = 255;
    }
  }
  const canvas = document.createElement("canvas");
  canvas.width = cols; canvas.height = rows;
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

// layers that change seldom are drawn once and kept, by a word that says what they show
const layers = new Map();
function layer(name, word, like, paint) {
  const kept = layers.get(name);
  if (kept && kept.word === word) return kept;
  const canvas = document.createElement("canvas");
  canvas.width = like.width; canvas.height = like.height;
  const pen = canvas.getContext("2d");
  pen.setTransform(like.getContext("2d").getTransform());
  const made = { word, canvas, pen, done: 0 };
  layers.set(name, made);
  if (paint) paint(pen);
  return made;
}

function put(pen, { canvas }, wide, high) {
  pen.drawImage(canvas, 0, 0, wide, high);
}

function fitted(canvas, ratio) {
  const wide = canvas.clientWidth, dense = Math.min(2, window.devicePixelRatio || 1);
  const high = ratio ? wide * ratio : canvas.clientHeight;
  canvas.width = Math.round(wide * dense); canvas.height = Math.round(high * dense);
  if (ratio) canvas.style.height = `${high}px`;
  const pen = canvas.getContext("2d");
  pen.scale(dense, dense);
  return [pen, wide, high];
}

function ring(pen, points, to, close = true) {
  pen.beginPath();
  points.forEach((p, k) => (k ? pen.lineTo(...to(p)) : pen.moveTo(...to(p))));
  if (close) pen.closePath();
}

function building(pen, { ring: base, height_m: height }, to, colours) {
  const roof = base.map(([x, y]) => [x + LEAN[0] * height, y + LEAN[1] * height]);
  pen.fillStyle = colours.wall;
  ring(pen, base, to);
  pen.fill();
  base.forEach((p, k) => {
    const q = (k + 1) % base.length;
    ring(pen, [p, base[q], roof[q], roof[k]], to);
    pen.fill();
  });
  ring(pen, roof, to);
  pen.fillStyle = colours.roof; pen.fill();
  pen.strokeStyle = colours.wall; pen.lineWidth = 0.6; pen.stroke();
}

function at(flight, seconds) {
  const { route, moment_s: when } = flight;
  if (seconds <= when[0]) return route[0];
  for (let k = 1; k < when.length; k++) {
    if (seconds <= when[k]) {
      const share = (seconds - when[k - 1]) / (when[k] - when[k - 1] || 1);
      return route[k].map((v, axis) => route[k - 1][axis] + share * (v - route[k - 1][axis]));
    }
  }
  return route[route.length - 1];
}

// draws what is known now; what has to be fetched first is drawn when it is there
let wanted = null;
function draw() {
  if (!story) return;
  const count = countNow();
  if (!shown || shown.count !== count) {
    wanted = count;
    Promise.all([mapOf(count), limits()]).then(([found]) => {
      if (wanted !== count && !(following && found.count > (shown ? shown.count : -1))) return;
      shown = found; paint();
    }).catch((error) => { $("readout").textContent = error.message; });
  }
  if (shown) paint();
}

let painting = false;
function paint() {
  if (painting) return;
  painting = true;
  requestAnimationFrame(() => { painting = false; painted(); });
}

function painted() {
  const now = moment(), map = $("map"), count = countNow();
  const style = getComputedStyle(document.documentElement);
  const colours = { roof: style.getPropertyValue("--roof"), wall: style.getPropertyValue("--wall") };
  const [pen, wide, high] = fitted(map, place.height_m / place.width_m);
  const size = `${map.width} ${map.height} ${colours.roof}`;
  const to = ([x, y]) => [(x / place.width_m) * wide, high - (y / place.height_m) * high];
  const name = view();
  if (name !== "none") {
    const colour = name === "mean" ? "viridis" : "magma", word = `${shown.count} ${scale[name]}`;
    const kept = layers.get(name);
    if (!kept || kept.word !== word) {
      layers.set(name, { word, canvas: coloured(shown[name], scale[name], colour) });
    }
    pen.imageSmoothingEnabled = false;
    put(pen, layers.get(name), wide, high);
    showScale(scale[name], colour, name === "mean" ? story.unit : "dB");
  }
  map.dataset.count = shown.count;
  map.dataset.view = name;
  if ($("show-buildings").checked) {
    put(pen, layer("buildings", size, map, (on) => {
      const order = [...place.buildings].sort((a, b) => b.ring[0][1] - a.ring[0][1]);
      order.forEach((one) => building(on, one, to, colours));
    }), wide, high);
  }
  put(pen, layer("edges", size, map, (on) => {
    on.lineWidth = 1.5;
    on.setLineDash([6, 4]); on.strokeStyle = style.getPropertyValue("--ink");
    place.area.forEach((one) => { ring(on, one, to); on.stroke(); });
    on.setLineDash([]); on.strokeStyle = "#d0352b"; on.fillStyle = "rgb(208 53 43 / 18%)";
    place.zones.forEach((one) => { ring(on, one, to); on.fill(); on.stroke(); });
  }), wide, high);
  const readings = following ? heard.level.length : count;
  if ($("show-readings").checked) dots(pen, to, readings, size, wide, high);
  if ($("show-plan").checked) plan(pen, to, now, readings);
  vehicles(pen, to);
  told(now);
  curve();
  document.body.dataset.drawn = readings;
  document.body.dataset.ready = "yes";
}

function dots(pen, to, count, size, wide, high) {
  const [low, up] = scale.mean, table = place.colours.viridis;
  const kept = layers.get("dots"), word = `${size} ${low} ${up}`;
  if (kept && kept.done > count) layers.delete("dots"); // the slider went back
  const dots = layer("dots", word, $("map"));
  const r = Math.max(1.5, (wide / place.cols) * 0.28), on = dots.pen;
  on.strokeStyle = "rgb(255 255 255 / 70%)"; on.lineWidth = 0.6;
  for (let k = dots.done; k < count; k++) {
    const share = (heard.level[k] - low) / (up - low || 1);
    const c = 3 * Math.max(0, Math.min(255, Math.round(255 * share)));
    const [x, y] = to(heard.xy[k]);
    on.beginPath(); on.arc(x, y, r, 0, 7);
    on.fillStyle = `rgb(${table[c]} ${table[c + 1]} ${table[c + 2]})`; on.fill(); on.stroke();
  }
  dots.done = count;
  put(pen, dots, wide, high);
}

// the newest way of each UAV at a moment
function waysAt(now) {
  const found = new Map();
  let sortie = null;
  for (const way of story.ways) {
    if (way.at > now.at && !(following && now === story.moments[story.moments.length - 1])) break;
    if (sortie !== way.sortie) { found.clear(); sortie = way.sortie; }
    found.set(way.uav, way);
  }
  return [...found.values()];
}

function plan(pen, to, now, readings) {
  const planned = now.kind === "planned";
  for (const way of waysAt(now)) {
    pen.globalAlpha = planned || live ? 1 : 0.35;
    for (const [look, width] of [["#10181f", 3.4], [place.uav_colours[way.uav], 1.8]]) {
      pen.strokeStyle = look; pen.lineWidth = width;
      pen.setLineDash([]);
      ring(pen, way.route.slice(0, way.measuring), to, false); pen.stroke();
      pen.setLineDash([2, 4]);
      ring(pen, way.route.slice(way.measuring - 1), to, false); pen.stroke();
    }
    pen.setLineDash([]); pen.globalAlpha = 1;
    if (planned && !live) marker(pen, to(at(way, now.share_s)), way.uav);
  }
  if (!planned && !(live && following)) {
    lastPlaces(readings).forEach((xy, uav) => marker(pen, to(xy), uav));
  }
}

// where each UAV read last, before so many readings
function lastPlaces(count) {
  const found = new Map();
  for (let k = count - 1; k >= Math.max(0, count - 3000); k--) {
    if (heard.uav[k] >= 0 && !found.has(heard.uav[k])) found.set(heard.uav[k], heard.xy[k]);
    if (found.size === place.pads.length) break;
  }
  return found;
}

function marker(pen, [x, y], uav) {
  pen.beginPath(); pen.arc(x, y, 9, 0, 7);
  pen.fillStyle = place.uav_colours[uav % place.uav_colours.length]; pen.fill();
  pen.strokeStyle = "#10181f"; pen.lineWidth = 1.6; pen.stroke();
  pen.fillStyle = "#10181f"; pen.font = "600 10px system-ui";
  pen.textAlign = "center"; pen.textBaseline = "middle"; pen.fillText(String(uav), x, y + 0.5);
}

function vehicles(pen, to) {
  $("live").hidden = !live;
  if (!live) return;
  live.vehicles.forEach((one) => one.xy && marker(pen, to(one.xy), one.uav));
  $("live").textContent = `live: ${live.vehicles.map((v) => `UAV ${v.uav} ${v.state}`).join(", ")}`;
}

function showScale([low, high], name, unit) {
  const pen = $("bar").getContext("2d"), table = place.colours[name];
  $("bar").width = 256;
  for (let k = 0; k < 256; k++) {
    pen.fillStyle = `rgb(${table[3 * k]} ${table[3 * k + 1]} ${table[3 * k + 2]})`;
    pen.fillRect(k, 0, 1, 10);
  }
  $("low").textContent = low.toFixed(0);
  $("high").textContent = `${high.toFixed(0)} ${unit}`;
}

function told(now) {
  const what = following && live ? "now" : now.text;
  const error = `expected error ${shown.error.toFixed(1)} dB`;
  $("moment-text").textContent = `${what}; ${shown.count} readings on the map, ${error}`;
}

// the curve's errors come bit by bit; each newest map brings its own
let curveAsked = false;
async function askCurve() {
  if (curveAsked) return;
  curveAsked = true;
  try {
    for (let whole = false; !whole;) {
      const found = await json("/api/curve");
      points = found.points; whole = found.whole;
      if (shown) paint();
    }
  } finally { curveAsked = false; }
}

function curve() {
  const all = new Map([...points, [shown.count, shown.error]]);
  const line = [...all].sort((a, b) => a[0] - b[0]);
  const [pen, wide, high] = fitted($("curve"));
  const style = getComputedStyle(document.documentElement);
  const top = Math.max(...line.map((one) => one[1]), place.stop_db || 0) * 1.1;
  const left = 28, low = high - 18, most = Math.max(1, line[line.length - 1][0]);
  const x = (k) => left + (k / most) * (wide - left - 14);
  const y = (v) => low - (v / top) * (low - 6);
  pen.font = "11px system-ui"; pen.fillStyle = style.getPropertyValue("--soft");
  pen.textAlign = "right"; pen.textBaseline = "middle";
  for (const share of [0, 0.5, 1]) {
    const v = share * (top / 1.1);
    pen.fillText(v.toFixed(0), left - 5, y(v));
    pen.strokeStyle = style.getPropertyValue("--faint");
    pen.beginPath(); pen.moveTo(left, y(v)); pen.lineTo(wide, y(v)); pen.stroke();
  }
  if (place.stop_db) {
    pen.strokeStyle = style.getPropertyValue("--bad"); pen.setLineDash([4, 3]);
    pen.beginPath(); pen.moveTo(left, y(place.stop_db)); pen.lineTo(wide, y(place.stop_db));
    pen.stroke(); pen.setLineDash([]);
  }
  pen.strokeStyle = style.getPropertyValue("--accent"); pen.lineWidth = 2;
  ring(pen, line.map(([k, v]) => [x(k), y(v)]), (p) => p, false); pen.stroke();
  pen.beginPath(); pen.arc(x(shown.count), y(shown.error), 4, 0, 7);
  pen.fillStyle = style.getPropertyValue("--accent"); pen.fill();
  pen.fillStyle = style.getPropertyValue("--soft");
  pen.textAlign = "center"; pen.fillText("readings", (left + wide) / 2, high - 6);
  pen.textAlign = "right"; pen.fillText(String(most), wide - 2, high - 6);
  $("curve").dataset.points = line.length;
}

function listFiles() {
  if (!story.sorties.length) return;
  $("files").replaceChildren(...[...story.sorties].reverse().map((sortie) => {
    const part = document.createElement("div"), head = document.createElement("p");
    head.textContent = `Sortie ${sortie.number}`;
    const list = document.createElement("ul");
    sortie.files.forEach((name) => {
      const item = document.createElement("li"), link = document.createElement("a");
      link.href = linked(`/sorties/${sortie.number}/${encodeURIComponent(name)}`);
      link.textContent = name; link.download = name;
      item.append(link); list.append(item);
    });
    part.append(head, list);
    return part;
  }));
}

async function readStory() {
  story = await json("/api/story");
  const slider = $("moment"), last = story.moments.length - 1;
  slider.max = last;
  if (following) slider.value = last;
  listFiles();
  askCurve();
}

async function readReadings() {
  const found = await json(`/api/readings?after=${heard.level.length}`);
  for (const key of ["xy", "level", "uav"]) for (const one of found[key]) heard[key].push(one);
}

function head() {
  document.body.dataset.readings = heard.level.length;
  const n = story.sorties.length;
  $("lede").textContent =
    `${place.altitude}, ${place.middle.map((v) => v.toFixed(5)).join(", ")}: ` +
    `${n} ${n === 1 ? "sortie" : "sorties"} planned, ${heard.level.length} readings`;
}

// what the server tells of is read once at a time; meanwhile only the newest waits
let reading = false, next = null;
async function changed(now) {
  next = now;
  if (reading) return;
  reading = true;
  try {
    while (next) {
      const told = next;
      next = null;
      live = told.live;
      if (!story || told.last !== story.last) await readStory();
      if (told.count > heard.level.length) await readReadings();
      newest = told.map;
      head();
      draw();
    }
  } finally { reading = false; }
}

async function send(files) {
  const said = $("told");
  for (const file of files) {
    said.className = ""; said.textContent = `${file.name}: reading …`;
    const answer = await fetch(`/api/readings?name=${encodeURIComponent(file.name)}`, {
      method: "PUT", body: file, headers: { Authorization: `Bearer ${token}` },
    });
    const result = await answer.json();
    said.className = answer.ok ? "" : "bad";
    said.textContent = answer.ok ? result.told : result.error;
    if (!answer.ok) return;
  }
}

function readout(event) {
  if (!place || !story) return;
  const box = $("map").getBoundingClientRect();
  const x = ((event.clientX - box.left) / box.width) * place.width_m;
  const y = (1 - (event.clientY - box.top) / box.height) * place.height_m;
  const col = Math.floor(x / place.spacing_m), row = Math.floor(y / place.spacing_m);
  if (row < 0 || col < 0 || row >= place.rows || col >= place.cols) return;
  if (!shown) return;
  const k = row * place.cols + col, mean = shown.mean[k], std = shown.std[k];
  const value = Number.isFinite(mean)
    ? `${mean.toFixed(1)} ± ${std.toFixed(1)} ${story.unit}` : "not on the map";
  $("readout").textContent = `${x.toFixed(0)} m east, ${y.toFixed(0)} m north: ${value}`;
}

function play() {
  if (playing) { clearInterval(playing); playing = null; $("play").textContent = "▶"; return; }
  const slider = $("moment");
  if (slider.value === slider.max) slider.value = 0;
  $("play").textContent = "❚❚";
  playing = setInterval(() => {
    if (slider.value === slider.max) { play(); return; }
    slider.value = Number(slider.value) + 1; slider.dispatchEvent(new Event("input"));
  }, 140);
}

async function begin() {
  place = await json("/api/place");
  document.title = `${place.name}: mission`;
  $("name").textContent = `Mission over ${place.name}`;
  const changes = new EventSource(linked("/api/changes"));
  changes.onmessage = ({ data }) => changed(JSON.parse(data)).catch((error) => {
    $("lede").textContent = error.message;
  });
}

$("moment").addEventListener("input", () => {
  following = $("moment").value === $("moment").max;
  draw();
});
$("play").addEventListener("click", play);
for (const input of document.querySelectorAll(".above input")) input.addEventListener("change", draw);
$("map").addEventListener("pointermove", readout);
$("pick").addEventListener("change", () => send($("pick").files));
window.addEventListener("resize", draw);
for (const name of ["dragenter", "dragover"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault(); $("drop").classList.add("over");
  });
}
document.addEventListener("dragleave", () => $("drop").classList.remove("over"));
document.addEventListener("drop", (event) => {
  event.preventDefault(); $("drop").classList.remove("over");
  send(event.dataTransfer.files);
});
begin().catch((error) => { $("lede").textContent = error.message; });
