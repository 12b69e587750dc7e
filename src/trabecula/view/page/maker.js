// New material of a generator that was trained before: a field, from it labels with the porosity that is asked for, and what is
// measured of them. Without asking for one the labels are those that Python makes of the same seed.
"use strict";

const MARGIN = CELL / 2;   // voxels around the box in which specks are seen whole
const LAGS = 6144;         // over the voxels along an edge: lags of a distance that S2 is counted for

class Maker {
  // `model`: settings of the network, offsets, present, specks, void (the label of the pores), quantiles (of the upper half,
  // differences of neighbours).
  constructor(model, weights, options = {}) {
    this.model = model;
    this.network = new Network(model, weights, options);
    this.table = quantileTable(model.quantiles);
  }

  // The field of a box of side^3 voxels whose corner is a multiple of 8 voxels (z, y, x) away from the origin.
  make({ seed, side, corner }, tell = () => {}) {
    const { network, model } = this, more = model.specks ? 1 : 0, count = side / CELL + more, edge = CELL * count;
    const parts = Math.ceil(count / BLOCK_CELLS), cuts = [];
    for (let k = 0; k < parts; k++) cuts.push([Math.floor(k * count / parts), Math.floor((k + 1) * count / parts)]);
    const field = Array.from({ length: model.channels }, () => new Float32Array(edge ** 3));
    let done = 0;
    for (const z of cuts) for (const y of cuts) for (const x of cuts) {
      const first = [z, y, x].map(([low]) => low), cells = [z, y, x].map(([low, high]) => high - low);
      const part = network.field(seed, first.map((value, k) => value + corner[k] / CELL), cells, this.table, (share) => {
        done += share / parts ** 3;
        tell(done);
      });
      const [d, h, w] = cells.map((value) => CELL * value);
      field.forEach((whole, c) => {
        for (let i = 0; i < d * h; i++) {
          const row = ((CELL * first[0] + Math.floor(i / h)) * edge + CELL * first[1] + i % h) * edge + CELL * first[2];
          whole.set(part.subarray((c * d * h + i) * w, (c * d * h + i + 1) * w), row);
        }
      });
    }
    Object.assign(this, { field, edge, side, margin: model.specks ? MARGIN : 0 });
  }

  // The labels of the box, side^3, with a porosity (0..1), or the model's own where that is null.
  labels(porosity = null) {
    const { model } = this, offsets = Float32Array.from(model.offsets);
    if (porosity !== null) this.shiftTo(offsets, porosity);
    const all = this.decode(offsets);
    if (model.specks) clearSpecks(all, this.edge, model.specks);
    return this.inner(all);
  }

  // Move the offset of the pores until they are that share: their number rises with it.
  shiftTo(offsets, porosity) {
    const { present, void: pores } = this.model, two = present.length === 2, place = two ? 0 : present.indexOf(pores), own = offsets[place];
    const rising = two && present[1] === pores ? -1 : 1;
    let [low, high] = [-2.5, 2.5];
    for (let round = 0; round < 24; round++) {
      const shift = (low + high) / 2;
      offsets[place] = own + rising * shift;
      if (porosityOf(this.inner(this.decode(offsets)), pores) < porosity) low = shift; else high = shift;
    }
  }

  decode(offsets) {
    const { present } = this.model, { field } = this, labels = new Uint8Array(field[0].length), { fround } = Math;
    if (present.length === 2) {
      for (let i = 0; i < labels.length; i++) labels[i] = present[field[0][i] > offsets[0] ? 1 : 0];
      return labels;
    }
    for (let i = 0; i < labels.length; i++) {
      let best = fround(field[0][i] + offsets[0]), found = 0;
      for (let k = 1; k < present.length; k++) {
        const value = fround(field[k][i] + offsets[k]);
        if (value > best) [best, found] = [value, k];
      }
      labels[i] = present[found];
    }
    return labels;
  }

  inner(all) {
    const { edge, side, margin } = this;
    if (!margin) return all;
    const found = new Uint8Array(side ** 3);
    for (let z = 0; z < side; z++) {
      for (let y = 0; y < side; y++) {
        const at = ((z + margin) * edge + y + margin) * edge + margin;
        found.set(all.subarray(at, at + side), (z * side + y) * side);
      }
    }
    return found;
  }
}

// The quantiles of 65536 equal parts, of which the upper half is given by differences.
function quantileTable(steps) {
  const half = steps.length, table = new Int16Array(2 * half);
  for (let i = 0, value = 0; i < half; i++) {
    value += steps[i];
    table[half + i] = value;
    table[half - 1 - i] = -value;
  }
  return table;
}

function porosityOf(labels, pores) {
  let count = 0;
  for (let i = 0; i < labels.length; i++) if (labels[i] === pores) count += 1;
  return count / labels.length;
}

// Give components of at most most^3 voxels the label before their first voxel, as decode.remove_specks does: in place, but by the
// labels as they were.
function clearSpecks(labels, edge, most) {
  const before = labels.slice(), steps = [edge * edge, edge, 1], sides = [0, 1, 2, 3, 4, 5];
  for (let z = 1; z < edge - 1; z++) {
    for (let y = 1; y < edge - 1; y++) {
      for (let x = 1, at = (z * edge + y) * edge + 1; x < edge - 1; x++, at++) {
        const label = before[at];
        if (before[at - 1] === label || before[at - edge] === label || before[at - steps[0]] === label) continue;
        const speck = gather(before, edge, steps, sides, [z, y, x], most);
        for (const voxel of speck) labels[voxel] = before[at - 1];
      }
    }
  }
}

// The voxels of the component that begins at a voxel; none where it begins before, is larger, or meets the border.
function gather(labels, edge, steps, sides, first, most) {
  const index = ([z, y, x]) => (z * edge + y) * edge + x, start = index(first), label = labels[start];
  const [low, high, places, found] = [[...first], [...first], [first], [start]];
  for (let k = 0; k < places.length; k++) {
    for (const side of sides) {
      const axis = side >> 1, here = [...places[k]];
      here[axis] += side & 1 ? 1 : -1;
      if (here[axis] < 0 || here[axis] === edge) return [];
      const at = index(here);
      if (labels[at] !== label || found.includes(at)) continue;
      if (at < start) return [];
      low[axis] = Math.min(low[axis], here[axis]);
      high[axis] = Math.max(high[axis], here[axis]);
      if (high[axis] - low[axis] >= most) return [];
      places.push(here);
      found.push(at);
    }
  }
  return found;
}

// S2(r) of a phase for r = 0 .. most: the share of pairs that fit and have both ends in it, over lags whose length rounds to r; of
// many lags LAGS / side, evenly by their height over the sphere (a larger box has more pairs of each).
function radialTwoPoint(labels, side, inside, most) {
  // Rows end in zeros, as many as the longest lag, so that a lag along x shifts whole planes of bits.
  const words = Math.ceil((side + most) / 32), bits = new Uint32Array(side * side * words + 4);
  for (let row = 0, at = 0; row < side * side; row++) {
    for (let x = 0; x < side; x++, at++) if (inside(labels[at])) bits[row * words + (x >> 5)] |= 1 << (x & 31);
  }
  const shells = Array.from({ length: most + 1 }, () => []);
  for (let z = 0; z <= most; z++) {
    for (let y = z ? -most : 0; y <= most; y++) {
      for (let x = z || y ? -most : 0; x <= most; x++) {
        const r = Math.round(Math.hypot(z, y, x));
        if (r <= most) shells[r].push([z, y, x]);
      }
    }
  }
  return shells.map((lags) => {
    const few = Math.min(Math.round(LAGS / side), lags.length);
    let [pairs, fits] = [0, 0];
    for (let k = 0; k < few; k++) {
      const [z, y, x] = lags[Math.floor((k + 0.5) * lags.length / few)];
      const weight = (side - z) * (side - Math.abs(y)) * (side - Math.abs(x));
      pairs += countPairs(bits, side, words, [z, y, x]);
      fits += weight;
    }
    return pairs / fits;
  });
}

// Pairs of set bits a lag (z >= 0, y, x) apart.
function countPairs(bits, side, words, [dz, dy, dx]) {
  const skip = Math.abs(dx) >> 5, shift = Math.abs(dx) & 31, up = 32 - shift, rows = side - Math.abs(dy);
  let count = 0;
  for (let z = 0; z + dz < side; z++) {
    const here = (z * side + Math.max(0, -dy)) * words, there = ((z + dz) * side + Math.max(0, dy)) * words;
    // What is shifted lies to the right.
    const fixed = dx < 0 ? there : here, moved = (dx < 0 ? here : there) + skip, end = rows * words - skip;
    for (let k = 0; k < end; k++) {
      let both = bits[fixed + k];
      if (both === 0) continue;
      both &= shift === 0 ? bits[moved + k] : (bits[moved + k] >>> shift) | (bits[moved + k + 1] << up);
      both -= (both >>> 1) & 0x55555555;
      both = (both & 0x33333333) + ((both >>> 2) & 0x33333333);
      count += Math.imul((both + (both >>> 4)) & 0x0f0f0f0f, 0x01010101) >>> 24;
    }
  }
  return count;
}
