// Endless material: a volume that a worker makes in this page, and the panel that asks for it.
"use strict";

const SIDES = [32, 64, 96, 128];   // voxels of a box
const CELLS = 8;                   // voxels by which its corner moves

class Endless {
  // `about`: PAGE.endless, with `volume` (its number), `model`, `exemplar` (porosity, S2), `name`, `start` (seed, side).
  constructor(app, about, weights) {
    Object.assign(this, { app, about, busy: false, told: "", curve: null });
    this.wanted = { ...about.start, porosity: -1, corner: [0, 0, 0] };
    this.asked = null;
    this.build();
    const source = new Blob([$("worker").textContent], { type: "text/javascript" }), address = URL.createObjectURL(source);
    this.worker = new Worker(address);
    this.worker.onmessage = ({ data }) => this.receive(data);
    this.worker.onerror = (event) => this.fail(event.message || "the worker did not start");
    this.busy = true;
    this.worker.postMessage({ model: about.model, weights }, [weights.buffer]);
  }

  get volume() {
    return this.app.volumes[this.about.volume];
  }

  build() {
    const { wanted } = this, changed = () => this.ask();
    this.bar = make("progress", { max: 1, value: 0, "aria-label": "how much is made" });
    this.status = make("p", { role: "status", "aria-live": "polite", class: "made" });
    this.plot = make("canvas", { width: 560, height: 300, class: "curve", role: "img" });
    this.command = make("p", { class: "command" });
    const seed = make("input", { type: "number", name: "Seed", min: 0, max: Number.MAX_SAFE_INTEGER, step: 1 });
    seed.onchange = () => {
      if (isSeed(Number(seed.value))) wanted.seed = Number(seed.value);
      seed.value = wanted.seed;
      changed();
    };
    const row = Object.assign(make("label", { class: "row seed" }, make("span", {}, "Seed"), seed), { show: () => { seed.value = wanted.seed; } });
    const fresh = make("button", { type: "button", name: "new-seed", onclick: () => { wanted.seed = Math.floor(Math.random() * 1e9); this.show(); changed(); } }, "New seed");
    const next = make("button", { type: "button", name: "next-box", onclick: () => { wanted.corner[2] += wanted.side; changed(); } }, "Next box along x");
    const own = make("button", { type: "button", name: "own-porosity", onclick: () => { wanted.porosity = -1; this.show(); changed(); } }, "The model's own");
    const dial = slider("Porosity", { min: 0.02, max: 0.98, step: 0.01 },
      () => (wanted.porosity < 0 ? this.porosity ?? this.about.exemplar.porosity ?? 0.5 : wanted.porosity),
      (value) => { wanted.porosity = value; changed(); });
    const sides = SIDES.map((side) => [String(side), `${side} voxels a side`]);
    const size = choice("Box", sides, () => String(wanted.side), (value) => { wanted.side = Number(value); changed(); });
    this.rows = [row, dial, size];
    this.section = section("New material", row, make("div", { class: "phase" }, fresh, next), size, dial, own, this.bar, this.status, this.plot, this.command);
    this.show();
  }

  show() {
    this.rows.forEach((row) => row.show());
  }

  // Ask the worker for what is wanted: all of it, or only other labels of the field that it holds. What is asked while it works
  // waits; of several the last one counts.
  ask() {
    const { wanted, asked } = this;
    if (this.busy || this.broken) return;
    const field = `${wanted.seed} ${wanted.side} ${wanted.corner}`;
    if (asked && asked.field === field && asked.porosity === wanted.porosity) return;
    const make = asked && asked.field === field ? null : { seed: wanted.seed, side: wanted.side, corner: [...wanted.corner] };
    this.asked = { field, porosity: wanted.porosity, seed: wanted.seed, corner: [...wanted.corner] };
    this.busy = true;
    if (make) this.bar.value = 0;
    this.worker.postMessage({ make, porosity: wanted.porosity < 0 ? null : wanted.porosity });
  }

  receive({ done, labels, side, took, porosity, vectors, curve, idle, trouble }) {
    if (done !== undefined) this.bar.value = done;
    else if (labels) this.take(labels, side, porosity, `${(took / 1000).toFixed(1)} s, ${vectors ? "WebAssembly" : "JavaScript"}`);
    else if (curve) {
      this.curve = curve;
      this.draw();
    } else if (trouble) this.fail(trouble);
    else if (idle) {
      this.busy = false;
      this.ask();
    }
  }

  take(labels, side, porosity, how) {
    const { volume, app, asked, about } = this, sides = [side, side, side], { exemplar } = about;
    const other = volume.sides[0] !== side;
    Object.assign(volume, { voxels: labels, shape: sides, sides, extent: sides.map((length, k) => length * volume.edges[k]), counts: null, dirty: true });
    this.porosity = porosity;
    this.bar.value = 1;
    const reference = exemplar.porosity === null ? "" : ` (exemplar ${exemplar.porosity.toFixed(3)})`;
    this.status.textContent = `porosity ${porosity.toFixed(3)}${reference}; made in ${how}`;
    const shares = shareOf(labels, volume.phases.length);
    volume.phases.forEach((phase, label) => { phase.share = `${(100 * shares[label]).toFixed(1)}%`; });
    const length = (edge) => String(Number((edge * side).toPrecision(4)));
    volume.facts = [["Kind", "labels, made in this page"], ["Voxels", `${sides.join(" x ")} (z, y, x)`],
      ["Size", `${volume.edges.map(length).reverse().join(" x ")} ${volume.unit === "voxel" ? "voxels" : volume.unit}`],
      ["Phases", volume.phases.map(({ name, share }) => `${name} ${share}`).join(", ")],
      ["Made by", `gan ${about.name}, seed ${asked.seed}, from voxel ${asked.corner.join(", ")}`]];
    const box = asked.corner.map((low) => `(${low}, ${low + side})`).join(", ");
    this.command.textContent = asked.porosity < 0
      ? `In Python, the same voxels but for a few beside the threshold: tb.load_model("${about.name}").unmatched().window(${side}, [${box}], seed=${asked.seed})`
      : "The dial has moved the threshold: these voxels are of this page alone.";
    if (other) app.focus = [0.5, 0.5, 0.5];
    this.show();
    app.panel();
    app.drawSlices();
    app.redraw();
    remember(app);
  }

  fail(text) {
    this.broken = true;
    complain(`New material cannot be made here: ${text}.`);
  }

  // S2 against the distance, of the box and of the exemplar, which has at least its volume fraction and that squared.
  draw() {
    const { plot, curve, about: { exemplar }, volume } = this, pen = plot.getContext("2d"), { width, height } = plot;
    const style = getComputedStyle(document.documentElement), ink = (name) => style.getPropertyValue(name).trim();
    const left = 84, foot = height - 44, edge = Math.min(...volume.edges), right = width - 16;
    const far = (curve.length - 1) * edge, solid = exemplar.porosity === null ? null : 1 - exemplar.porosity;
    const top = 1.06 * Math.max(curve[0], solid ?? 0, ...(exemplar.s2 ?? []));
    const x = (r) => left + r / far * (right - left), y = (value) => foot - value / top * (foot - 14);
    const line = (points, colour, dash = []) => {
      Object.assign(pen, { strokeStyle: colour, lineWidth: 3 });
      pen.setLineDash(dash);
      pen.beginPath();
      points.forEach(([a, b], i) => (i ? pen.lineTo(x(a), y(b)) : pen.moveTo(x(a), y(b))));
      pen.stroke();
    };
    pen.clearRect(0, 0, width, height);
    line([[far, 0], [0, 0], [0, top]], ink("--line"));
    if (solid !== null) line([[0, solid ** 2], [far, solid ** 2]], ink("--soft"), [3, 9]);
    if (exemplar.s2) line(exemplar.s2.map((value, r) => [r * exemplar.step, value]).filter(([r]) => r <= far), ink("--soft"), [14, 7]);
    line(curve.map((value, r) => [r * edge, value]), ink("--accent"));
    Object.assign(pen, { fillStyle: ink("--ink"), font: "22px system-ui, sans-serif", textAlign: "right" });
    pen.setLineDash([]);
    pen.fillText(brief(curve[0]), left - 8, y(curve[0]) + 8);
    pen.fillText("0", left - 8, foot + 8);
    pen.fillText(words(Number(far.toPrecision(3)), volume.unit), right, height - 12);
    pen.fillText("S2, this box", right, 32);
    pen.fillStyle = ink("--soft");
    if (exemplar.s2) pen.fillText("dashed: exemplar", right, 60);
    if (solid !== null) pen.fillText(`dotted: exemplar's fraction squared`, right, exemplar.s2 ? 88 : 60);
    const at = Math.min(10, curve.length - 1);
    plot.setAttribute("aria-label", `two-point function of the solid: ${brief(curve[0])} at 0, ${brief(curve[at])} at ${at} voxels, `
      + `${brief(curve.at(-1))} at ${curve.length - 1} voxels`);
  }
}

// The weights of a model: all first bytes of its floats, all second ones and so on; and the steps of its table of quantiles.
async function unpackWeights(model) {
  const count = model.layers.reduce((sum, [out, channels, edge]) => sum + out * (channels * edge ** 3 + 1), 0);
  const planes = await unpack($("weights"), 4 * count), bytes = new Uint8Array(4 * count);
  for (let k = 0; k < 4; k++) for (let i = 0; i < count; i++) bytes[4 * i + k] = planes[k * count + i];
  const steps = new DataView((await unpack($("quantiles"), 1 << 16)).buffer);
  model.quantiles = Array.from({ length: 1 << 15 }, (_, i) => steps.getInt16(2 * i, true));
  return new Float32Array(bytes.buffer);
}

const isSeed = (value) => Number.isSafeInteger(value) && value >= 0;

function shareOf(labels, count) {
  const found = new Array(count).fill(0);
  for (let i = 0; i < labels.length; i++) found[labels[i]] += 1 / labels.length;
  return found;
}
