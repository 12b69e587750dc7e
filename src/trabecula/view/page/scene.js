// Geometry: the camera, what is cut away, lengths and colours. Vectors are [x, y, z].
"use strict";

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const scaled = (a, factor) => a.map((value) => value * factor);
const added = (a, b) => a.map((value, i) => value + b[i]);
const divided = (a, b) => a.map((value, i) => value / b[i]);
const unit = (a) => scaled(a, 1 / Math.hypot(...a));

// To a viewer at that azimuth and elevation, degrees.
function direction(azimuth, elevation) {
  const turn = azimuth * Math.PI / 180, lift = elevation * Math.PI / 180;
  return [Math.sin(turn) * Math.cos(lift), -Math.cos(turn) * Math.cos(lift), Math.sin(lift)];
}

function basis({ azimuth, elevation }) {
  const turn = azimuth * Math.PI / 180;
  const right = [Math.cos(turn), Math.sin(turn), 0], viewer = direction(azimuth, elevation);
  const up = [viewer[1] * right[2] - viewer[2] * right[1], viewer[2] * right[0] - viewer[0] * right[2],
    viewer[0] * right[1] - viewer[1] * right[0]];
  return { right, up, viewer };
}

const letters = (height) => Math.max(12, Math.floor(height / 32));
const barHeight = (size) => size + Math.floor(size / 3) + Math.max(2, Math.floor(size / 4));

// What a picture of that size leaves free, as a still does: all round, and at the foot for the scale bar.
function frame(width, height) {
  return { margin: Math.max(8, Math.floor(Math.min(width, height) / 24)), foot: barHeight(letters(height)) };
}

// Edge of a pixel with which the box fills a picture.
function fit(extent, { right, up }, width, height) {
  const { margin, foot } = frame(width, height);
  const across = dot(extent, right.map(Math.abs)), tall = dot(extent, up.map(Math.abs));
  return Math.max(across / Math.max(width - 2 * margin, 1), tall / Math.max(height - 2 * margin - foot, 1));
}

// Rays of a picture: the middle of the upper left pixel, steps right and down, direction; in voxels.
function rays(volume, { right, up, viewer }, pan, { pixel, foot }, width, height) {
  const { edges, extent } = volume;
  const centre = added(scaled(extent, 0.5), added(scaled(right, -pan[0]), scaled(up, -pan[1])));
  const far = added(centre, scaled(viewer, Math.hypot(...extent)));
  const corner = added(far, added(scaled(right, -(width - 1) / 2 * pixel), scaled(up, (height - foot - 1) / 2 * pixel)));
  return {
    corner: divided(corner, edges),
    right: divided(scaled(right, pixel), edges),
    down: divided(scaled(up, -pixel), edges),
    direction: divided(scaled(viewer, -Math.min(...edges)), edges),
  };
}

// Where a point of the volume (in its unit) is in the picture, pixels from the upper left.
function project(point, volume, { right, up }, pan, { pixel, foot }, width, height) {
  const offset = added(point, scaled(volume.extent, -0.5));
  return [(width - 1) / 2 + (dot(offset, right) + pan[0]) / pixel,
    (height - foot - 1) / 2 - (dot(offset, up) + pan[1]) / pixel];
}

// Height of the free plane along its normal, in the volume's unit: a share of the box along it.
function planeOffset(extent, normal, at) {
  return dot(normal, extent) / 2 + (at - 0.5) * dot(extent, normal.map(Math.abs));
}

// What is kept, what is taken out of it, and the free plane; in voxels and (the plane) in smallest voxel edges.
function cutOf(volume, cut) {
  const sides = volume.sides, away = [-2, -2, -2];
  const made = { keepLow: [0, 0, 0], keepHigh: sides.slice(), goneLow: away, goneHigh: [-1, -1, -1], plane: [0, 0, 0, 1] };
  const at = sides.map((side, i) => cut.at[i] * side);
  if (cut.mode === "planes") {
    at.forEach((value, i) => { made[cut.side[i] > 0 ? "keepHigh" : "keepLow"][i] = value; });
  } else if (cut.mode === "corner" && Math.min(...sides) > 1) {
    made.goneLow = at.map((value, i) => (cut.side[i] > 0 ? value : -1));
    made.goneHigh = at.map((value, i) => (cut.side[i] > 0 ? sides[i] + 1 : value));
  }
  if (cut.free) {
    const normal = direction(cut.azimuth, cut.elevation);
    made.plane = [...normal, planeOffset(volume.extent, normal, cut.offset) / Math.min(...volume.edges)];
  }
  return made;
}

// Middles of the cut faces and their normals, in the volume's unit: where a plane is taken hold of.
function grips(volume, cut) {
  const { extent } = volume, found = [];
  const at = extent.map((side, i) => cut.at[i] * side);
  if (cut.mode !== "none") {
    for (let axis = 0; axis < 3; axis++) {
      const point = extent.map((side, i) => {
        if (i === axis) return at[i];
        const beyond = cut.mode === "corner" === cut.side[i] > 0;
        return beyond ? (at[i] + side) / 2 : at[i] / 2;
      });
      found.push({ name: "xyz"[axis], axis, point, normal: [0, 1, 2].map((i) => (i === axis ? 1 : 0)), length: extent[axis] });
    }
  }
  if (cut.free) {
    const normal = direction(cut.azimuth, cut.elevation), height = planeOffset(extent, normal, cut.offset);
    const length = dot(extent, normal.map(Math.abs));
    const point = added(scaled(extent, 0.5), scaled(normal, height - dot(normal, extent) / 2));
    found.push({ name: "plane", axis: 3, point, normal, length });
    found.push({ name: "tilt", axis: 4, point: added(point, scaled(normal, 0.25 * length)), normal, length: 0.25 * length });
  }
  return found;
}

// The largest of 1, 2, 5 times a power of ten that is not above `limit`, and its words.
function roundLength(limit) {
  const power = 10 ** Math.floor(Math.log10(limit));
  return Math.max(...[1, 2, 5].map((step) => step * power).filter((length) => length <= limit * (1 + 1e-9)));
}

function words(length, unitName) {
  const next = { nm: "um", um: "mm", m: "km" }[unitName];
  if (length >= 1000 && next) return `${plain(length / 1000)} ${next}`;
  return `${plain(length)} ${unitName}${unitName === "voxel" && length !== 1 ? "s" : ""}`;
}

const plain = (value) => String(Number(value.toPrecision(6)));

const hexOf = (colour) => `#${colour.map((value) => value.toString(16).padStart(2, "0")).join("")}`;
const ofHex = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
const toLinear = (colour) => colour.map((value) => {
  const share = value / 255;
  return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
});
