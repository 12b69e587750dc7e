// What lies under the pointer: where a ray meets the material, what is there, and how thick it is.
"use strict";

// Whether a point, in voxels (x, y, z), is cut away.
function isCut(point, made, stretch) {
  if (point.some((value, i) => value < made.keepLow[i] || value > made.keepHigh[i])) return true;
  if (point.every((value, i) => value > made.goneLow[i] && value < made.goneHigh[i])) return true;
  return dot(made.plane.slice(0, 3), point.map((value, i) => value * stretch[i])) > made.plane[3];
}

const indexOf = ({ sides: [width, height] }, [x, y, z]) => (z * height + y) * width + x;

// The label or grey of a voxel.
function valueAt(volume, voxel) {
  const at = indexOf(volume, voxel);
  if (volume.kind === "colour") return brightness(volume.voxels, 3 * at);
  return volume.kind === "labels" ? volume.voxels[at] & LABEL : volume.voxels[at];
}

// The first drawn voxel under a place of the picture (CSS pixels of the cell): { voxel, point (in the volume's unit) }.
function pick(volume, camera, cell, cut, x, y) {
  const { corner, right, down, direction } = rays(volume, basis(camera), camera.pan, cell, cell.width, cell.height);
  const origin = added(added(corner, scaled(right, x)), scaled(down, y)), table = drawnTable(volume);
  const made = cutOf(volume, cut), stretch = scaled(volume.edges, 1 / Math.min(...volume.edges));
  const [enter, leave] = boxSpan(origin, direction, volume.sides);
  for (let t = enter + 1e-3; t < leave; t += 0.25) {
    const point = added(origin, scaled(direction, t)), voxel = point.map(Math.floor);
    if (voxel.some((value, i) => value < 0 || value >= volume.sides[i])) continue;
    if (table[valueAt(volume, voxel)] < 128 || isCut(point, made, stretch)) continue;
    return { voxel, point: point.map((value, i) => value * volume.edges[i]) };
  }
  return null;
}

function boxSpan(origin, direction, sides) {
  let [enter, leave] = [0, Infinity];
  direction.forEach((rate, i) => {
    if (Math.abs(rate) < 1e-9) {
      if (origin[i] < 0 || origin[i] > sides[i]) leave = -1;
      return;
    }
    const ends = [-origin[i] / rate, (sides[i] - origin[i]) / rate];
    [enter, leave] = [Math.max(enter, Math.min(...ends)), Math.min(leave, Math.max(...ends))];
  });
  return [enter, leave];
}

// Squared distance of every voxel of a box to the nearest that is not inside, in squared smallest edges: an axis at a time.
function squaredDistances(inside, [nz, ny, nx], stretch) {
  const found = new Float32Array(inside.length).map((_, i) => (inside[i] ? Infinity : 0));
  for (const [step, length, edge] of [[1, nx, stretch[0]], [nx, ny, stretch[1]], [nx * ny, nz, stretch[2]]]) {
    const line = new Float32Array(length), weight = edge * edge;
    for (let start = 0; start < found.length; start++) {
      if (Math.floor(start / step) % length) continue;
      for (let i = 0; i < length; i++) line[i] = found[start + i * step];
      for (let i = 0; i < length; i++) {
        let best = line[i];
        for (let d = 1; weight * d * d < best && (i >= d || i + d < length); d++) {
          if (i >= d) best = Math.min(best, line[i - d] + weight * d * d);
          if (i + d < length) best = Math.min(best, line[i + d] + weight * d * d);
        }
        found[start + i * step] = best;
      }
    }
  }
  return found;
}

// Local thickness at a voxel (Hildebrand and Ruegsegger 1997), as measure.local_thickness has it: the diameter of the
// largest ball of its phase that holds it, less half a smallest edge. The box around it grows until it holds that ball for
// certain, which is where the ball's radius is below half the box's reach. Returns { length, least }: `least` where the
// box became too large, and the ball is at least so thick.
function thicknessAt(volume, voxel) {
  const smallest = Math.min(...volume.edges), stretch = scaled(volume.edges, 1 / smallest);
  const own = valueAt(volume, voxel), table = drawnTable(volume), drawn = table[own] >= 128;
  const belongs = (value) => (volume.kind === "labels" ? value === own : (table[value] >= 128) === drawn);
  for (let reach = 8; ; reach *= 2) {
    const low = voxel.map((value, i) => Math.max(0, value - Math.ceil(reach / stretch[i])));
    const high = voxel.map((value, i) => Math.min(volume.sides[i], value + Math.ceil(reach / stretch[i]) + 1));
    const [nx, ny, nz] = high.map((value, i) => value - low[i]);
    const inside = new Uint8Array(nx * ny * nz);
    for (let z = 0, i = 0; z < nz; z++) {
      for (let y = 0; y < ny; y++) {
        for (let x = 0; x < nx; x++, i++) inside[i] = belongs(valueAt(volume, [low[0] + x, low[1] + y, low[2] + z]));
      }
    }
    const squares = squaredDistances(inside, [nz, ny, nx], stretch);
    let most = 0;
    for (let z = 0, i = 0; z < nz; z++) {
      for (let y = 0; y < ny; y++) {
        for (let x = 0; x < nx; x++, i++) {
          if (squares[i] <= most) continue;
          const away = [low[0] + x, low[1] + y, low[2] + z].map((value, k) => (value - voxel[k]) * stretch[k]);
          if (dot(away, away) < squares[i]) most = squares[i];
        }
      }
    }
    const whole = low.every((value) => value === 0) && high.every((value, i) => value === volume.sides[i]);
    if (whole && most === Infinity) return null;  // nothing bounds it
    if (Math.sqrt(most) <= reach / 2 - 2 || whole) return { length: (2 * Math.sqrt(most) - 0.5) * smallest, least: false };
    if (reach >= 64) return { length: reach * smallest, least: true };
  }
}

// What is said of a voxel: phase or value, fields, local thickness, where it is in the image.
function readingOf(volume, voxel, { thick = true } = {}) {
  const at = indexOf(volume, voxel), value = valueAt(volume, voxel), said = [];
  if (volume.kind === "labels") said.push(`${volume.phases[value]?.name ?? "?"} (label ${value})`);
  else if (volume.kind === "colour") said.push(`colour ${[...volume.voxels.subarray(3 * at, 3 * at + 3)].join(", ")}`);
  else said.push(`value ${brief(volume.range[0] + value / 255 * (volume.range[1] - volume.range[0]))}`);
  if (volume.phases[value]?.visible) volume.fields.forEach((field) => said.push(fieldAt(field, at)));
  const found = thick && volume.kind !== "colour" ? thicknessAt(volume, voxel) : null;
  if (found) said.push(`local thickness ${found.least ? "more than " : ""}${words(Number(found.length.toPrecision(4)), volume.unit)}`);
  const place = voxel.map((index, i) => index * volume.block[2 - i]).reverse();
  const many = Math.max(...volume.block) > 1 ? `, of a block of ${volume.block.join(" x ")}` : "";
  return `${said.join(" · ")} · at z, y, x ${place.join(", ")}${many}`;
}

// A field is held between its limits: what is beyond is one of them.
function fieldAt({ name, limits: [low, high], voxels }, at) {
  const beyond = { 0: " or less", 255: " or more" }[voxels[at]] ?? "";
  return `${name} ${brief(low + voxels[at] / 255 * (high - low))}${beyond}`;
}

const brief = (value) => String(Number(value.toPrecision(3)));
