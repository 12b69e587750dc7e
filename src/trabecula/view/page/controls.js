// The panel: real inputs, so that keyboards and screen readers work without more ado.
"use strict";

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element[name] = value;
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

const digits = (value, step) => Number(value).toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0);

// A labelled slider; `get` reads the state, `set` writes it.
function slider(label, { min, max, step, unitName = "" }, get, set) {
  const note = make("output");
  const input = make("input", { type: "range", min, max, step, name: label });
  const show = () => {
    input.value = get();
    note.textContent = digits(get(), step) + unitName;
  };
  input.oninput = () => {
    set(Number(input.value));
    note.textContent = digits(input.value, step) + unitName;
  };
  show();
  return Object.assign(make("label", { class: "row" }, make("span", {}, label), input, note), { show });
}

function choice(label, options, get, set) {
  const select = make("select", { name: label }, ...options.map(([value, text]) => make("option", { value }, text)));
  select.onchange = () => set(select.value);
  const show = () => { select.value = get(); };
  show();
  return Object.assign(make("label", { class: "row" }, make("span", {}, label), select), { show });
}

function tick(label, get, set) {
  const input = make("input", { type: "checkbox", name: label });
  input.onchange = () => set(input.checked);
  const show = () => { input.checked = get(); };
  show();
  return Object.assign(make("label", { class: "tick" }, input, label), { show });
}

function dye(label, get, set) {
  const input = make("input", { type: "color", "aria-label": `colour of ${label}` });
  input.oninput = () => set(ofHex(input.value));
  const show = () => { input.value = hexOf(get()); };
  show();
  return Object.assign(input, { show });
}

function section(title, ...children) {
  return make("details", { open: true }, make("summary", {}, title), ...children);
}

function lookControls(app) {
  const names = Object.keys(TABLE.looks).map((name) => [name, name]);
  const rests = [["sharp", "sharp"], ["refined", "soft shadows, scattering"]];
  const rest = choice("At rest", rests, () => app.rest, (value) => { app.rest = value; app.redraw(); });
  return [choice("Look", names, () => app.look, (name) => app.setLook(name)), ...(app.drawing && app.drawing.mean ? [rest] : [])];
}

// Fields that may colour what is drawn.
function fieldControls(app, volume) {
  if (!volume.fields.length) return [];
  const names = [["-1", "their own"], ...volume.fields.map(({ name }, i) => [String(i), name])];
  return [choice("Colours", names, () => String(volume.field), (value) => app.setField(Number(value)))];
}

// The colours of a field and the values of their ends.
function placeLegend(host, volume) {
  const chosen = volume.fields[volume.field];
  host.hidden = !chosen;
  if (!chosen || host.dataset.name === chosen.name) return;
  const bar = make("canvas", { width: 256, height: 1, class: "ramp" }), image = new ImageData(256, 1);
  for (let value = 0; value < 256; value++) image.data.set([...rampColour(value), 255], 4 * value);
  bar.getContext("2d").putImageData(image, 0, 0);
  host.dataset.name = chosen.name;
  const ends = chosen.limits.map((value) => make("span", {}, brief(value)));
  host.replaceChildren(make("div", { class: "title" }, chosen.name), bar, make("div", { class: "ends" }, ...ends));
}

function cutControls(app) {
  const { cut } = app, changed = () => app.redraw();
  const modes = [["corner", "a corner"], ["planes", "planes along axes"], ["none", "nothing"]];
  const per = [0, 1, 2].map((axis) => slider("xyz"[axis], { min: 0, max: 1, step: 0.005 }, () => cut.at[axis], (value) => {
    cut.at[axis] = value;
    changed();
  }));
  const free = [
    slider("Turn", { min: -180, max: 180, step: 1, unitName: "°" }, () => cut.azimuth, (v) => { cut.azimuth = v; changed(); }),
    slider("Lift", { min: -90, max: 90, step: 1, unitName: "°" }, () => cut.elevation, (v) => { cut.elevation = v; changed(); }),
    slider("Shift", { min: 0, max: 1, step: 0.005 }, () => cut.offset, (v) => { cut.offset = v; changed(); }),
  ];
  const mode = choice("Take away", modes, () => cut.mode, (value) => { app.setCut(value); });
  const face = make("button", { type: "button", onclick: () => { app.faceCut(); changed(); } }, "Open towards me");
  const here = make("button", { type: "button", onclick: () => { cut.at = [...app.focus]; changed(); } }, "Cut at the slices");
  const plane = tick("Free plane", () => cut.free, (value) => { cut.free = value; changed(); });
  // Across the line of sight: what is nearer than the middle goes.
  const across = make("button", { type: "button", onclick: () => {
    const { azimuth, elevation } = app.cameras[app.active];
    Object.assign(cut, { free: true, azimuth, elevation, offset: 0.5 });
    changed();
  } }, "Plane across my view");
  return [mode, ...per, make("div", { class: "phase" }, face, here), plane, ...free, across];
}

function cameraControls(app) {
  const camera = () => app.cameras[app.active], changed = () => app.redraw();
  const rows = [
    slider("Around", { min: -180, max: 180, step: 1, unitName: "°" }, () => camera().azimuth, (v) => { camera().azimuth = v; changed(); }),
    slider("Above", { min: -90, max: 90, step: 1, unitName: "°" }, () => camera().elevation, (v) => { camera().elevation = v; changed(); }),
    slider("Zoom", { min: 0.5, max: 16, step: 0.1 }, () => camera().zoom, (v) => { camera().zoom = v; changed(); }),
  ];
  if (app.volumes.length > 1) rows.push(tick("Linked cameras", () => app.linked, (value) => app.link(value)));
  rows.push(make("button", { type: "button", onclick: () => app.home() }, "Reset view"));
  return rows;
}

const FINISH = [["Roughness", 1, 0.01], ["Specular", 1, 0.01], ["Absorption", 20, 0.1], ["Scattering", 5, 0.05]];

function finishControls(app, phase) {
  return FINISH.map(([name, max, step], k) => slider(name, { min: 0, max, step }, () => phase.finish[k], (value) => {
    phase.finish[k] = value;
    app.redraw();
  }));
}

function materialControls(app, volume) {
  const fresh = () => { volume.dirty = true; app.redraw(); app.drawSlices(); };
  // Of greys as a whole, of labels by phase; a cloud has no surface, and marks other blocks as empty.
  const opacity = (of) => slider("Opacity", { min: 0.05, max: 1, step: 0.05 }, () => of.opacity, (value) => {
    volume.dirty ||= value < 1 !== of.opacity < 1;
    of.opacity = value;
    app.redraw();
  });
  if (volume.kind !== "labels") return [...transferControls(app, volume, fresh), opacity(volume), ...finishControls(app, volume.phases[1])];
  const tints = fieldControls(app, volume);
  const host = make("div");
  let chosen = Math.max(0, volume.phases.findIndex((phase) => phase.visible));
  const list = volume.phases.map((phase) => make("div", { class: "phase" },
    tick(phase.name, () => phase.visible, (value) => { phase.visible = value; fresh(); }),
    make("span", { class: "share" }, phase.share),
    dye(phase.name, () => phase.colour, (value) => { phase.colour = value; app.redraw(); app.drawSlices(); })));
  const fill = () => host.replaceChildren(opacity(volume.phases[chosen]), ...finishControls(app, volume.phases[chosen]));
  const names = volume.phases.map((phase, label) => [String(label), phase.name]);
  const which = choice("Surface of", names, () => String(chosen), (value) => { chosen = Number(value); fill(); });
  fill();
  const lines = volume.lines ? [tick("Streamlines", () => volume.lines.shown, (value) => { volume.lines.shown = value; app.redraw(); })] : [];
  return [...tints, ...lines, ...list, which, host];
}

// Transfer function of greys: opacity rises from `low` to `high`; colours run from dark to bright over the window.
function transferControls(app, volume, fresh) {
  const canvas = make("canvas", { width: 256, height: 72, class: "histogram", role: "img",
    "aria-label": "histogram with the ramp of opacity; the sliders below move it" });
  const value = (v) => String(Number((volume.range[0] + v / 255 * (volume.range[1] - volume.range[0])).toPrecision(3)));
  const words = make("output", { class: "share" });
  const changed = () => { drawRamp(canvas, volume); words.textContent = `${value(volume.low)} .. ${value(volume.high)}`; fresh(); };
  const row = (label, get, set) => slider(label, { min: 0, max: 255, step: 1 }, get, (v) => { set(v); changed(); show(); });
  const rows = [
    row("Clear below", () => volume.low, (v) => { volume.low = v; volume.high = Math.max(v, volume.high); }),
    row("Full above", () => volume.high, (v) => { volume.high = v; volume.low = Math.min(v, volume.low); }),
  ];
  if (volume.kind === "grey") {
    rows.push(row("Dark", () => volume.window[0], (v) => { volume.window[0] = Math.min(v, volume.window[1] - 1); }));
    rows.push(row("Bright", () => volume.window[1], (v) => { volume.window[1] = Math.max(v, volume.window[0] + 1); }));
    rows.push(make("div", { class: "phase" }, "Colours", ...volume.phases.map((phase) => (
      dye(phase.name, () => phase.colour, (colour) => { phase.colour = colour; app.redraw(); })))));
  }
  const show = () => rows.forEach((each) => each.show && each.show());
  drag(canvas, (x) => {
    const v = Math.round(Math.min(255, Math.max(0, x * 255)));
    if (Math.abs(v - volume.low) <= Math.abs(v - volume.high)) volume.low = Math.min(v, volume.high);
    else volume.high = Math.max(v, volume.low);
    changed();
    show();
  });
  drawRamp(canvas, volume);
  words.textContent = `${value(volume.low)} .. ${value(volume.high)}`;
  return [canvas, make("div", { class: "phase" }, "Opacity rises over", words), ...rows];
}

function drag(canvas, moved) {
  const at = (event) => moved(event.offsetX / canvas.clientWidth);
  canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); at(event); };
  canvas.onpointermove = (event) => { if (event.buttons) at(event); };
}

function drawRamp(canvas, volume) {
  const pen = canvas.getContext("2d"), { width, height } = canvas;
  volume.counts ||= histogram(volume);
  const most = Math.log1p(Math.max(...volume.counts));
  pen.clearRect(0, 0, width, height);
  pen.fillStyle = "#9aa7b5";
  volume.counts.forEach((count, v) => pen.fillRect(v, height, 1, -height * Math.log1p(count) / most));
  pen.strokeStyle = "#b4441e";
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(0, height - 1);
  pen.lineTo(volume.low, height - 1);
  pen.lineTo(volume.high, 2);
  pen.lineTo(width, 2);
  pen.stroke();
}

function facts(volume) {
  const rows = volume.facts.map(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]).flat();
  const found = [make("dl", {}, ...rows)];
  if (volume.figures.length) {
    const judged = volume.figures.filter(([, , , verdict]) => verdict), passed = judged.filter(([, , , verdict]) => verdict === "pass");
    found.push(make("p", { class: "verdict" }, `Certificate: ${passed.length} of ${judged.length} figures shown pass`));
    const head = make("tr", {}, ...["figure", "value", "band", ""].map((text) => make("th", { scope: "col" }, text)));
    found.push(make("table", {}, head, ...volume.figures.map(([name, value, band, verdict]) => make("tr", { class: verdict },
      make("th", { scope: "row" }, name.replaceAll("_", " ")), make("td", {}, value), make("td", {}, band), make("td", {}, verdict)))));
  }
  volume.notes.forEach((note) => found.push(make("p", { class: "note" }, note)));
  return found;
}
