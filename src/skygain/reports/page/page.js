"use strict";

// The survey as an animation. Maps lie in one deflated block: bytes 1 to 255 span a value range, 0 says "nothing here". Frames
// after the first hold differences to the frame before (modulo 256), which is what makes the file small.

const $ = (id) => document.getElementById(id);
const PLAY = "M8 5v14l11-7z";
const PAUSE = "M7 5h3.6v14H7zM13.4 5H17v14h-3.6z";
const SECONDS_AT_NORMAL_SPEED = 14;

async function unpacked(survey) {
  const packed = Uint8Array.from(atob(survey.blob), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const kinds = { f4: Float32Array, i4: Int32Array, i2: Int16Array, u1: Uint8Array };
  const parts = {};
  let offset = 0;
  for (const [name, kind, length] of survey.sections) {
    parts[name] = new kinds[kind](buffer, offset, length);
    offset += parts[name].byteLength;
  }
  const cells = survey.rows * survey.cols;
  for (const name of ["mean", "std"]) {
    const codes = parts[name];
    for (let i = cells; i < codes.length; i++) codes[i] = (codes[i] + codes[i - cells]) & 255;
  }
  return parts;
}

function number(value, decimals) {
  if (value === null || !Number.isFinite(value)) return "–";
  return value.toFixed(decimals).replace(/^-(?=.*[1-9])/, "−").replace(/^-/, "");
}

function withUnit(value, unit, decimals = 1) {
  if (value === null || !Number.isFinite(value)) return "–";
  if (unit === "%") return number(value * 100, 0) + " %";
  return number(value, unit.startsWith("dB") ? decimals : 2) + (unit ? " " + unit : "");
}

function niceTicks(low, high, most) {
  const rough = Math.max(high - low, 1e-9) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough * 0.93);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) ticks.push(i * step);
  return { ticks, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

function rgb(css) {
  const hex = css.trim().slice(1);
  return [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16));
}

function sized(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  canvas.style.width = width + "px";
  canvas.style.height = height + "px";
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

async function main() {
  const survey = JSON.parse($("survey").textContent);
  const data = await unpacked(survey);
  const { rows, cols, steps, views } = survey;
  const cells = rows * cols;
  const lastFrame = steps.length - 1;
  const lastStep = steps[lastFrame];
  const uavs = survey.uavs;
  const pathLength = data.paths.length / uavs / 2;
  const field = document.createElement("canvas");
  field.width = cols;
  field.height = rows;
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  const firstReading = new Map(); // cell → index of its readings, in order
  data.reading_cell.forEach((cell, i) => firstReading.set(cell, [...(firstReading.get(cell) || []), i]));

  const state = { view: survey.first_view, position: lastStep, frame: lastFrame, playing: false, hover: null, group: 0 };
  let theme = {};
  let place = null; // where the map lies on its canvas
  let paper = 0; // width in pixels that everything is drawn at for printing; 0 on a screen
  let painted = ""; // what the field shows: frame, view and theme

  // ---- values ----------------------------------------------------------------------------------------------------------------
  const decoded = (code, low, high) => (code === 0 ? null : low + ((code - 1) / 254) * (high - low));
  const meanAt = (frame, cell) => decoded(data.mean[frame * cells + cell], ...survey.gain_range);
  const stdAt = (frame, cell) => decoded(data.std[frame * cells + cell], 0, survey.std_high);
  const truthAt = (cell) => (data.truth ? decoded(data.truth[cell], ...survey.gain_range) : null);
  const errorAt = (frame, cell) => {
    const mean = meanAt(frame, cell);
    const truth = truthAt(cell);
    return mean === null || truth === null ? null : mean - truth;
  };
  const valueAt = { mean: meanAt, std: stdAt, error: errorAt, truth: (_, cell) => truthAt(cell) };

  // ---- the map ---------------------------------------------------------------------------------------------------------------
  function paintField() {
    const wanted = [state.view === "truth" ? 0 : state.frame, state.view, theme.name].join();
    if (wanted === painted) return;
    painted = wanted;
    const { low, high, colours } = views[state.view];
    const table = data[colours];
    const image = new ImageData(cols, rows);
    const pixels = image.data;
    const value = valueAt[state.view];
    for (let cell = 0; cell < cells; cell++) {
      const row = Math.floor(cell / cols);
      const at = ((rows - 1 - row) * cols + (cell % cols)) * 4; // row 0 is the south, the canvas begins in the north
      const indoors = data.indoor[cell];
      const rank = data.height[cell] / 255;
      const v = indoors ? null : value(state.frame, cell);
      const index = v === null ? 0 : 3 * Math.max(0, Math.min(255, Math.round(((v - low) / (high - low)) * 255)));
      for (let i = 0; i < 3; i++) {
        if (indoors) pixels[at + i] = theme.roofLow[i] + rank * (theme.roofHigh[i] - theme.roofLow[i]);
        else pixels[at + i] = v === null ? theme.plot[i] : table[index + i];
      }
      pixels[at + 3] = 255;
    }
    field.getContext("2d").putImageData(image, 0, 0);
  }

  function drawMap() {
    paintField();
    const box = paper || $("map").clientWidth;
    const margin = { left: 48, top: 12, right: 12, bottom: 40 };
    // what stands above and below the map, so that it is whole on the first screen
    const tallest = paper ? 0.95 * paper : Math.max(300, window.innerHeight - 352);
    const scale = Math.min((box - margin.left - margin.right) / cols, tallest / rows);
    const width = scale * cols;
    const height = scale * rows;
    const g = sized($("canvas"), width + margin.left + margin.right, height + margin.top + margin.bottom);
    place = { left: margin.left, top: margin.top, scale };
    g.imageSmoothingEnabled = false;
    g.drawImage(field, margin.left, margin.top, width, height);

    g.font = "11.5px ui-sans-serif, system-ui, sans-serif";
    g.fillStyle = g.strokeStyle = theme.soft;
    g.lineWidth = 1;
    const [west, south, east, north] = survey.bounds_m;
    const [x0, y0] = survey.georeferenced ? [west, south] : [0, 0];
    const perMetre = scale / survey.spacing_m;
    g.textAlign = "center";
    for (const x of niceTicks(west - x0, east - x0, width < 480 ? 4 : 6).ticks) {
      const px = margin.left + (x + x0 - west) * perMetre;
      g.fillRect(px, margin.top + height, 1, 4);
      g.fillText(number(x, 0), px, margin.top + height + 16);
    }
    g.fillText("x east in m", margin.left + width / 2, margin.top + height + 33);
    g.textAlign = "right";
    for (const y of niceTicks(south - y0, north - y0, height < 480 ? 4 : 6).ticks) {
      const py = margin.top + height - (y + y0 - south) * perMetre;
      g.fillRect(margin.left - 4, py, 4, 1);
      g.fillText(number(y, 0), margin.left - 7, py + 4);
    }
    g.save();
    g.translate(10, margin.top + height / 2);
    g.rotate(-Math.PI / 2);
    g.textAlign = "center";
    g.fillText("y north in m", 0, 0);
    g.restore();

    g.save();
    g.beginPath();
    g.rect(margin.left, margin.top, width, height);
    g.clip();
    if (hasLowRoofs) drawEdges(g, isLowRoof, [["rgb(255 255 255 / 40%)", 2], ["#3a4550", 0.9]]);
    if (data.no_fly) drawEdges(g, isNoFly, [["#d0352b", 1]]);
    g.restore();
    drawUavs(g, Math.max(5.5, Math.min(9.5, width / 62))); // whole at the edge of the map
    drawTransmitter(g, margin, width, height, perMetre);
    drawScale(g, margin.left + 12, margin.top + height - 12, width, perMetre);
    if (state.hover !== null) {
      const [px, py] = corner(state.hover);
      for (const [colour, wide] of [["#000", 3.5], ["#fff", 1.5]]) {
        g.strokeStyle = colour;
        g.lineWidth = wide;
        g.strokeRect(px, py, scale, scale);
      }
    }
  }

  const corner = (cell) => [
    place.left + (cell % cols) * place.scale,
    place.top + (rows - 1 - Math.floor(cell / cols)) * place.scale,
  ];

  // A line round cells: only the edge, so that the map inside is still seen.
  function drawEdges(g, held, lines) {
    g.beginPath();
    for (let cell = 0; cell < cells; cell++) {
      const [px, py] = corner(cell);
      if ((cell + 1) % cols && held(cell) !== held(cell + 1)) {
        g.moveTo(px + place.scale, py);
        g.lineTo(px + place.scale, py + place.scale);
      }
      if (cell + cols < cells && held(cell) !== held(cell + cols)) {
        g.moveTo(px, py);
        g.lineTo(px + place.scale, py);
      }
    }
    for (const [colour, wide] of lines) {
      g.strokeStyle = colour;
      g.lineWidth = wide;
      g.stroke();
    }
  }

  const isNoFly = (cell) => data.no_fly[cell] > 0;
  const isLowRoof = (cell) => data.height[cell] > 0 && !data.indoor[cell];
  const hasLowRoofs = data.height.some((_, cell) => isLowRoof(cell));

  // Where a UAV is at a fractional step, in canvas pixels; UAVs in one street fly beside each other.
  function uavPoint(uav, step) {
    const i = Math.min(Math.floor(step), pathLength - 1);
    const j = Math.min(i + 1, pathLength - 1);
    const part = Math.min(step, pathLength - 1) - i;
    const at = (k) => 2 * (uav * pathLength + k);
    const row = data.paths[at(i)] * (1 - part) + data.paths[at(j)] * part;
    const col = data.paths[at(i) + 1] * (1 - part) + data.paths[at(j) + 1] * part;
    const aside = ((uav - (uavs - 1) / 2) * Math.min(0.16, 0.7 / uavs)) * place.scale;
    return [place.left + (col + 0.5) * place.scale + aside, place.top + (rows - 0.5 - row) * place.scale - aside];
  }

  function trail(g, uav, from, to) {
    g.beginPath();
    g.moveTo(...uavPoint(uav, from));
    for (let k = Math.floor(from) + 1; k < to; k++) g.lineTo(...uavPoint(uav, k));
    g.lineTo(...uavPoint(uav, to));
    g.stroke();
  }

  function drawUavs(g, radius) {
    g.lineJoin = g.lineCap = "round";
    const now = state.position;
    const thin = Math.max(0.4, Math.min(1, 6 / uavs));
    radius *= Math.max(0.6, thin);
    const recent = Math.max(0, now - Math.max(12, lastStep / 8));
    for (let uav = 0; uav < uavs; uav++) {
      const colour = survey.uav_colours[uav];
      for (const [from, wide, casing] of [[0, 1.6 * thin, 3.4 * thin], [recent, 3 * thin, 5.4 * thin]]) {
        if (from && from >= now) continue;
        g.strokeStyle = "rgb(8 14 20 / 65%)";
        g.lineWidth = casing;
        trail(g, uav, from, now);
        g.strokeStyle = colour;
        g.lineWidth = wide;
        trail(g, uav, from, now);
      }
    }
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.font = `650 ${Math.round(radius * 1.25)}px ui-sans-serif, system-ui, sans-serif`;
    for (let uav = 0; uav < uavs; uav++) {
      const [px, py] = uavPoint(uav, now);
      g.beginPath();
      g.arc(px, py, radius, 0, 2 * Math.PI);
      g.fillStyle = survey.uav_colours[uav];
      g.fill();
      g.lineWidth = 4;
      g.strokeStyle = "#10181f";
      g.stroke();
      g.lineWidth = 2;
      g.strokeStyle = "#fff";
      g.stroke();
      g.fillStyle = "#10181f";
      if (uavs <= 12) g.fillText(String(uav), px, py + 0.5);
    }
    g.textBaseline = "alphabetic";
  }

  function drawTransmitter(g, margin, width, height, perMetre) {
    if (!survey.transmitter_m) return;
    const px = margin.left + (survey.transmitter_m[0] - survey.bounds_m[0]) * perMetre;
    const py = margin.top + height - (survey.transmitter_m[1] - survey.bounds_m[1]) * perMetre;
    if (px < margin.left || px > margin.left + width || py < margin.top || py > margin.top + height) return;
    g.beginPath();
    for (let k = 0; k < 10; k++) {
      const reach = k % 2 ? 4.6 : 11;
      const turn = -Math.PI / 2 + (k * Math.PI) / 5;
      g.lineTo(px + reach * Math.cos(turn), py + reach * Math.sin(turn));
    }
    g.closePath();
    g.lineWidth = 2.4;
    g.strokeStyle = "#10181f";
    g.stroke();
    g.fillStyle = "#ffd23f";
    g.fill();
  }

  // A bar of a round length and an arrow to the north, readable on any colour.
  function drawScale(g, x, y, width, perMetre) {
    const metres = width / 4 / perMetre;
    const power = 10 ** Math.floor(Math.log10(metres));
    const length = [5, 2, 1].map((m) => m * power).find((m) => m <= metres * (1 + 1e-9));
    const end = x + length * perMetre;
    const north = end + 20;
    g.lineJoin = "round";
    g.textAlign = "center";
    g.font = "600 11.5px ui-sans-serif, system-ui, sans-serif";
    for (const [colour, wide] of [["#fff", 5], ["#10181f", 2]]) {
      g.strokeStyle = g.fillStyle = colour;
      g.lineWidth = wide;
      g.beginPath();
      g.moveTo(x, y - 5);
      g.lineTo(x, y);
      g.lineTo(end, y);
      g.lineTo(end, y - 5);
      g.moveTo(north, y);
      g.lineTo(north, y - 14);
      g.moveTo(north - 4, y - 9);
      g.lineTo(north, y - 15);
      g.lineTo(north + 4, y - 9);
      g.stroke();
      for (const [text, at, up] of [[`${length} m`, (x + end) / 2, 6], ["N", north, 19]]) {
        g.lineWidth = 3.5;
        if (colour === "#fff") g.strokeText(text, at, y - up);
        else g.fillText(text, at, y - up);
      }
    }
  }

  // ---- the colour scale ------------------------------------------------------------------------------------------------------
  function drawBar() {
    const { low, high, colours, label } = views[state.view];
    const width = paper || $("bar").parentElement.clientWidth;
    const g = sized($("bar"), width, 52);
    const [left, right, top, thick] = [14, width - 14, 8, 12];
    const table = data[colours];
    const gradient = g.createLinearGradient(left, 0, right, 0);
    for (let i = 0; i < 256; i += 5) gradient.addColorStop(i / 255, `rgb(${table[3 * i]} ${table[3 * i + 1]} ${table[3 * i + 2]})`);
    g.fillStyle = gradient;
    g.fillRect(left, top, right - left, thick);
    // an arrow where values lie beyond the end
    for (const [at, tip, i] of [[left, left - 9, 0], [right, right + 9, 255]]) {
      if (i === 0 && state.view === "std") continue;
      g.fillStyle = `rgb(${table[3 * i]} ${table[3 * i + 1]} ${table[3 * i + 2]})`;
      g.beginPath();
      g.moveTo(at, top);
      g.lineTo(tip, top + thick / 2);
      g.lineTo(at, top + thick);
      g.fill();
    }
    g.fillStyle = theme.soft;
    g.font = "11.5px ui-sans-serif, system-ui, sans-serif";
    g.textAlign = "center";
    const { ticks, decimals } = niceTicks(low, high, width < 480 ? 4 : 7);
    const at = (value) => left + ((value - low) / (high - low)) * (right - left);
    for (const tick of ticks) {
      const signed = state.view === "error" && tick > 0 ? "+" : "";
      g.fillText(signed + number(tick, decimals), Math.max(left + 6, Math.min(right - 6, at(tick))), top + thick + 15);
    }
    g.fillText(label, (left + right) / 2, top + thick + 30);
    const value = state.hover === null || data.indoor[state.hover] ? null : valueAt[state.view](state.frame, state.hover);
    if (value !== null) {
      const px = Math.max(left, Math.min(right, at(value)));
      g.fillStyle = theme.ink;
      g.beginPath();
      g.moveTo(px - 6, 0);
      g.lineTo(px + 6, 0);
      g.lineTo(px, 8);
      g.fill();
      g.fillRect(px - 1, top, 2, thick);
    }
  }

  // ---- what the pointer is on ------------------------------------------------------------------------------------------------
  function cellAt(event) {
    const box = $("canvas").getBoundingClientRect();
    const col = Math.floor((event.clientX - box.left - place.left) / place.scale);
    const row = rows - 1 - Math.floor((event.clientY - box.top - place.top) / place.scale);
    return row >= 0 && row < rows && col >= 0 && col < cols ? row * cols + col : null;
  }

  function showReadout() {
    const line = $("readout");
    const cell = state.hover;
    if (cell === null) {
      line.textContent = "Point at the map to read a cell.";
      return;
    }
    const [row, col] = [Math.floor(cell / cols), cell % cols];
    const x = survey.bounds_m[0] + (col + 0.5) * survey.spacing_m;
    const y = survey.bounds_m[1] + (row + 0.5) * survey.spacing_m;
    const parts = [];
    const say = (name, text) => parts.push([name, text]);
    say("", `x ${number(x, 0)} m, y ${number(y, 0)} m`);
    if (survey.corners) {
      const [u, v] = [(col + 0.5) / cols, (row + 0.5) / rows];
      const [sw, se, nw, ne] = survey.corners;
      const [lat, lon] = [0, 1].map((k) => (sw[k] * (1 - u) + se[k] * u) * (1 - v) + (nw[k] * (1 - u) + ne[k] * u) * v);
      say("", `${Math.abs(lat).toFixed(5)}° ${lat < 0 ? "S" : "N"}, ${Math.abs(lon).toFixed(5)}° ${lon < 0 ? "W" : "E"}`);
    }
    if (data.indoor[cell]) {
      say("building", `${number((data.height[cell] / 255) * survey.highest_m, 0)} m high`);
    } else {
      const truth = truthAt(cell);
      const error = errorAt(state.frame, cell);
      say("estimate", `${withUnit(meanAt(state.frame, cell), survey.unit)} ± ${number(stdAt(state.frame, cell), 1)}`);
      if (truth !== null) say("truth", withUnit(truth, survey.unit));
      if (error !== null) say("error", (error > 0 ? "+" : "") + withUnit(error, "dB"));
      const taken = (firstReading.get(cell) || []).filter((i) => data.reading_step[i] <= state.position);
      if (taken.length) {
        const i = taken[taken.length - 1];
        say("measured", `${withUnit(data.reading_gain[i], survey.unit)} by UAV ${data.reading_uav[i]} at step ${data.reading_step[i]}`);
      }
    }
    line.replaceChildren();
    parts.forEach(([name, text], i) => {
      if (i) line.append(" · ");
      if (name) line.append(name + " ");
      const strong = document.createElement("b");
      strong.textContent = text;
      line.append(strong);
    });
  }

  // ---- the chart -------------------------------------------------------------------------------------------------------------
  let chart = null;

  function drawChart() {
    const group = survey.groups[state.group];
    if (!group) return;
    const width = Math.max(260, $("chart").clientWidth);
    const height = 214;
    const [left, right, top, bottom] = [42, width - 8, 10, height - 34];
    const values = group.lines.flatMap((line) => line.values).concat(group.goals).filter((v) => v !== null);
    let [low, high] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
    const pad = Math.max((high - low) * 0.08, group.unit === "%" ? 0.02 : 0.1);
    low = group.from_zero ? 0 : low - pad;
    high += pad;
    if (group.unit === "%") [low, high] = [Math.max(0, low), Math.min(1, high)];
    const percent = group.unit === "%" ? 100 : 1;
    const x = (step) => left + (lastStep ? step / lastStep : 0.5) * (right - left);
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    let svg = `<svg viewBox="0 0 ${width} ${height}" role="img">`;
    const across = niceTicks(low * percent, high * percent, 7);
    for (const tick of across.ticks) {
      const py = y(tick / percent);
      svg += `<line class="grid" x1="${left}" x2="${right}" y1="${py}" y2="${py}"/>`;
      svg += `<text x="${left - 7}" y="${py + 4}" text-anchor="end">${number(tick, across.decimals)}</text>`;
    }
    for (const tick of niceTicks(0, Math.max(lastStep, 1), 5).ticks) {
      if (tick <= lastStep) svg += `<text x="${x(tick)}" y="${bottom + 17}" text-anchor="middle">${number(tick, 0)}</text>`;
    }
    svg += `<text x="${(left + right) / 2}" y="${height - 2}" text-anchor="middle">steps per UAV</text>`;
    for (const goal of group.goals) svg += `<line class="goal" x1="${left}" x2="${right}" y1="${y(goal)}" y2="${y(goal)}"/>`;
    svg += `<line class="cursor" y1="${top - 4}" y2="${bottom}"/>`;
    group.lines.forEach((line, i) => {
      let path = "";
      let pen = "M";
      line.values.forEach((value, k) => {
        if (value === null) pen = "M";
        else {
          path += `${pen}${x(survey.score_steps[k]).toFixed(1)} ${y(value).toFixed(1)}`;
          pen = "L";
        }
      });
      svg += `<path d="${path}" style="stroke:var(--line-${i % 4})"/><circle r="5" style="fill:var(--line-${i % 4})"/>`;
    });
    $("chart").innerHTML = svg + "</svg>";
    const drawn = $("chart").firstElementChild;
    drawn.setAttribute("aria-label", `${group.title} against steps; the table below has the numbers`);
    chart = { group, x, y, cursor: drawn.querySelector(".cursor"), dots: [...drawn.querySelectorAll("circle")], left, right, drawn, width };
    drawn.addEventListener("pointerdown", seekOnChart);
    drawn.addEventListener("pointermove", (event) => event.buttons && seekOnChart(event));
    $("lines").replaceChildren(
      ...group.lines.map((line, i) => {
        const item = document.createElement("li");
        const mark = document.createElement("i");
        mark.style.background = `var(--line-${i % 4})`;
        item.append(mark, line.label, document.createElement("b"));
        return item;
      }),
    );
    moveCursor();
  }

  // Scores may be kept at more steps than maps are, so the cursor goes to the last score taken by now.
  const scoreIndex = () => Math.max(0, survey.score_steps.filter((step) => step <= state.position + 1e-6).length - 1);

  function moveCursor() {
    if (!chart) return;
    const px = chart.x(Math.min(state.position, lastStep));
    chart.cursor.setAttribute("x1", px);
    chart.cursor.setAttribute("x2", px);
    const k = scoreIndex();
    chart.group.lines.forEach((line, i) => {
      const value = line.values[k];
      chart.dots[i].setAttribute("visibility", value === null ? "hidden" : "visible");
      if (value !== null) {
        chart.dots[i].setAttribute("cx", chart.x(survey.score_steps[k]));
        chart.dots[i].setAttribute("cy", chart.y(value));
      }
      $("lines").children[i].lastChild.textContent = withUnit(value, chart.group.unit, 2);
    });
  }

  function seekOnChart(event) {
    const box = chart.drawn.getBoundingClientRect();
    const px = ((event.clientX - box.left) / box.width) * chart.width;
    const step = ((px - chart.left) / (chart.right - chart.left)) * lastStep;
    pause();
    goTo(steps.reduce((best, s, k) => (Math.abs(s - step) < Math.abs(steps[best] - step) ? k : best), 0));
  }

  // ---- the figures -----------------------------------------------------------------------------------------------------------
  const thresholdAtFirst = $("threshold").value;

  function covered() {
    const least = Number($("threshold").value);
    let above = 0;
    let all = 0;
    for (let cell = 0; cell < cells; cell++) {
      const value = meanAt(state.frame, cell);
      if (value === null) continue;
      all += 1;
      if (value >= least) above += 1;
    }
    return [number((100 * above) / Math.max(all, 1), 0)];
  }

  function readingsByNow() {
    const seen = new Set();
    let count = 0;
    data.reading_step.forEach((step, i) => {
      if (step > state.position) return;
      count += 1;
      if (!data.indoor[data.reading_cell[i]]) seen.add(data.reading_cell[i]);
    });
    const outdoor = cells - data.indoor.reduce((sum, one) => sum + one, 0);
    return [count.toLocaleString("en").replaceAll(",", "\u2009"), `in ${number((100 * seen.size) / outdoor, 1)} % of the outdoor cells`];
  }

  function flown() {
    const metres = survey.flown_m[Math.min(Math.floor(state.position + 1e-6), survey.flown_m.length - 1)];
    return [number(metres, 0), `${number(metres / survey.speed_mps / 60, 1)} min at ${survey.speed_mps} m/s`];
  }

  const liveScore = (name) => survey.live[name][scoreIndex()];
  const figures = {
    rmse_db: () => [number(liveScore("rmse_db"), 1)],
    expected_rmse_db: () => [number(liveScore("expected_rmse_db"), 1)],
    coverage90: () => [number(liveScore("coverage90") === null ? null : 100 * liveScore("coverage90"), 0)],
    gof: () => [(liveScore("gof") > 0 ? "+" : "") + number(liveScore("gof"), 2)],
    covered,
    flown,
    readings: readingsByNow,
  };

  let figuresOf = "";
  function showFigures() {
    const of = [state.frame, Math.floor(state.position), $("threshold").value].join();
    if (of === figuresOf) return;
    figuresOf = of;
    for (const tile of document.querySelectorAll("[data-live]")) {
      const [value, note] = figures[tile.dataset.live]();
      tile.querySelector(".value span").textContent = value;
      if (note) tile.querySelector(".note").textContent = note;
    }
  }

  // ---- time ------------------------------------------------------------------------------------------------------------------
  function show(position) {
    state.position = Math.max(0, Math.min(lastStep, position));
    state.frame = Math.max(0, steps.filter((step) => step <= state.position + 1e-6).length - 1);
    $("clock").textContent = String(Math.floor(state.position + 1e-6));
    $("slider").value = String(state.frame);
    $("slider").setAttribute("aria-valuetext", `step ${steps[state.frame]} of ${lastStep}`);
    for (const [id, off] of [["first", state.position <= steps[0]], ["back", state.position <= steps[0]], ["forward", state.position >= lastStep], ["last", state.position >= lastStep]]) {
      $(id).setAttribute("aria-disabled", String(off));
    }
    drawMap();
    drawBar();
    moveCursor();
    showFigures();
    if (state.hover !== null) showReadout();
    document.body.dataset.step = String(steps[state.frame]);
    document.body.dataset.view = state.view;
  }

  function announce() {
    const line = survey.groups.length ? survey.groups[0].lines[0] : null;
    const score = line ? `. ${line.label} ${withUnit(line.values[scoreIndex()], survey.groups[0].unit)}` : "";
    $("status").textContent = `Step ${steps[state.frame]} of ${lastStep}${score}`;
    keepLink();
  }

  // The address names what is shown, so that it can be sent to somebody.
  function keepLink() {
    let link = `#step=${steps[state.frame]}&view=${state.view}`;
    if (state.group) link += `&score=${state.group}`;
    if ($("threshold").value !== thresholdAtFirst) link += `&threshold=${$("threshold").value}`;
    if (location.hash !== link) history.replaceState(null, "", link);
  }

  function goTo(frame) {
    show(steps[Math.max(0, Math.min(lastFrame, frame))]);
    announce();
  }

  function pause() {
    state.playing = false;
    $("play").setAttribute("aria-label", "Play");
    $("play-icon").setAttribute("d", PLAY);
  }

  function play() {
    if (!lastStep) return;
    if (state.position >= lastStep) show(0);
    state.playing = true;
    $("play").setAttribute("aria-label", "Pause");
    $("play-icon").setAttribute("d", PAUSE);
    let before = performance.now();
    let virtual = state.position;
    const tick = (now) => {
      if (!state.playing) return;
      virtual += ((now - before) / 1000 / SECONDS_AT_NORMAL_SPEED) * lastStep * Number($("speed").value);
      before = now;
      // with reduced motion the UAVs jump from frame to frame instead of gliding
      show(calm.matches ? steps.filter((step) => step <= virtual).pop() : virtual);
      if (virtual >= lastStep) {
        pause();
        announce();
      } else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  const toggle = () => (state.playing ? (pause(), announce()) : play());
  // From between two frames, back goes to the one being shown and forward to the next.
  const stepBack = () => (pause(), goTo(state.position > steps[state.frame] + 1e-6 ? state.frame : state.frame - 1));
  const stepForward = () => (pause(), goTo(state.frame + 1));

  function choose(view) {
    if (!views[view]) return;
    state.view = view;
    document.querySelector(`.views input[value="${view}"]`).checked = true;
    $("canvas").setAttribute("aria-label", `Map: ${views[view].label}`);
    show(state.position);
  }

  // ---- wiring ----------------------------------------------------------------------------------------------------------------
  function readTheme() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    theme = {
      name: colour("--ground"), soft: colour("--soft"), ink: colour("--ink"),
      plot: rgb(colour("--plot")), roofLow: rgb(colour("--roof-low")), roofHigh: rgb(colour("--roof-high")),
    };
  }

  function redraw() {
    readTheme();
    drawChart();
    show(state.position);
  }

  function onPaper(width) {
    paper = width;
    document.documentElement.toggleAttribute("data-paper", width > 0);
    redraw();
  }

  function followLink() {
    const link = new URLSearchParams(location.hash.slice(1));
    if (link.has("view")) choose(link.get("view"));
    if (survey.groups[link.get("score")]) {
      $("metric").value = link.get("score");
      state.group = Number(link.get("score"));
      drawChart();
    }
    if (link.has("threshold")) $("threshold").value = link.get("threshold");
    showFigures();
    if (link.has("step")) {
      const step = Number(link.get("step"));
      goTo(steps.filter((s) => s <= step).length - 1);
    }
  }

  $("first").onclick = () => (pause(), goTo(0));
  $("back").onclick = stepBack;
  $("play").onclick = toggle;
  $("forward").onclick = stepForward;
  $("last").onclick = () => (pause(), goTo(lastFrame));
  $("slider").oninput = (event) => (pause(), goTo(Number(event.target.value)));
  for (const radio of document.querySelectorAll(".views input")) radio.onchange = () => (choose(radio.value), keepLink());
  $("metric").replaceChildren(...survey.groups.map((group, i) => new Option(group.title + (group.unit ? ` in ${group.unit}` : ""), i)));
  $("metric").onchange = (event) => {
    state.group = Number(event.target.value);
    drawChart();
    keepLink();
  };
  $("threshold").oninput = () => (showFigures(), keepLink());
  const point = (event) => {
    state.hover = cellAt(event);
    drawMap();
    drawBar();
    showReadout();
  };
  $("canvas").addEventListener("pointermove", point);
  $("canvas").addEventListener("pointerdown", point);
  $("canvas").addEventListener("pointerleave", (event) => {
    if (event.pointerType === "touch") return; // a tapped cell stays readable
    state.hover = null;
    drawMap();
    drawBar();
    showReadout();
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, .scroll, [type=number]")) return;
    const native = event.target.closest("input"); // slider and map choice have arrow keys of their own
    const order = Object.keys(views);
    if (event.key === "ArrowLeft" && !native) stepBack();
    else if (event.key === "ArrowRight" && !native) stepForward();
    else if (event.key === "Home" && !native) $("first").click();
    else if (event.key === "End" && !native) $("last").click();
    else if (event.key === " " && !event.target.closest("button, summary")) toggle();
    else if (/^[1-9]$/.test(event.key) && order[event.key - 1]) choose(order[event.key - 1]);
    else return;
    event.preventDefault();
  });
  window.addEventListener("hashchange", followLink);
  window.addEventListener("beforeprint", () => onPaper(640));
  window.addEventListener("afterprint", () => onPaper(0));
  window.addEventListener("resize", () => paper || drawMap()); // its height follows the window's
  let stageWidth = 0;
  new ResizeObserver(([entry]) => {
    if (entry.contentRect.width === stageWidth) return; // drawing changes the height, which must not draw again
    stageWidth = entry.contentRect.width;
    redraw();
  }).observe(document.querySelector(".stage"));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  readTheme();
  drawChart();
  choose(state.view);
  followLink();
  document.body.dataset.ready = "true";
}

main().catch((error) => {
  const old = typeof DecompressionStream === "undefined";
  $("alarm").hidden = false;
  $("alarm").textContent = old
    ? "This browser is too old to unpack the survey; open the file in a browser from 2023 or later."
    : `The survey cannot be shown: ${error.message}`;
  throw error;
});
