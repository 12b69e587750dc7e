// Levels of detail: at rest the box in view comes in finer voxels from the local server, where the page was made of blocks.
"use strict";

const BOX = 192;   // voxels a side that are held of it

// How fine the box should be: as a pixel is, no finer than the store, and so that it covers what is in view if it can.
function wantedFineness(volume, cell) {
  const most = Math.max(...volume.block);
  const pixels = Math.max(...volume.edges) / cell.pixel;
  let fine = 1;
  while (fine < most && fine * 1.4 < pixels && most % (2 * fine) === 0) fine *= 2;
  return fine;
}

// The box around a point: { fine, low, size } in voxels of the whole (x, y, z); null where the whole is fine enough.
function wantedBox(volume, camera, cell, cut) {
  const fine = volume.detail ? wantedFineness(volume, cell) : 1;
  if (fine === 1) return null;
  const found = pick(volume, camera, cell, cut, cell.width / 2, (cell.height - cell.foot) / 2);
  const middle = found ? found.voxel : volume.sides.map((side) => side / 2);
  const size = volume.sides.map((side) => Math.min(side, Math.floor(BOX / fine)));
  const low = middle.map((value, i) => Math.round(Math.max(0, Math.min(volume.sides[i] - size[i], value - size[i] / 2))));
  return { fine, low, size };
}

// Which level is shown, where it is not the image's own voxels.
function levelText({ block, fine }) {
  const edge = Math.max(...block);
  if (edge === 1) return "";
  const near = fine ? edge / fine.fine : edge;
  return fine ? `${near === 1 ? "single voxels" : `blocks of ${near} voxels`} in the middle, blocks of ${edge} around it` : `blocks of ${edge} voxels`;
}

const sameBox = (a, b) => a && b && a.fine === b.fine && a.low.every((value, i) => Math.abs(value - b.low[i]) < b.size[i] / 8);

// Ask for the box; it is drawn when it is there, unless another is wanted by then.
async function fetchDetail(app, index) {
  const volume = app.volumes[index], wanted = wantedBox(volume, app.cameras[index], app.cells[index], app.cut);
  if (sameBox(wanted, volume.asked) || (!wanted && !volume.asked)) return;
  volume.asked = wanted;
  if (!wanted) {
    app.takeDetail(index, null);
    return;
  }
  const query = new URLSearchParams({ volume: index, fine: wanted.fine, low: [...wanted.low].reverse(), size: [...wanted.size].reverse() });
  try {
    const answer = await fetch(`box?${query}`);
    if (!answer.ok) throw new Error(await answer.text());
    const voxels = new Uint8Array(await answer.arrayBuffer()), sides = wanted.size.map((side) => side * wanted.fine);
    if (voxels.length !== sides[0] * sides[1] * sides[2]) throw new Error(`${voxels.length} voxels came`);
    if (volume.asked === wanted) app.takeDetail(index, { ...wanted, sides, shape: [...sides].reverse(), voxels });
  } catch (error) {
    volume.detail = false;
    complain(`Finer voxels did not come from the server (${error.message}): the coarser ones stay.`);
  }
}
