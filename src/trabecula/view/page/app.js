// The page: its state, when it draws, and what tests and notebooks may ask it.
"use strict";

const HOME = { azimuth: 32, elevation: 26, zoom: 1, pan: [0, 0] };
const JITTER = [[-0.25, -0.25], [0.25, 0.25], [0.25, -0.25], [-0.25, 0.25]];
const REFINED = 48;   // passes of the refined light
const $ = (id) => document.getElementById(id);

class App {
  constructor(volumes, drawing, weights = null) {
    Object.assign(this, { volumes, drawing, look: PAGE.look, active: PAGE.endless?.volume ?? 0, linked: true, frames: 0, passes: 0 });
    this.cut = { mode: "corner", at: [0.5, 0.5, 0.5], side: [1, -1, 1], free: false, azimuth: 85, elevation: 12, offset: 0.5 };
    this.homeAngles = { ...HOME };
    this.cameras = volumes.map(() => null);
    this.moved = -Infinity;
    this.dragScale = 0.5;
    this.focus = [0.5, 0.5, 0.5];
    this.measuring = false;
    this.tape = new Tape(this);
    // On a processor a pass takes a second: there the refined light is for those who ask.
    this.rest = drawing && drawing.mean && !drawing.onProcessor ? "refined" : "sharp";
    this.link(true);
    this.setLook(this.look, false);
    this.cut.at = [0, 1, 2].map((axis) => {
      const side = volumes[0].sides[axis];
      return side > 1 ? Math.floor(side / 2) / side : 0.5;
    });
    this.endless = PAGE.endless ? new Endless(this, PAGE.endless, weights) : null;
    this.views = volumes.map((volume) => this.overlay(volume));
    this.ofLook = this.atFirst = snapshot(this);
    this.recall();
    this.slices = slicePanels(this, $("slices"));
    this.choose(this.active, true);
    if (this.endless) this.endless.ask();
  }

  // What the address remembers.
  recall() {
    const unknown = restore(this, location.hash.slice(1));
    if (unknown.length) complain(`The address holds what this page does not know, which is left out: ${unknown.join(", ")}.`);
    this.remembered = stateText(this);
  }

  overlay(volume) {
    const bar = make("div", { class: "bar" }), label = make("div", { class: "length" }), handles = make("div");
    const tape = vector("svg", { class: "tape", "aria-hidden": "true" }), legend = make("div", { class: "legend" });
    const spot = make("div", { class: "spot", "aria-hidden": "true" }), level = make("div", { class: "level" });
    const host = make("div", { class: "view" }, make("div", { class: "name" }, volume.name), level, tape, spot, handles, legend, label, bar);
    $("views").append(host);
    return { host, bar, label, handles, tape, legend, spot, level };
  }

  // Cameras: one for all while linked, else one each.
  link(linked) {
    this.linked = linked;
    const one = this.cameras[this.active] || { ...HOME, pan: [0, 0] };
    this.cameras = this.cameras.map((camera, i) => (linked || i === this.active ? one : { ...one, pan: [...one.pan] }));
  }

  home() {
    Object.assign(this.cameras[this.active], this.homeAngles, { pan: [0, 0] });
    this.redraw();
  }

  setLook(name, draw = true) {
    this.look = name;
    const look = TABLE.looks[name];
    for (const volume of this.volumes) {
      const colours = [look.solid, ...TABLE.further];
      let next = 0;
      for (const phase of volume.phases) {
        phase.colour = phase.dark ? look.void : colours[next++ % colours.length];
        phase.hidden = look.void;
        phase.finish = [look.roughness, look.specular, look.absorption, look.scattering];
      }
      if (volume.kind === "grey") [volume.phases[0].colour, volume.phases[1].colour] = [[20, 18, 16], [255, 252, 246]];
    }
    document.documentElement.style.setProperty("--ground", hexOf(look.background));
    if (this.views) this.ofLook = snapshot(this);
    if (draw) {
      this.panel();
      this.redraw();
      this.drawSlices();
    }
  }

  setCut(mode) {
    this.cut.mode = mode;
    this.faceCut();
    this.redraw();
  }

  // Open the cut on the side that faces the viewer.
  faceCut() {
    this.cut.side = basis(this.cameras[this.active]).viewer.map((value) => (value >= -1e-9 ? 1 : -1));
  }

  choose(index, force = false) {
    if (index === this.active && !force) return;
    this.active = index;
    this.views.forEach(({ host }, i) => host.classList.toggle("active", i === index && this.volumes.length > 1));
    this.drawSlices();
    this.panel();
  }

  // The voxel (x, y, z) of the active volume where the three slices cross.
  focusVoxel() {
    const volume = this.volumes[this.active];
    return [0, 1, 2].map((i) => sliceAt(volume, this.focus, 2 - i));
  }

  middleOf(voxel) {
    return voxel.map((value, i) => (value + 0.5) * this.volumes[this.active].edges[i]);
  }

  setFocus(voxel) {
    const volume = this.volumes[this.active];
    this.focus = voxel.map((value, i) => (value + 0.5) / volume.sides[i]);
    this.drawSlices(false);
    this.read(this.active, voxel);
    if (this.drawing) this.overlays();
    remember(this);
  }

  say(text) {
    $("probe").textContent = text;
  }

  // What is at a voxel; the thickness, which takes a moment, once the pointer rests.
  read(index, voxel) {
    clearTimeout(this.resting);
    this.say(this.reading(index, voxel, { thick: false }));
    this.resting = setTimeout(() => this.say(this.reading(index, voxel)), 120);
  }

  reading(index, voxel, options) {
    return readingOf(this.volumes[index], voxel, options);
  }

  // The material under a place of the stage, CSS pixels.
  under(x, y) {
    const index = this.cellAt(x, y), cell = this.cells[index];
    const found = pick(this.volumes[index], this.cameras[index], cell, this.cut, x - cell.left, y - cell.top);
    return found && { index, ...found };
  }

  hover(x, y) {
    const found = this.under(x, y);
    if (found) this.read(found.index, found.voxel);
  }

  // A press without a move: an end of the tape, or the place where the slices cross.
  press(x, y) {
    const found = this.under(x, y);
    if (!found) return;
    if (this.measuring) this.tape.add(found.index, found.point);
    else this.setFocus(found.voxel);
  }

  measureBy(on) {
    this.measuring = on;
    $("tape").setAttribute("aria-pressed", String(on));
    $("stage").classList.toggle("measuring", on);
    if (on) this.say("tape: press two places of the material, or of a slice");
    else this.tape.clear();
  }

  // Colours by a field of the active volume; -1: its own.
  setField(number) {
    const volume = this.volumes[this.active];
    volume.field = number;
    if (volume.textures) this.drawing.tint(volume);
    this.redraw();
    this.drawSlices();
  }

  // The box in finer voxels that came, or none.
  takeDetail(index, fine) {
    const volume = this.volumes[index];
    volume.fine = fine;
    if (volume.textures) this.drawing.refine(volume);
    this.passes = 0;
    this.schedule();
  }

  panel() {
    const volume = this.volumes[this.active], several = this.volumes.length > 1;
    const names = this.volumes.map(({ name }, i) => [String(i), name]);
    const which = several ? [choice("Volume", names, () => String(this.active), (value) => this.choose(Number(value)))] : [];
    const drawn = this.drawing ? [section("Look and material", ...lookControls(this), ...materialControls(this, volume)),
      section("Cut", ...cutControls(this)), section("Camera", ...cameraControls(this))] : [];
    const open = [...$("panel").querySelectorAll("details")].map((each) => each.open);
    $("panel").replaceChildren(...which, ...(this.endless ? [this.endless.section] : []), section("Figures", ...facts(volume)), ...drawn);
    $("panel").querySelectorAll("details").forEach((each, i) => { each.open = open[i] ?? i < 3; });
  }

  drawSlices(fresh = true) {
    this.slices.forEach((one) => one.draw(this.volumes[this.active], fresh));
  }

  // Places of the volumes on the stage, CSS pixels from its upper left, and the length of a pixel in each one's unit.
  layout() {
    const { clientWidth, clientHeight } = $("stage"), count = this.volumes.length;
    const columns = Math.min(count, Math.max(1, Math.round(Math.sqrt(count * clientWidth / clientHeight))));
    const rows = Math.ceil(count / columns);
    const width = Math.floor(clientWidth / columns), height = Math.floor(clientHeight / rows), { foot } = frame(width, height);
    const fits = this.volumes.map((volume) => fit(volume.extent, basis(this.homeAngles), width, height));
    const widest = Math.max(...fits.map((pixel, i) => pixel * this.volumes[i].scale));
    this.cells = this.volumes.map((volume, i) => {
      const base = PAGE.aligned ? widest / volume.scale : fits[i];
      const left = (i % columns) * width, top = Math.floor(i / columns) * height;
      return { left, top, width, height, foot, pixel: base / this.cameras[i].zoom };
    });
  }

  cellAt(x, y) {
    const found = this.cells.findIndex(({ left, top, width, height }) => (
      x >= left && x < left + width && y >= top && y < top + height));
    return found < 0 ? this.active : found;
  }

  redraw() {
    this.moved = performance.now();
    this.passes = 0;
    this.schedule();
  }

  schedule() {
    if (this.waiting || !this.drawing) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.step();
    });
  }

  // A coarse picture while things move, then a sharp one, of four passes with rays between rays; then, where that is wanted,
  // many passes of the refined light. Later passes count for more, so that the quick light is soon forgotten.
  step() {
    const since = performance.now() - this.moved, moving = since < 150 && this.frames > 0;
    if (moving) {
      this.paint(this.dragScale, 0);
      const took = performance.now() - (this.last ?? 0);
      this.last = performance.now();
      if (took < 1000) this.dragScale = Math.max(0.25, Math.min(1, this.dragScale * (took > 120 ? 0.8 : took < 25 ? 1.15 : 1)));
      clearTimeout(this.settle);
      this.settle = setTimeout(() => this.schedule(), 160);
      return;
    }
    this.pass();
    if (this.passes === JITTER.length) {
      remember(this);
      this.volumes.forEach((volume, i) => fetchDetail(this, i));
    }
    if (this.passes < this.passesAtRest) this.schedule();
  }

  get passesAtRest() {
    return JITTER.length + (this.rest === "refined" && this.drawing.mean ? REFINED : 0);
  }

  // The next pass at rest.
  pass() {
    const k = this.passes - JITTER.length;
    if (k < 0) this.paint(1, this.passes);
    else {
      const jitter = [0.5, 0.7548776662, 0.5698402910].slice(1).map((step) => ((k + 1) * step) % 1 - 0.5);
      this.paint(1, 1, { pass: k, jitter, blend: (k + 1) / (3 + (k + 1) * (k + 2) / 2) });
    }
    this.passes += 1;
  }

  paint(scale, pass, options = {}) {
    this.layout();
    const density = Math.min(window.devicePixelRatio || 1, 2) * scale, { clientWidth, clientHeight } = $("stage");
    const pixels = (length) => Math.max(1, Math.round(length * density));
    this.drawing.resize(pixels(clientWidth), pixels(clientHeight));
    this.volumes.forEach((volume, i) => {
      if (volume.dirty) this.drawing.upload(volume);
      volume.dirty = false;
      const cell = this.cells[i], width = pixels(cell.width), height = pixels(cell.height);
      const bottom = pixels(clientHeight) - pixels(cell.top + cell.height);
      const view = { camera: this.cameras[i], cut: this.cut, look: this.look, pixel: cell.pixel * cell.width / width,
        foot: cell.foot * height / cell.height, density };
      const place = [cell.left ? pixels(cell.left) : 0, Math.max(0, bottom), width, height];
      this.drawing.draw(volume, place, view, { jitter: JITTER[pass], blend: 1 / (pass + 1), ...options });
    });
    if (!options.count) this.drawing.show();
    if (pass === 0) this.overlays();
    this.frames += 1;
  }

  // What lies over the picture, and the panel's inputs, which handles and keys move too.
  overlays() {
    $("panel").querySelectorAll(".row, .tick").forEach((row) => row.show && row.show());
    this.volumes.forEach((volume, i) => {
      const cell = this.cells[i], { host, bar, label, handles, legend, spot, level } = this.views[i];
      Object.assign(host.style, { left: `${cell.left}px`, top: `${cell.top}px`, width: `${cell.width}px`, height: `${cell.height}px` });
      const length = roundLength(cell.width / 4 * cell.pixel);
      bar.style.width = `${Math.round(length / cell.pixel)}px`;
      label.textContent = words(length, volume.unit);
      placeHandles(this, handles, volume, cell, this.cameras[i]);
      placeLegend(legend, volume);
      level.textContent = levelText(volume);
      const middle = this.focus.map((part, k) => part * volume.extent[k]);
      const [x, y] = project(middle, volume, basis(this.cameras[i]), this.cameras[i].pan, cell, cell.width, cell.height);
      spot.style.transform = `translate(${x}px, ${y}px)`;
    });
    this.tape.place();
  }

  // The picture with names and scale bars, as a PNG.
  async screenshot(save = true) {
    for (this.passes = 0; this.passes < this.passesAtRest;) this.pass();
    const { canvas } = this.drawing.gl, copy = make("canvas", { width: canvas.width, height: canvas.height });
    const pen = copy.getContext("2d"), density = canvas.width / $("stage").clientWidth;
    pen.drawImage(canvas, 0, 0);
    pen.scale(density, density);
    pen.fillStyle = getComputedStyle($("stage")).color;
    pen.font = "14px system-ui, sans-serif";
    this.cells.forEach((cell, i) => {
      const { bar, label } = this.views[i], left = cell.left + 16, foot = cell.top + cell.height - 16;
      pen.fillText(this.volumes[i].name, left, cell.top + 24);
      pen.fillText(label.textContent, left, foot - 10);
      pen.fillRect(left, foot - 4, parseFloat(bar.style.width), 4);
    });
    const blob = await new Promise((done) => { copy.toBlob(done, "image/png"); });
    if (save) {
      const link = make("a", { href: URL.createObjectURL(blob), download: `${PAGE.title.replace(/[^\w.-]+/g, "-")}.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }
    return blob;
  }

  // Milliseconds a frame, and samples of textures a pixel: what a machine has to do for it.
  measure({ frames = 3, skip = true, scale = 1 } = {}) {
    const { gl } = this.drawing, one = new Uint8Array(4);
    const wait = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one);
    this.paint(scale, 0, { skip });
    wait();
    const start = performance.now();
    for (let i = 0; i < frames; i++) { this.paint(scale, 0, { skip }); wait(); }
    const milliseconds = (performance.now() - start) / frames;
    this.paint(scale, 0, { skip, count: true });
    const all = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
    gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, all);
    let total = 0;
    for (let i = 0; i < all.length; i += 4) total += 256 * all[i] + all[i + 1];
    this.redraw();
    return { milliseconds, samples: total / (all.length / 4), pixels: all.length / 4 };
  }
}

function complain(text) {
  $("message").textContent = text;
  $("message").hidden = false;
}

async function start() {
  const volumes = [];
  for (const [i, about] of PAGE.volumes.entries()) {
    const [depth, height, width] = about.shape, channels = about.kind === "colour" ? 3 : 1;
    const packed = $(`voxels-${i}`), size = depth * height * width * channels;
    const voxels = packed ? await unpack(packed, size) : new Uint8Array(size);   // endless material is made later
    const sides = [width, height, depth], fields = [];
    for (const [j, field] of about.fields.entries()) {
      fields.push({ ...field, voxels: await unpack($(`field-${i}-${j}`), depth * height * width) });
    }
    about.phases.forEach((phase) => { phase.opacity = 1; });
    const lines = about.lines && { ...about.lines, shown: true, values: await unpackLines($(`lines-${i}`), about.lines) };
    volumes.push({ ...about, lines, voxels, sides, fields, extent: sides.map((side, k) => side * about.edges[k]), opacity: 1, dirty: true });
  }
  let drawing = null;
  try {
    drawing = new Drawing($("picture"));
    const longest = Math.max(...volumes.flatMap(({ shape }) => shape));
    if (longest > drawing.largest) throw new Error(`this browser draws volumes of up to ${drawing.largest} voxels a side, not ${longest}`);
  } catch (error) {
    drawing = null;
    complain(`${error.message}: here are the slices. The volume turns in a browser with WebGL 2, such as a recent Firefox, Chrome or Safari.`);
    document.body.classList.add("flat");
  }
  const app = new App(volumes, drawing, PAGE.endless ? await unpackWeights(PAGE.endless.model) : null);
  window.addEventListener("hashchange", () => {
    app.recall();
    app.panel();
    app.drawSlices();
    app.redraw();
    if (app.endless) app.endless.ask();
  });
  if (drawing) {
    listen(app, $("picture"));
    recover(app, $("picture"));
    new ResizeObserver(() => app.redraw()).observe($("stage"));
    $("shot").onclick = () => app.screenshot();
    $("turn").onclick = () => app.home();
    $("tape").onclick = () => app.measureBy(!app.measuring);
    app.paint(1, 0);
    app.redraw();
  }
  document.body.classList.add("ready");
  return app;
}

// A graphics card that is taken away may come back, with nothing on it.
function recover(app, canvas) {
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    complain("The graphics card was taken away. The volume comes back with it; the slices stay. If it does not, load the page again.");
  });
  canvas.addEventListener("webglcontextrestored", () => {
    app.drawing.start();
    app.volumes.forEach((volume) => Object.assign(volume, { dirty: true, textures: null }));
    $("message").hidden = true;
    app.redraw();
  });
}

window.trabecula = { ready: start() };
window.trabecula.ready.catch((error) => complain(`The page cannot be shown: ${error.message}`));
