"use strict";
(() => {
  const data = JSON.parse(document.getElementById("frf-data").textContent);
  const root = document.getElementById("frf");
  const svgName = "http://www.w3.org/2000/svg";
  const MISSING = -32768;
  const HEIGHTS = { magnitude: 300, phase: 170 };
  const MARGIN = { left: 52, right: 12, top: 10, bottom: 26 };

  for (const e of data.estimates) {
    const bytes = Uint8Array.from(atob(e.data), (c) => c.charCodeAt(0));
    e.values = new Int16Array(bytes.buffer);
    e.cuts = new Set(e.cuts);
    e.shown = true;
  }
  const all = data.estimates.flatMap((e) => [e.frequency[0], e.frequency[e.frequency.length - 1]]);
  const whole = [Math.min(...all), Math.max(...all)];
  if (whole[0] === whole[1]) [whole[0], whole[1]] = [0.9 * whole[0], 1.1 * whole[1] || 1]; // a single line
  const state = { position: 0, out: 0, into: 0, range: whole.slice(), log: whole[0] > 0, cursor: null };

  // --- numbers

  /** One layer of the element that is chosen: an array over frequency, NaN where nothing is known. */
  function layer(e, name, out = state.out, into = state.into) {
    const at = e.layers.indexOf(name);
    if (at < 0 || state.position >= e.positions) return null;
    const n = e.frequency.length;
    const start = (((state.position * e.layers.length + at) * data.outputs.length + out) * data.inputs.length + into) * n;
    return Array.from(e.values.subarray(start, start + n), (v) => (v === MISSING ? NaN : v / 100));
  }
  const linear = (decibel) => 10 ** (decibel / 20);
  const decibel = (x) => 20 * Math.log10(Math.max(x, 1e-16));
  function written(x) {
    if (!Number.isFinite(x)) return "–";
    if (x === 0) return "0";
    const size = Math.floor(Math.log10(Math.abs(x)));
    return size < -3 || size > 5 ? x.toExponential(2) : x.toFixed(Math.max(0, 3 - size));
  }

  // --- scales

  const along = (f) => (state.log ? Math.log(f) : f);
  const back = (x) => (state.log ? Math.exp(x) : x);
  const width = () => Math.max(280, root.clientWidth);
  const inner = () => width() - MARGIN.left - MARGIN.right;
  const toX = (f) =>
    MARGIN.left + (inner() * (along(f) - along(state.range[0]))) / (along(state.range[1]) - along(state.range[0]));
  const toF = (x) =>
    back(along(state.range[0]) + ((x - MARGIN.left) / inner()) * (along(state.range[1]) - along(state.range[0])));

  function step(span, most) {
    const rough = span / most;
    const ten = 10 ** Math.floor(Math.log10(rough));
    return [1, 2, 5, 10].map((m) => m * ten).find((s) => s >= rough);
  }
  function ticks(low, high, most) {
    const by = step(high - low, most);
    const found = [];
    for (let k = Math.ceil(low / by - 1e-9); k * by <= high + 1e-9 * by; k++) found.push(k * by);
    return found;
  }
  function frequencies() {
    const [low, high] = state.range;
    if (!state.log || high / low < 4) return ticks(low, high, Math.min(8, inner() / 60));
    const found = [];
    const multiples = high / low > (inner() < 340 ? 100 : 500) ? [1] : [1, 2, 5];
    for (let d = Math.floor(Math.log10(low)); d <= Math.log10(high); d++)
      for (const m of multiples) if (m * 10 ** d >= low && m * 10 ** d <= high) found.push(m * 10 ** d);
    return found;
  }
  const short = (x) => String(Number(x.toPrecision(4)));

  // --- drawing

  function element(name, attributes, parent, text) {
    const made = document.createElementNS(svgName, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    parent.appendChild(made);
    return made;
  }
  function visible(e) {
    const found = [];
    e.frequency.forEach((f, k) => {
      if (f >= state.range[0] * (1 - 1e-9) && f <= state.range[1] * (1 + 1e-9)) found.push(k);
    });
    if (!found.length) return found;
    const before = found[0] - 1;
    const after = found[found.length - 1] + 1;
    if (before >= 0) found.unshift(before);
    if (after < e.frequency.length) found.push(after);
    return found;
  }
  function limits() {
    let [low, high] = [Infinity, -Infinity];
    for (const e of data.estimates.filter((x) => x.shown)) {
      const levels = ["level", "noise", "total"].map((name) => layer(e, name)).filter((values) => values);
      for (const k of visible(e))
        for (const values of levels)
          if (Number.isFinite(values[k])) [low, high] = [Math.min(low, values[k]), Math.max(high, values[k])];
    }
    if (low > high) return [-1, 1];
    const pad = Math.max(2, 0.08 * (high - low));
    return [low - pad, high + pad];
  }
  /** Pieces of a line: no line across gaps, missing values or, of a phase, steps that could go either way. */
  function line(e, ys, indices, toY, jump = Infinity) {
    let text = "";
    let last = null;
    for (const k of indices) {
      if (!Number.isFinite(ys[k])) {
        last = null;
        continue;
      }
      const joined = last !== null && k === last + 1 && !e.cuts.has(last) && Math.abs(ys[k] - ys[last]) < jump;
      text += `${joined ? "L" : "M"}${toX(e.frequency[k]).toFixed(1)},${toY(ys[k]).toFixed(1)}`;
      last = k;
    }
    return text;
  }
  function band(e, low, high, indices, toY) {
    let text = "";
    let run = [];
    const close = () => {
      if (run.length > 1) {
        const x = (k) => toX(e.frequency[k]).toFixed(1);
        text += `M${run.map((k) => `${x(k)},${toY(high[k]).toFixed(1)}`).join("L")}`;
        text += `L${run.reverse().map((k) => `${x(k)},${toY(low[k]).toFixed(1)}`).join("L")}Z`;
      }
      run = [];
    };
    for (const k of indices) {
      const known = Number.isFinite(low[k]) && Number.isFinite(high[k]);
      if (!known || (run.length && (k !== run[run.length - 1] + 1 || e.cuts.has(run[run.length - 1])))) close();
      if (known) run.push(k);
    }
    close();
    return text;
  }

  function chart(kind, low, high, labels) {
    const holder = root.querySelector(`.chart.${kind}`);
    holder.textContent = "";
    const [w, h] = [width(), HEIGHTS[kind]];
    const bottom = h - MARGIN.bottom;
    const toY = (v) => MARGIN.top + ((high - v) / (high - low)) * (bottom - MARGIN.top);
    const says = kind === "magnitude" ? `Magnitude, dB re 1 ${data.unit}` : "Phase, degrees";
    const svg = element("svg", { viewBox: `0 0 ${w} ${h}`, role: "img", "aria-label": says }, holder);
    const clip = element("clipPath", { id: `clip-${kind}` }, element("defs", {}, svg));
    element("rect", { x: MARGIN.left, y: MARGIN.top, width: inner(), height: bottom - MARGIN.top }, clip);
    for (const f of frequencies()) {
      const x = toX(f);
      element("line", { x1: x, x2: x, y1: MARGIN.top, y2: bottom, class: "grid" }, svg);
      element("text", { x, y: bottom + 16, class: "tick", "text-anchor": "middle" }, svg, short(f));
    }
    for (const v of labels) {
      element("line", { x1: MARGIN.left, x2: w - MARGIN.right, y1: toY(v), y2: toY(v), class: "grid" }, svg);
      element("text", { x: MARGIN.left - 7, y: toY(v) + 4, class: "tick", "text-anchor": "end" }, svg, short(v));
    }
    const frame = { x: MARGIN.left, y: MARGIN.top, width: inner(), height: bottom - MARGIN.top, class: "frame" };
    element("rect", frame, svg);
    return { svg, toY, drawn: element("g", { "clip-path": `url(#clip-${kind})` }, svg), bottom };
  }

  function marks(e, ys, indices, toY, group) {
    const doubted = layer(e, "doubt");
    const radius = Math.max(1.2, Math.min(2.6, (0.4 * inner()) / Math.max(indices.length, 1)));
    let [sure, doubtful] = ["", ""];
    for (const k of indices) {
      if (!Number.isFinite(ys[k])) continue;
      const [x, y] = [toX(e.frequency[k]), toY(ys[k])];
      const dot = `M${(x - radius).toFixed(1)},${y.toFixed(1)}a${radius},${radius} 0 1,0 ${2 * radius},0a${radius},${radius} 0 1,0 ${-2 * radius},0`;
      if (doubted && doubted[k] > 0) doubtful += dot;
      else sure += dot;
    }
    element("path", { d: sure, fill: e.colour, class: "points" }, group);
    if (doubtful) element("path", { d: doubtful, class: "points doubtful" }, group);
  }

  function draw() {
    const shown = data.estimates.filter((e) => e.shown && state.position < e.positions);
    const [low, high] = limits();
    const magnitude = chart("magnitude", low, high, ticks(low, high, 6));
    const phase = chart("phase", -190, 190, [-180, -90, 0, 90, 180]);
    for (const e of shown) {
      const indices = visible(e);
      const [level, angle, radius] = ["level", "phase", "radius"].map((name) => layer(e, name));
      const relative = level.map((v, k) => (radius ? linear(radius[k] - v) : NaN));
      const above = level.map((v, k) => v + decibel(1 + relative[k]));
      const below = level.map((v, k) => (relative[k] < 1 ? Math.max(v + decibel(1 - relative[k]), low - 20) : low - 20));
      const known = below.map((v, k) => (Number.isFinite(relative[k]) ? v : NaN));
      const half = relative.map((x) => (x < 1 ? (Math.asin(x) * 180) / Math.PI : NaN));
      const spread = (sign) => angle.map((v, k) => v + sign * half[k]);
      element("path", { d: band(e, known, above, indices, magnitude.toY), fill: e.colour, class: "band" }, magnitude.drawn);
      element("path", { d: band(e, spread(-1), spread(1), unwrapped(angle, indices), phase.toY), fill: e.colour, class: "band" }, phase.drawn);
      for (const [name, dash] of [["noise", "2 3"], ["total", "6 3"]]) {
        const values = layer(e, name);
        if (values) element("path", { d: line(e, values, indices, magnitude.toY), stroke: e.colour, class: "line", "stroke-dasharray": dash }, magnitude.drawn);
      }
      const look = { stroke: e.colour, class: e.points ? "line" : "line model" };
      element("path", { d: line(e, level, indices, magnitude.toY), ...look }, magnitude.drawn);
      element("path", { d: line(e, angle, indices, phase.toY, 120), ...look }, phase.drawn);
      if (!e.points) continue;
      marks(e, level, indices, magnitude.toY, magnitude.drawn);
      marks(e, angle, indices, phase.toY, phase.drawn);
    }
    for (const [kind, made] of Object.entries({ magnitude, phase })) listen(kind, made);
    point();
    name();
  }
  /** Indices without those beside a step of the phase through 180 degrees, where a band would cross the picture. */
  function unwrapped(angle, indices) {
    return indices.filter((k) => !(Math.abs((angle[k + 1] ?? angle[k]) - angle[k]) > 120));
  }
  function name() {
    const unit = `${data.outputs[state.out]} / ${data.inputs[state.into]}`;
    root.querySelector(".what").textContent =
      `G${state.out + 1}${state.into + 1}: ${unit}, dB re 1 ${data.unit} and degrees over Hz` +
      (data.positions.length > 1 ? `; ${data.positions[state.position]}` : "");
    for (const b of root.querySelectorAll(".cell"))
      b.setAttribute("aria-pressed", String(+b.dataset.out === state.out && +b.dataset.into === state.into));
  }

  // --- reading and zooming

  function nearest(e, f) {
    let best = 0;
    e.frequency.forEach((x, k) => {
      if (Math.abs(along(x) - along(f)) < Math.abs(along(e.frequency[best]) - along(f))) best = k;
    });
    return best;
  }
  function point() {
    for (const old of root.querySelectorAll(".cursor")) old.remove();
    const body = root.querySelector(".values tbody");
    body.textContent = "";
    const first = data.estimates.find((e) => e.shown && state.position < e.positions);
    if (!first) return;
    if (state.cursor === null) {
      const level = layer(first, "level");
      const inside = visible(first).filter((k) => Number.isFinite(level[k]));
      if (!inside.length) return;
      state.cursor = first.frequency[inside.reduce((a, b) => (level[b] > level[a] ? b : a))];
    }
    const at = first.frequency[nearest(first, state.cursor)];
    for (const kind of ["magnitude", "phase"]) {
      const svg = root.querySelector(`.chart.${kind} svg`);
      const x = toX(at);
      if (x >= MARGIN.left - 1 && x <= width() - MARGIN.right + 1)
        element("line", { x1: x, x2: x, y1: MARGIN.top, y2: HEIGHTS[kind] - MARGIN.bottom, class: "cursor" }, svg);
    }
    for (const e of data.estimates.filter((x) => x.shown && state.position < x.positions)) {
      const k = nearest(e, at);
      const [level, angle, radius] = ["level", "phase", "radius"].map((n) => layer(e, n));
      const relative = radius ? linear(radius[k] - level[k]) : NaN;
      const degrees = relative < 1 ? (Math.asin(relative) * 180) / Math.PI : NaN;
      const row = document.createElement("tr");
      const cells = [
        e.name,
        written(e.frequency[k]),
        written(linear(level[k])),
        Number.isFinite(relative) ? `± ${(100 * relative).toPrecision(2)} %` : e.points ? "unknown" : "",
        level[k].toFixed(2),
        Number.isFinite(degrees) ? `${angle[k].toFixed(1)} ± ${degrees.toPrecision(2)}` : angle[k].toFixed(1),
      ];
      cells.forEach((text, i) => {
        const cell = document.createElement("td");
        cell.textContent = text;
        if (i) cell.className = "number";
        else cell.style.borderLeft = `3px solid ${e.colour}`;
        row.appendChild(cell);
      });
      body.appendChild(row);
    }
  }
  function zoom(low, high) {
    const [a, b] = [Math.max(Math.min(low, high), whole[0]), Math.min(Math.max(low, high), whole[1])];
    if (b > a * (1 + 1e-6)) {
      state.range = [a, b];
      draw();
    }
  }
  function scaled(factor) {
    const middle = along(Math.min(Math.max(state.cursor ?? state.range[0], state.range[0]), state.range[1]));
    const [a, b] = state.range.map(along);
    zoom(back(middle - (middle - a) * factor), back(middle + (b - middle) * factor));
  }
  let pressed = null;
  function listen(kind, { svg, bottom }) {
    const place = (event) => {
      const box = svg.getBoundingClientRect();
      return ((event.clientX - box.left) * width()) / box.width;
    };
    svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") return;
      pressed = { x: place(event), rect: element("rect", { y: MARGIN.top, height: bottom - MARGIN.top, class: "chosen" }, svg) };
      if (event.isTrusted) svg.setPointerCapture(event.pointerId); // made-up events have no pointer to capture
    });
    svg.addEventListener("pointermove", (event) => {
      const x = place(event);
      if (pressed) {
        pressed.rect.setAttribute("x", Math.min(x, pressed.x));
        pressed.rect.setAttribute("width", Math.abs(x - pressed.x));
      }
      state.cursor = Math.min(Math.max(toF(x), state.range[0]), state.range[1]);
      point();
    });
    svg.addEventListener("click", (event) => {
      state.cursor = Math.min(Math.max(toF(place(event)), state.range[0]), state.range[1]);
      point();
    });
    svg.addEventListener("pointerup", (event) => {
      if (!pressed) return;
      const [from, to] = [pressed.x, place(event)];
      pressed.rect.remove();
      pressed = null;
      if (Math.abs(to - from) > 8) zoom(toF(from), toF(to));
    });
    svg.addEventListener("dblclick", () => zoom(...whole));
  }

  // --- what can be chosen

  function options(select, names, change) {
    names.forEach((text, k) => select.add(new Option(text, k)));
    select.addEventListener("change", () => {
      change(+select.value);
      draw();
    });
    select.closest("label").hidden = names.length < 2;
  }
  options(root.querySelector(".position"), data.positions, (k) => {
    state.position = k;
    thumbnails();
  });
  options(root.querySelector(".output"), data.outputs, (k) => (state.out = k));
  options(root.querySelector(".input"), data.inputs, (k) => (state.into = k));
  const legend = root.querySelector(".legend");
  data.estimates.forEach((e) => {
    const label = document.createElement("label");
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = true;
    box.addEventListener("change", () => {
      e.shown = box.checked;
      draw();
    });
    const mark = document.createElement("i");
    mark.style.background = e.colour;
    label.append(box, mark, e.name);
    legend.append(label);
  });
  legend.hidden = data.estimates.length < 2;
  const axis = root.querySelector(".axis");
  axis.hidden = whole[0] <= 0;
  axis.textContent = state.log ? "linear axis" : "logarithmic axis";
  axis.addEventListener("click", () => {
    state.log = !state.log;
    axis.textContent = state.log ? "linear axis" : "logarithmic axis";
    draw();
  });
  root.querySelector(".in").addEventListener("click", () => scaled(0.5));
  root.querySelector(".out").addEventListener("click", () => scaled(2));
  root.querySelector(".reset").addEventListener("click", () => zoom(...whole));
  root.querySelector(".charts").addEventListener("keydown", (event) => {
    const first = data.estimates.find((e) => e.shown);
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by && first) {
      const k = nearest(first, state.cursor ?? state.range[0]) + by;
      state.cursor = first.frequency[Math.min(Math.max(k, 0), first.frequency.length - 1)];
      point();
    } else if (event.key === "+") scaled(0.5);
    else if (event.key === "-") scaled(2);
    else if (event.key === "Escape") zoom(...whole);
    else return;
    event.preventDefault();
  });

  function thumbnails() {
    const holder = root.querySelector(".matrix");
    holder.textContent = "";
    if (data.outputs.length * data.inputs.length < 2) return;
    holder.style.gridTemplateColumns = `repeat(${data.inputs.length}, minmax(0, 1fr))`;
    const e = data.estimates.find((x) => state.position < x.positions);
    for (let out = 0; out < data.outputs.length; out++) {
      for (let into = 0; into < data.inputs.length; into++) {
        const cell = document.createElement("button");
        Object.assign(cell.dataset, { out, into });
        cell.className = "cell";
        cell.type = "button";
        cell.title = `${data.outputs[out]} / ${data.inputs[into]}`;
        cell.setAttribute("aria-label", `G${out + 1}${into + 1}: ${cell.title}`);
        const level = layer(e, "level", out, into);
        const finite = level.filter(Number.isFinite);
        const [low, high] = [Math.min(...finite), Math.max(...finite)];
        const svg = element("svg", { viewBox: "0 0 100 40", preserveAspectRatio: "none" }, cell);
        const many = Math.max(1, Math.floor(level.length / 400));
        const [a, b] = whole.map((f) => (whole[0] > 0 ? Math.log(f) : f));
        let text = "";
        level.forEach((v, k) => {
          const f = whole[0] > 0 ? Math.log(e.frequency[k]) : e.frequency[k];
          if (Number.isFinite(v) && k % many === 0)
            text += `${text ? "L" : "M"}${((100 * (f - a)) / (b - a || 1)).toFixed(1)},${(38 - (36 * (v - low)) / (high - low || 1)).toFixed(1)}`;
        });
        element("path", { d: text, stroke: e.colour }, svg);
        const tag = document.createElement("span");
        tag.textContent = `G${out + 1}${into + 1}`;
        cell.append(tag);
        cell.addEventListener("click", () => {
          [state.out, state.into] = [out, into];
          root.querySelector(".output").value = out;
          root.querySelector(".input").value = into;
          draw();
          root.scrollIntoView({ block: "nearest" });
        });
        holder.append(cell);
      }
    }
  }

  thumbnails();
  draw();
  let drawnWidth = width();
  window.addEventListener("resize", () => {
    if (width() !== drawnWidth) {
      drawnWidth = width();
      draw();
    }
  });
})();
