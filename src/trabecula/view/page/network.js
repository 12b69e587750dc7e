// The sub-pixel generator of `gan` (synth/gan/networks.py): convolutions without padding, every second one followed by a step
// that makes eight channels a 2^3 cell. Arrays are (channels, Z, Y, X).
"use strict";

const HALO = 3, CELL = 8;
const BLOCK_CELLS = 9;   // cells along an edge of what is made at once
const SLOPE = Math.fround(0.2);
const grouped = (count) => Math.ceil(count / GROUP) * GROUP;

class Network {
  // `settings`: latent, fractions (null, or what is drawn beside the noise), layers ([output, input, edge] each), blurs, channels; `weights`: those of all layers, each after its bias.
  constructor(settings, weights, options = {}) {
    Object.assign(this, settings);
    const edge = BLOCK_CELLS, sides = this.sidesOf([edge, edge, edge]);
    const planes = sides.map(([a, b, c], i) => (a * b * c + 2 * b * c) * (this.layers[i]?.[1] ?? 8 * this.channels));
    const most = Math.max(...planes), outputs = Math.max(...this.layers.map(([out], i) => grouped(out) * (sides[i][0] * sides[i][1] * sides[i][2] + LANES)));
    this.convolver = new Convolver(4 * (most + outputs + this.layers.reduce((sum, [out, channels, edge3]) => sum + grouped(out) * (channels * edge3 ** 3 + 1), 0) + 65536), options);
    this.input = this.convolver.take(most + 1024);
    this.output = this.convolver.take(outputs);
    this.offsets = this.convolver.take(Math.max(...this.layers.map(([, channels, edge3]) => channels * edge3 ** 3)));
    let at = 0;
    this.places = this.layers.map(([out, channels, side]) => {
      const taps = channels * side ** 3, bias = this.convolver.take(grouped(out)), kernel = this.convolver.take(grouped(out) * taps);
      this.convolver.floats.set(weights.subarray(at, at + out), bias / 4);
      at += out;
      // Four channels of the output lie beside each other, as the kernel reads them.
      for (let o = 0; o < out; o++) {
        const first = kernel / 4 + (o - o % GROUP) * taps + o % GROUP;
        for (let k = 0; k < taps; k++) this.convolver.floats[first + GROUP * k] = weights[at + o * taps + k];
      }
      at += out * taps;
      return { bias, kernel };
    });
  }

  // Sides of the input of every layer, and of the output, for so many cells.
  sidesOf(cells) {
    let sides = cells.map((side) => side + 2 * HALO);
    const found = [sides];
    this.layers.forEach(([, , edge], i) => {
      sides = sides.map((side) => (side - edge + 1) * (i % 2 ? 2 : 1));
      found.push(sides);
    });
    return found;
  }

  // Products of a layer, over all of them: for the progress.
  shares(cells) {
    const sides = this.sidesOf(cells);
    const products = this.layers.map(([out, channels, edge], i) => out * channels * edge ** 3 * sides[i][0] * sides[i][1] * sides[i][2]);
    const all = products.reduce((a, b) => a + b, 0);
    return products.map((product) => product / all);
  }

  // The field of cells of a seed from a corner (z, y, x) on: (channels, 8 Z, 8 Y, 8 X) float32, -1..1.
  field(seed, corner, cells, table, tell = () => {}) {
    const { floats } = this.convolver, sides = this.sidesOf(cells), shares = this.shares(cells), first = corner.map((value) => value - HALO);
    const input = floats.subarray(this.input / 4);
    normalCells(input, this.latent, sides[0], seedKey(seed, "gan/latent"), first, table);
    if (this.fractions) {
      const drawn = localFractions(this.fractions, sides[0], seedKey(seed, "gan/fractions"), first, table);
      input.set(drawn, this.latent * sides[0][0] * sides[0][1] * sides[0][2]);
    }
    this.layers.forEach((layer, i) => {
      this.convolve(i, sides[i]);
      this.settle(i, sides[i]);
      tell(shares[i]);
    });
    return this.finish(sides.at(-1), cells);
  }

  // A layer on the planes of the input: sums of whole planes in a row, of which the last rows and columns are thrown away.
  convolve(i, [depth, height, width]) {
    const [out, channels, edge] = this.layers[i], { kernel, bias } = this.places[i], { convolver } = this;
    const size = depth * height * width, plane = height * width, count = (depth - edge + 1) * plane;
    let at = this.offsets / 4;
    for (let c = 0; c < channels; c++) {
      for (let z = 0; z < edge; z++) {
        for (let y = 0; y < edge; y++) {
          for (let x = 0; x < edge; x++) convolver.whole[at++] = 4 * (c * size + z * plane + y * width + x);
        }
      }
    }
    const bytes = Math.ceil(count / LANES) * LANES * 4;
    for (let o = 0; o < out; o += GROUP) {
      convolver.kernel(this.input, this.offsets, 4 * at, kernel + 4 * o * channels * edge ** 3, bias + 4 * o, this.output + o * bytes, bytes, bytes);
    }
    this.stride = bytes / 4;
  }

  // From sums to the next input: leaky ReLU but after the last layer, and 2^3 cells after every second one.
  settle(i, [depth, height, width]) {
    const [out, , edge] = this.layers[i], { floats } = this.convolver, last = i === this.layers.length - 1;
    const [d, h, w] = [depth, height, width].map((side) => side - edge + 1), step = i % 2 ? 2 : 1, cells = step ** 3, kinds = out / cells;
    const from = this.output / 4, to = this.input / 4, size = d * h * w * cells;
    for (let o = 0; o < out; o++) {
      const place = Math.floor(o / kinds), [dz, dy, dx] = [place >> 2, (place >> 1) & 1, place & 1];
      for (let z = 0; z < d; z++) {
        for (let y = 0; y < h; y++) {
          let source = from + o * this.stride + (z * height + y) * width;
          let target = to + o % kinds * size + ((z * step + dz) * h * step + y * step + dy) * w * step + dx;
          for (let x = 0; x < w; x++, source++, target += step) {
            const value = floats[source];
            floats[target] = value < 0 && !last ? value * SLOPE : value;
          }
        }
      }
    }
  }

  // Blurs of 1 2 1 along every axis, the middle, and tanh.
  finish(sides, cells) {
    const { floats } = this.convolver, start = this.input / 4, size = sides[0] * sides[1] * sides[2], made = cells.map((side) => CELL * side);
    const found = new Float32Array(this.channels * made[0] * made[1] * made[2]);
    for (let c = 0, to = 0; c < this.channels; c++) {
      let [part, here] = [floats.slice(start + c * size, start + (c + 1) * size), sides];
      for (let k = 0; k < 3 * this.blurs; k++) [part, here] = blurred(part, here, k % 3);
      const [z0, y0, x0] = here.map((side, k) => (side - made[k]) >> 1);
      for (let z = 0; z < made[0]; z++) {
        for (let y = 0; y < made[1]; y++) {
          let at = ((z0 + z) * here[1] + y0 + y) * here[2] + x0;
          for (let x = 0; x < made[2]; x++, to++, at++) found[to] = Math.tanh(part[at]);
        }
      }
    }
    return found;
  }
}

// The local fractions that the generator is given beside the noise (synth/gan/local_fractions.py), of cells from a corner on:
// (K, Z, Y, X). Noise and filter are whole numbers, so that their sums are exact.
function localFractions({ filter, mixing, normal, levels }, sides, key, corner, table) {
  const edge = Math.round(Math.cbrt(filter.length)), reach = (edge - 1) / 2, wide = sides.map((side) => side + 2 * reach);
  const [depth, height, width] = sides, size = depth * height * width, around = wide[0] * wide[1] * wide[2], count = mixing.length;
  const noise = new Float32Array(count * around), found = new Float32Array(count * size);
  normalCells(noise, count, wide, key, corner.map((value) => value - reach), table);
  const scale = 1 / (4096 * Math.sqrt(filter.reduce((sum, weight) => sum + weight * weight, 0)));
  const fields = mixing.map((_, c) => {
    const sums = new Float64Array(size), whole = Float64Array.from(noise.subarray(c * around, (c + 1) * around), (value) => 4096 * value);
    for (let k = 0; k < filter.length; k++) {
      const weight = filter[k], dz = Math.floor(k / (edge * edge)), dy = Math.floor(k / edge) % edge, dx = k % edge;
      if (weight === 0) continue;
      for (let z = 0, at = 0; z < depth; z++) {
        for (let y = 0; y < height; y++) {
          let from = ((z + dz) * wide[1] + y + dy) * wide[2] + dx;
          for (let x = 0; x < width; x++) sums[at++] += weight * whole[from++];
        }
      }
    }
    return sums.map((sum) => sum * scale);
  });
  mixing.forEach((row, c) => {
    for (let i = 0; i < size; i++) {
      let value = 0;
      for (let k = 0; k <= c; k++) value += row[k] * fields[k][i];
      found[c * size + i] = interpolated(value, normal, levels[c]);
    }
  });
  return found;
}

// The value at x of a line through points (rising `from`, `to`), constant beyond its ends.
function interpolated(x, from, to) {
  const last = from.length - 1;
  if (x <= from[0]) return to[0];
  if (x >= from[last]) return to[last];
  let [low, high] = [0, last];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (from[middle] <= x) low = middle; else high = middle;
  }
  return (to[high] - to[low]) / (from[high] - from[low]) * (x - from[low]) + to[low];
}

// The mean with weights 1 2 1 along an axis, which loses a voxel at each end; sums are rounded as in Python.
function blurred(values, sides, axis) {
  const made = sides.map((side, k) => (k === axis ? side - 2 : side)), found = new Float32Array(made[0] * made[1] * made[2]);
  const step = [sides[1] * sides[2], sides[2], 1][axis], { fround } = Math;
  for (let z = 0, to = 0; z < made[0]; z++) {
    for (let y = 0; y < made[1]; y++) {
      let at = (z * sides[1] + y) * sides[2];
      for (let x = 0; x < made[2]; x++, to++, at++) {
        found[to] = fround(0.25 * fround(values[at] + values[at + 2 * step])) + fround(0.5 * values[at + step]);
      }
    }
  }
  return [found, made];
}
