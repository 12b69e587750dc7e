// Voxels: unpacking, what is drawn of them (0..255 a voxel), and how far the nearest surface is.
"use strict";

function decoded(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

// The voxels of a volume, from gzip in base64; in pieces, so that a tab never holds them twice over.
async function unpack(element, size) {
  const text = element.textContent, piece = 1 << 18, gunzip = new DecompressionStream("gzip");
  element.remove();
  const voxels = new Uint8Array(size);
  let filled = 0;
  const feed = async () => {
    const writer = gunzip.writable.getWriter();
    for (let at = 0; at < text.length; at += piece) await writer.write(decoded(text.slice(at, at + piece)));
    await writer.close();
  };
  const drain = async () => {
    const reader = gunzip.readable.getReader();
    for (let next = await reader.read(); !next.done; next = await reader.read()) {
      voxels.set(next.value, filled);
      filled += next.value.length;
    }
  };
  await Promise.all([feed(), drain()]);
  if (filled !== size) throw new Error(`the page is damaged: ${filled} of ${size} bytes`);
  return voxels;
}

// Points of lines: all x, all y, all z in parts of a voxel, all speeds.
async function unpackLines(element, { points }) {
  const count = 4 * points.reduce((sum, many) => sum + many, 0), bytes = new DataView((await unpack(element, 2 * count)).buffer);
  return Uint16Array.from({ length: count }, (_, k) => bytes.getUint16(2 * k, true));
}

// Of a byte of labels the last bit says that the voxel is a block which only a thin wall makes drawn (joining.py).
const LABEL = 127;

// How much is drawn of a voxel of that value: visible phases, or a ramp of greys.
function drawnTable({ kind, phases, low, high }) {
  const table = new Uint8Array(256);
  for (let v = 0; v < 256; v++) {
    if (kind === "labels") table[v] = phases[v & LABEL]?.visible ? 255 : 0;
    else if (high > low) table[v] = Math.round(255 * Math.min(1, Math.max(0, (v - low) / (high - low))));
    else table[v] = v >= low ? 255 : 0;
  }
  return table;
}

const isVeil = ({ phases }, value) => Boolean(phases[value & LABEL]?.visible) && phases[value & LABEL].opacity < 1;

// The same of what has a surface: of labels without the translucent phases, where others are opaque.
function surfaceTable(volume) {
  const table = drawnTable(volume);
  return volume.veiled ? table.map((drawn, value) => (isVeil(volume, value) ? 0 : drawn)) : table;
}

// The field of one slice across z. Labels are blurred as blur_axis does for stills, so that no staircase is left: along z
// from the voxels, then y, then x, with weights that sum to 256. A slice at a time, since a copy of all would not fit.
// Blocks with a thin wall stay full: a tilted wall of one voxel would blur into holes.
function fieldSlice({ voxels, shape: [depth, height, width], kind }, table, z, out, other) {
  const size = height * width, start = z * size;
  if (kind === "colour") {
    for (let i = 0, j = 3 * start; i < size; i++, j += 3) out[i] = table[brightness(voxels, j)];
    return;
  }
  if (kind === "grey") {
    for (let i = 0; i < size; i++) out[i] = table[voxels[start + i]];
    return;
  }
  const [w0, w1, w2] = TABLE.blur, inside = (at, count) => Math.min(Math.max(at, 0), count - 1);
  const [a, b, c, d, e] = [-2, -1, 0, 1, 2].map((shift) => inside(z + shift, depth) * size);
  for (let i = 0; i < size; i++) {
    out[i] = (128 + w0 * (table[voxels[a + i]] + table[voxels[e + i]]) + w1 * (table[voxels[b + i]] + table[voxels[d + i]])
      + w2 * table[voxels[c + i]]) >> 8;
  }
  for (let y = 0; y < height; y++) {
    const [f, g, h, k, l] = [-2, -1, 0, 1, 2].map((shift) => inside(y + shift, height) * width);
    for (let x = 0, to = y * width; x < width; x++, to++) {
      other[to] = (128 + w0 * (out[f + x] + out[l + x]) + w1 * (out[g + x] + out[k + x]) + w2 * out[h + x]) >> 8;
    }
  }
  for (let y = 0; y < height; y++) {
    const row = y * width;
    for (let x = 0; x < width; x++) {
      const near = row + (x > 0 ? x - 1 : 0), far = row + (x > 1 ? x - 2 : 0);
      const next = row + (x < width - 1 ? x + 1 : x), last = row + Math.min(x + 2, width - 1);
      out[row + x] = (128 + w0 * (other[far] + other[last]) + w1 * (other[near] + other[next]) + w2 * other[row + x]) >> 8;
    }
  }
  for (let i = 0; i < size; i++) if (voxels[start + i] > LABEL && table[voxels[start + i]]) out[i] = 255;
}

function brightness(voxels, at) {
  return (voxels[at] * 77 + voxels[at + 1] * 151 + voxels[at + 2] * 28) >> 8;
}

// A slice of labels in which hidden voxels beside drawn ones take theirs: blurring may move a surface by half a voxel.
// `values` are what is spread: the labels themselves, or a field.
function spreadSlice(volume, values, z, out) {
  const { voxels, shape: [depth, height, width] } = volume, seen = surfaceTable(volume), size = height * width, start = z * size;
  const mask = values === voxels ? LABEL : 255;
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      const at = start + i;
      let from = at;
      if (!seen[voxels[at]]) {
        if (z > 0 && seen[voxels[at - size]]) from = at - size;
        else if (z < depth - 1 && seen[voxels[at + size]]) from = at + size;
        else if (y > 0 && seen[voxels[at - width]]) from = at - width;
        else if (y < height - 1 && seen[voxels[at + width]]) from = at + width;
        else if (x > 0 && seen[voxels[at - 1]]) from = at - 1;
        else if (x < width - 1 && seen[voxels[at + 1]]) from = at + 1;
      }
      out[i] = values[from] & mask;
    }
  }
}

// For blocks of voxels: 0 where a surface can be, else how many blocks away (largest of the three axes) the nearest is.
class Blocks {
  constructor(shape) {
    this.size = shape.map((side) => Math.ceil(side / TABLE.block));
    this.away = new Uint8Array(this.size[0] * this.size[1] * this.size[2]).fill(255);
  }

  copy() {
    return Object.assign(Object.create(Blocks.prototype), { size: this.size, away: this.away.slice() });
  }

  // A point of a block reads its voxels and one more to each side: so a voxel counts for the blocks beside it too.
  reach(at, axis, { low = [0, 0, 0], fine = 1 }) {
    const edge = TABLE.block * fine, place = low[2 - axis] * fine + at;
    return [Math.max(0, Math.floor((place - 1) / edge)), Math.min(this.size[axis] - 1, Math.floor((place + 1) / edge))];
  }

  // Mark where a slice holds more than `least`; of a box of finer voxels, which begins at `low` (x, y, z).
  add(slice, z, [, height, width], least, place = {}) {
    const [, ny, nx] = this.size, [z0, z1] = this.reach(z, 0, place);
    const across = Array.from({ length: width }, (_, x) => this.reach(x, 2, place));
    for (let y = 0, i = 0; y < height; y++) {
      const [y0, y1] = this.reach(y, 1, place);
      for (let x = 0; x < width; x++, i++) {
        if (slice[i] <= least) continue;
        const [x0, x1] = across[x];
        for (let k = z0; k <= z1; k++) {
          for (let j = y0; j <= y1; j++) {
            const row = (k * ny + j) * nx;
            this.away[row + x0] = 0;
            this.away[row + x1] = 0;
          }
        }
      }
    }
  }

  measured() {
    const [nz, ny, nx] = this.size;
    for (const [step, length] of [[1, nx], [nx, ny], [nx * ny, nz]]) alongAxis(this.away, step, length);
    return this.away;
  }
}

// The distance by the largest axis is found an axis at a time: the least, over a line, of max(steps, what is there).
function alongAxis(away, step, length) {
  const line = new Uint8Array(length);
  for (let start = 0; start < away.length; start++) {
    if (Math.floor(start / step) % length) continue;
    for (let i = 0; i < length; i++) line[i] = away[start + i * step];
    for (let i = 0; i < length; i++) {
      let best = line[i];
      for (let d = 1; d < best && (i - d >= 0 || i + d < length); d++) {
        if (i - d >= 0) best = Math.min(best, Math.max(d, line[i - d]));
        if (i + d < length) best = Math.min(best, Math.max(d, line[i + d]));
      }
      away[start + i * step] = best;
    }
  }
}

function histogram({ voxels, kind }) {
  const counts = new Float64Array(256);
  if (kind === "colour") for (let i = 0; i < voxels.length; i += 3) counts[brightness(voxels, i)] += 1;
  else for (let i = 0; i < voxels.length; i++) counts[voxels[i]] += 1;
  return counts;
}
