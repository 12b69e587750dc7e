// The address remembers what was set by hand: words after "#", only those that differ from the page as it was made.
"use strict";

const inRange = (low, high) => (value) => Number.isFinite(value) && value >= low && value <= high;
const share = inRange(0, 1), byte = inRange(0, 255);
const asTexts = (values) => values.map((value) => String(Number(Number(value).toPrecision(5)))).join(",");

// Numbers of a text: as many as `checks`, each in its range; null where they are not.
function asNumbers(text, checks) {
  const found = text.split(",").map((part) => (part.trim() ? Number(part) : NaN));
  return found.length === checks.length && found.every((value, i) => checks[i](value)) ? found : null;
}

const CAMERA = [inRange(-180, 180), inRange(-90, 90), inRange(0.5, 16), inRange(-1e9, 1e9), inRange(-1e9, 1e9)];

// What is remembered: name, text of it, and how it is set; `set` returns whether the text says something.
function settings(app) {
  const { cut } = app;
  const numbers = (name, checks, get, set) => [name, () => asTexts(get()), (text) => {
    const found = asNumbers(text, checks);
    if (found) set(found);
    return Boolean(found);
  }];
  const word = (name, words, get, set) => [name, get, (text) => {
    const known = words().includes(text);
    if (known) set(text);
    return known;
  }];
  const flag = (name, get, set) => word(name, () => ["0", "1"], () => String(Number(get())), (text) => set(text === "1"));
  const all = [
    word("look", () => Object.keys(TABLE.looks), () => app.look, (name) => app.setLook(name, false)),
    word("volume", () => app.volumes.map((_, i) => String(i)), () => String(app.active), (i) => { app.active = Number(i); }),
    flag("linked", () => app.linked, (linked) => app.link(linked)),
    word("rest", () => ["sharp", "refined"], () => app.rest, (rest) => { app.rest = rest; }),
    word("cut", () => ["corner", "planes", "none"], () => cut.mode, (mode) => { cut.mode = mode; }),
    numbers("at", [share, share, share], () => cut.at, (at) => { cut.at = at; }),
    numbers("side", Array(3).fill((value) => Math.abs(value) === 1), () => cut.side, (side) => { cut.side = side; }),
    flag("free", () => cut.free, (free) => { cut.free = free; }),
    numbers("plane", [inRange(-180, 180), inRange(-90, 90), share], () => [cut.azimuth, cut.elevation, cut.offset],
      ([azimuth, elevation, offset]) => Object.assign(cut, { azimuth, elevation, offset })),
    numbers("slices", [share, share, share], () => app.focus, (focus) => { app.focus = focus; }),
  ];
  if (app.endless) {
    const { wanted } = app.endless, far = inRange(-(2 ** 30), 2 ** 30);
    const checks = [isSeed, (side) => SIDES.includes(side), inRange(-1, 1), ...Array(3).fill((at) => far(at) && at % CELLS === 0)];
    all.push(numbers("made", checks, () => [wanted.seed, wanted.side, wanted.porosity, ...wanted.corner],
      ([seed, side, porosity, ...corner]) => { Object.assign(wanted, { seed, side, porosity, corner }); app.endless.show(); }));
  }
  app.volumes.forEach((volume, i) => {
    const camera = () => app.cameras[i], phases = () => volume.phases;
    const sheer = () => (volume.kind === "labels" ? volume.phases : [volume]);
    all.push(
      numbers(`camera${i}`, CAMERA, () => [camera().azimuth, camera().elevation, camera().zoom, ...camera().pan],
        ([azimuth, elevation, zoom, ...pan]) => Object.assign(camera(), { azimuth, elevation, zoom, pan })),
      numbers(`opacity${i}`, sheer().map(() => inRange(0.05, 1)), () => sheer().map((of) => of.opacity),
        (given) => sheer().forEach((of, k) => { of.opacity = given[k]; })),
      ...(volume.lines ? [flag(`lines${i}`, () => volume.lines.shown, (shown) => { volume.lines.shown = shown; })] : []),
      numbers(`ramp${i}`, [byte, byte, byte, byte], () => [volume.low, volume.high, ...volume.window],
        ([low, high, ...window]) => Object.assign(volume, { low, high, window })),
      numbers(`shown${i}`, phases().map(() => share), () => phases().map((phase) => Number(phase.visible)),
        (shown) => phases().forEach((phase, k) => { phase.visible = shown[k] > 0; })),
      numbers(`colours${i}`, phases().flatMap(() => [byte, byte, byte]), () => phases().flatMap((phase) => phase.colour),
        (flat) => phases().forEach((phase, k) => { phase.colour = flat.slice(3 * k, 3 * k + 3); })),
      numbers(`finish${i}`, phases().flatMap(() => FINISH.map(([, most]) => inRange(0, most))),
        () => phases().flatMap((phase) => phase.finish),
        (flat) => phases().forEach((phase, k) => { phase.finish = flat.slice(4 * k, 4 * k + 4); })),
      word(`field${i}`, () => ["", ...volume.fields.map(({ name }) => name)], () => volume.fields[volume.field]?.name ?? "",
        (name) => { volume.field = volume.fields.findIndex((one) => one.name === name); }),
    );
  });
  return all;
}

const snapshot = (app) => new Map(settings(app).map(([name, get]) => [name, get()]));

// The text of the address: a look sets colours and finishes, so these are compared with that look's own.
function stateText(app) {
  const words = new URLSearchParams();
  for (const [name, get] of settings(app)) {
    const own = /^(colours|finish)/.test(name) ? app.ofLook.get(name) : app.atFirst.get(name);
    if (get() !== own) words.set(name, get());
  }
  return words.toString().replaceAll("%2C", ",");
}

// Set what a text says; names that say nothing here are returned.
function restore(app, text) {
  const given = new URLSearchParams(text), unknown = [...given.keys()];
  for (const [name, , set] of settings(app)) {
    if (given.has(name) && set(given.get(name))) unknown.splice(unknown.indexOf(name), 1);
  }
  app.volumes.forEach((volume) => { volume.dirty = true; });
  return unknown;
}

// Keep the address up to date; a frame of a notebook has none of its own.
function remember(app) {
  const text = stateText(app);
  if (text === app.remembered) return;
  app.remembered = text;
  try {
    history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
  } catch { /* in a sandbox */ }
}
