"use strict";
// The live page of a mission: draws what the server tells, asks again when something changes.
const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.hash.slice(1)).get("token") || "";
const asked = (path) => fetch(path, { headers: token ? { Authorization: `Bearer ${token}` } : {} });
const linked = (path) => (token ? `${path}?token=${encodeURIComponent(token)}` : path);
const maps = new Map();
let place = null, story = null, live = null, following = true, playing = null, drawn = null;
// how far a roof is drawn aside and up, in metres of the map for a metre of height
const LEAN = [-0.12, 0.22];

async function json(path) {
  const answer = await asked(path);
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.error || answer.statusText);
  return told;
}

function mapOf(event) {
  if (!maps.has(event)) {
    maps.set(event, asked(`/api/maps/${event}`).then(async (answer) => {
      if (!answer.ok) throw new Error((await answer.json()).error);
      const n = place.rows * place.cols;
      const values = new Float32Array(await answer.arrayBuffer());
      const mean = values.subarray(0, n), std = values.subarray(n);
      return { mean, std, error: Number(answer.headers.get("X-Expected-Error")) };
    }));
    maps.get(event).catch(() => maps.delete(event));
  }
  return maps.get(event);
}

const view = () => document.querySelector("input[name=view]:checked").value;
const moment = () => story.moments[Number($("moment").value)];

function range(values) {
  const known = Array.from(values).filter(Number.isFinite).sort((a, b) => a - b);
  if (!known.length) return [0, 1];
  return [known[Math.floor(known.length * 0.01)], known[Math.floor((known.length - 1) * 0.99)]];
}

// one scale for the whole mission, that of its newest map, so that colours can be compared
async function limits() {
  const newest = await mapOf(story.moments[story.moments.length - 1].event);
  const first = await mapOf(0);
  return { mean: range(newest.mean), std: [0, Math.max(range(first.std)[1] * 0.6, 1)] };
}

function coloured(values, [low, high], name) {
  const { rows, cols } = place, table = place.colours[name];
  const image = new ImageData(cols, rows);
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < cols; c++) {
      const v = values[r * cols + c], at = ((rows - 1 - r) * cols + c) * 4;
      if (!Number.isFinite(v)) continue;
      const k = Math.max(0, Math.min(255, Math.round((255 * (v - low)) / (high - low || 1))));
      image.data.set([table[3 * k], table[3 * k + 1], table[3 * k + 2], 255], at);
    }
  }
  const canvas = document.createElement("canvas");
  canvas.width = cols; canvas.height = rows;
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
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

async function draw() {
  if (!story) return;
  const now = moment(), mine = {};
  drawn = mine;
  const [found, scale] = await Promise.all([mapOf(now.event), limits()]);
  if (drawn !== mine) return; // a newer drawing began meanwhile
  const style = getComputedStyle(document.documentElement);
  const colours = { roof: style.getPropertyValue("--roof"), wall: style.getPropertyValue("--wall") };
  const [pen, wide, high] = fitted($("map"), place.height_m / place.width_m);
  const to = ([x, y]) => [(x / place.width_m) * wide, high - (y / place.height_m) * high];
  const name = view();
  if (name !== "none") {
    pen.imageSmoothingEnabled = false;
    const colour = name === "mean" ? "viridis" : "magma";
    pen.drawImage(coloured(found[name], scale[name], colour), 0, 0, wide, high);
    showScale(scale[name], colour, name === "mean" ? story.unit : "dB");
  }
  $("map").dataset.event = now.event;
  $("map").dataset.view = name;
  if ($("show-buildings").checked) {
    const order = [...place.buildings].sort((a, b) => b.ring[0][1] - a.ring[0][1]);
    order.forEach((one) => building(pen, one, to, colours));
  }
  pen.lineWidth = 1.5;
  pen.setLineDash([6, 4]); pen.strokeStyle = style.getPropertyValue("--ink");
  place.area.forEach((one) => { ring(pen, one, to); pen.stroke(); });
  pen.setLineDash([]); pen.strokeStyle = "#d0352b"; pen.fillStyle = "rgb(208 53 43 / 18%)";
  place.zones.forEach((one) => { ring(pen, one, to); pen.fill(); pen.stroke(); });
  if ($("show-readings").checked) readings(pen, to, now, scale.mean, wide);
  if ($("show-plan").checked) plan(pen, to, now);
  vehicles(pen, to);
  told(now, found);
  curve();
}

function readings(pen, to, now, [low, high], wide) {
  const { xy, level, event } = story.readings, table = place.colours.viridis;
  const size = Math.max(1.5, (wide / place.cols) * 0.28);
  xy.forEach((p, k) => {
    if (event[k] > now.event) return;
    const c = 3 * Math.max(0, Math.min(255, Math.round((255 * (level[k] - low)) / (high - low || 1))));
    const [x, y] = to(p);
    pen.beginPath(); pen.arc(x, y, size, 0, 7);
    pen.fillStyle = `rgb(${table[c]} ${table[c + 1]} ${table[c + 2]})`; pen.fill();
    pen.strokeStyle = "rgb(255 255 255 / 70%)"; pen.lineWidth = 0.6; pen.stroke();
  });
}

function plan(pen, to, now) {
  const index = Number($("moment").value);
  const shown = story.moments.slice(0, index + 1).filter((one) => one.kind === "planned").pop();
  if (!shown) return;
  const sortie = story.sorties.find((one) => one.number === shown.sortie);
  if (!sortie) return;
  const flying = now.kind === "planned";
  for (const flight of sortie.flights) {
    const colour = place.uav_colours[flight.uav];
    pen.globalAlpha = flying ? 1 : 0.35;
    for (const [look, width] of [["#10181f", 3.4], [colour, 1.8]]) {
      pen.strokeStyle = look; pen.lineWidth = width;
      pen.setLineDash([]);
      ring(pen, flight.route.slice(0, flight.measuring), to, false); pen.stroke();
      pen.setLineDash([2, 4]);
      ring(pen, flight.route.slice(flight.measuring - 1), to, false); pen.stroke();
    }
    pen.setLineDash([]); pen.globalAlpha = 1;
    if (flying && !live) marker(pen, to(at(flight, now.share * sortie.duration_s)), flight.uav);
  }
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

function told(now, found) {
  const texts = {
    planned: () => `sortie ${now.sortie}, ${Math.round(100 * now.share)} % of its time`,
  };
  const what = texts[now.kind] ? texts[now.kind]() : now.text;
  $("moment-text").textContent = `${what}; expected error ${found.error.toFixed(1)} dB`;
}

async function curve() {
  const events = [...new Set(story.moments.map((one) => one.event))];
  const errors = await Promise.all(events.map(async (event) => (await mapOf(event)).error));
  const [pen, wide, high] = fitted($("curve"));
  const style = getComputedStyle(document.documentElement);
  const top = Math.max(...errors, place.stop_db || 0) * 1.1, left = 28, low = high - 16;
  const x = (k) => left + (k / Math.max(1, events.length - 1)) * (wide - left - 10);
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
  ring(pen, errors.map((v, k) => [x(k), y(v)]), (p) => p, false); pen.stroke();
  const k = events.indexOf(moment().event);
  pen.beginPath(); pen.arc(x(k), y(errors[k]), 4, 0, 7);
  pen.fillStyle = style.getPropertyValue("--accent"); pen.fill();
  pen.textAlign = "center"; pen.fillStyle = style.getPropertyValue("--soft");
  pen.fillText("logs taken in", (left + wide) / 2, high - 5);
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

async function refresh() {
  story = await json("/api/story");
  const slider = $("moment"), last = story.moments.length - 1;
  slider.max = last;
  if (following) slider.value = last;
  $("lede").textContent =
    `${place.altitude}, ${place.middle.map((v) => v.toFixed(5)).join(", ")}: ` +
    `${story.sorties.length} sorties planned, ${story.readings.level.length} readings`;
  document.body.dataset.readings = story.readings.level.length;
  listFiles();
  await draw();
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
  mapOf(moment().event).then(({ mean, std }) => {
    const k = row * place.cols + col;
    const value = Number.isFinite(mean[k])
      ? `${mean[k].toFixed(1)} ± ${std[k].toFixed(1)} ${story.unit}` : "not on the map";
    $("readout").textContent = `${x.toFixed(0)} m east, ${y.toFixed(0)} m north: ${value}`;
  });
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
  await refresh();
  document.body.dataset.ready = "yes";
  const changes = new EventSource(linked("/api/changes"));
  changes.onmessage = ({ data }) => {
    const now = JSON.parse(data), before = JSON.stringify(live);
    live = now.live;
    if (now.last !== story.last) refresh();
    else if (JSON.stringify(live) !== before) draw();
  };
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
