// The page: its state, when it draws, and what tests and notebooks may ask it.
"use strict";

const HOME = { azimuth: 32, elevation: 26, zoom: 1, pan: [0, 0] };
const JITTER = [[-0.25, -0.25], [0.25, 0.25], [0.25, -0.25], [-0.25, 0.25]];
const $ = (id) => document.getElementById(id);

class App {
  constructor(volumes, drawing) {
    Object.assign(this, { volumes, drawing, look: PAGE.look, active: 0, linked: true, frames: 0, passes: 0 });
    this.cut = { mode: "corner", at: [0.5, 0.5, 0.5], side: [1, -1, 1], free: false, azimuth: 85, elevation: 12, offset: 0.5 };
    this.homeAngles = { ...HOME };
    this.cameras = volumes.map(() => null);
    this.moved = -Infinity;
    this.dragScale = 0.5;
    this.link(true);
    this.setLook(this.look, false);
    this.cut.at = [0, 1, 2].map((axis) => {
      const side = volumes[0].sides[axis];
      return side > 1 ? Math.floor(side / 2) / side : 0.5;
    });
    this.views = volumes.map((volume) => this.overlay(volume));
    this.slices = slicePanels($("slices"));
    this.choose(0, true);
  }

  overlay(volume) {
    const bar = make("div", { class: "bar" }), label = make("div", { class: "length" }), handles = make("div");
    const host = make("div", { class: "view" }, make("div", { class: "name" }, volume.name), handles, label, bar);
    $("views").append(host);
    return { host, bar, label, handles };
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
    this.slices.forEach((one) => one.show(this.volumes[index]));
    this.panel();
  }

  panel() {
    const volume = this.volumes[this.active], several = this.volumes.length > 1;
    const names = this.volumes.map(({ name }, i) => [String(i), name]);
    const which = several ? [choice("Volume", names, () => String(this.active), (value) => this.choose(Number(value)))] : [];
    const drawn = this.drawing ? [section("Look and material", ...lookControls(this), ...materialControls(this, volume)),
      section("Cut", ...cutControls(this)), section("Camera", ...cameraControls(this))] : [];
    const open = [...$("panel").querySelectorAll("details")].map((each) => each.open);
    $("panel").replaceChildren(...which, section("Figures", ...facts(volume)), ...drawn);
    $("panel").querySelectorAll("details").forEach((each, i) => { each.open = open[i] ?? i < 3; });
  }

  drawSlices() {
    this.slices.forEach((one) => one.draw(this.volumes[this.active]));
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

  // A coarse picture while things move, then a sharp one, refined by three more with rays between its rays.
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
    this.paint(1, this.passes);
    this.passes += 1;
    if (this.passes < JITTER.length) this.schedule();
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
        foot: cell.foot * height / cell.height };
      const place = [cell.left ? pixels(cell.left) : 0, Math.max(0, bottom), width, height];
      this.drawing.draw(volume, place, view, { jitter: JITTER[pass], blend: 1 / (pass + 1), ...options });
    });
    if (pass === 0) this.overlays();
    this.frames += 1;
  }

  // What lies over the picture, and the panel's inputs, which handles and keys move too.
  overlays() {
    $("panel").querySelectorAll(".row, .tick").forEach((row) => row.show && row.show());
    this.volumes.forEach((volume, i) => {
      const cell = this.cells[i], { host, bar, label, handles } = this.views[i];
      Object.assign(host.style, { left: `${cell.left}px`, top: `${cell.top}px`, width: `${cell.width}px`, height: `${cell.height}px` });
      const length = roundLength(cell.width / 4 * cell.pixel);
      bar.style.width = `${Math.round(length / cell.pixel)}px`;
      label.textContent = words(length, volume.unit);
      placeHandles(this, handles, volume, cell, this.cameras[i]);
    });
  }

  // The picture with names and scale bars, as a PNG.
  async screenshot(save = true) {
    for (this.passes = 0; this.passes < JITTER.length; this.passes++) this.paint(1, this.passes);
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
    const voxels = await unpack($(`voxels-${i}`), depth * height * width * channels);
    const sides = [width, height, depth];
    volumes.push({ ...about, voxels, sides, extent: sides.map((side, k) => side * about.edges[k]), opacity: 1, dirty: true });
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
  const app = new App(volumes, drawing);
  if (drawing) {
    listen(app, $("picture"));
    $("picture").addEventListener("webglcontextlost", () => complain("The graphics card was taken away: load the page again."));
    new ResizeObserver(() => app.redraw()).observe($("stage"));
    $("shot").onclick = () => app.screenshot();
    $("turn").onclick = () => app.home();
    app.paint(1, 0);
    app.redraw();
  }
  document.body.classList.add("ready");
  return app;
}

window.trabecula = { ready: start() };
window.trabecula.ready.catch((error) => complain(`The page cannot be shown: ${error.message}`));
