// Three slices of a volume on 2-D canvases; they need no WebGL. Each shows where the other two lie, and a press moves them.
"use strict";

const AXES = [["z", 0, 1, 2], ["y", 1, 0, 2], ["x", 2, 0, 1]];

// The slice across an axis of (z, y, x) as pixels; rows and columns are the other two axes in their order.
function slicePixels(volume, axis, at) {
  const { voxels, shape, kind } = volume, chosen = volume.fields[volume.field];
  const [rows, columns] = AXES[axis].slice(2).map((k) => shape[k]);
  const steps = [shape[1] * shape[2], shape[2], 1];
  const [down, right] = AXES[axis].slice(2).map((k) => steps[k]);
  const image = new ImageData(columns, rows);
  const palette = kind === "labels" ? volume.phases.map(({ colour, visible, hidden }) => (visible ? colour : hidden)) : null;
  const ramp = chosen && Array.from({ length: 256 }, (_, value) => rampColour(value));
  const [low, high] = volume.window;
  for (let r = 0, to = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++, to += 4) {
      const from = at * steps[axis] + r * down + c * right;
      if (ramp && volume.phases[voxels[from] & LABEL].visible) image.data.set(ramp[chosen.voxels[from]], to);
      else if (palette) image.data.set(palette[voxels[from] & LABEL], to);
      else if (kind === "colour") for (let k = 0; k < 3; k++) image.data[to + k] = voxels[3 * from + k];
      else image.data.fill(255 * (voxels[from] - low) / Math.max(high - low, 1), to, to + 3);
      image.data[to + 3] = 255;
    }
  }
  return image;
}

// The colour of a field's value, 0..255, as it is drawn.
function rampColour(value) {
  const band = (Math.floor(value / 256 * TABLE.bands) + 0.5) / TABLE.bands * (TABLE.ramp.length - 1), first = Math.floor(band);
  return TABLE.ramp[first].map((channel, k) => channel + (band - first) * (TABLE.ramp[Math.min(first + 1, 9)][k] - channel));
}

// The index of the slice across an axis of (z, y, x) at the focus.
function sliceAt(volume, focus, axis) {
  const side = volume.shape[axis];
  return Math.min(side - 1, Math.floor(focus[2 - axis] * side));
}

function slicePanels(app, host) {
  const panels = AXES.map(([name, , rowAxis, columnAxis], axis) => {
    const canvas = make("canvas", { role: "img" });
    const lines = [make("div", { class: "across" }), make("div", { class: "along" })];
    const input = make("input", { type: "range", min: 0, step: 1, "aria-label": `slice across ${name}` });
    const note = make("output");
    const frame = make("div", { class: "slice" }, canvas, ...lines);
    host.append(make("figure", {}, frame, make("label", {}, `${name} `, input, note)));
    let shown = "";
    const draw = (volume, fresh = true) => {
      const at = sliceAt(volume, app.focus, axis);
      if (fresh || shown !== `${volume.name} ${at}`) {
        const image = slicePixels(volume, axis, at);
        [canvas.width, canvas.height] = [image.width, image.height];
        canvas.getContext("2d").putImageData(image, 0, 0);
        shown = `${volume.name} ${at}`;
      }
      const [rows, columns] = AXES[axis].slice(2).map((k) => volume.shape[k] * volume.edges[2 - k]);
      Object.assign(frame.style, { aspectRatio: `${columns} / ${rows}`, width: `min(100%, ${24 * columns / rows}vh)` });
      canvas.setAttribute("aria-label", `slice ${at} of ${volume.shape[axis]} across ${name}`);
      [input.max, input.value] = [volume.shape[axis] - 1, at];
      note.textContent = `${at}`;
      lines[0].style.top = `${100 * (sliceAt(volume, app.focus, rowAxis) + 0.5) / volume.shape[rowAxis]}%`;
      lines[1].style.left = `${100 * (sliceAt(volume, app.focus, columnAxis) + 0.5) / volume.shape[columnAxis]}%`;
    };
    // The voxel (x, y, z) under a place of the canvas.
    const voxelAt = (event) => {
      const { shape } = app.volumes[app.active], box = canvas.getBoundingClientRect(), voxel = [0, 0, 0];
      const inside = (value, side) => Math.max(0, Math.min(side - 1, Math.floor(value * side)));
      voxel[2 - axis] = sliceAt(app.volumes[app.active], app.focus, axis);
      voxel[2 - rowAxis] = inside((event.clientY - box.top) / box.height, shape[rowAxis]);
      voxel[2 - columnAxis] = inside((event.clientX - box.left) / box.width, shape[columnAxis]);
      return voxel;
    };
    const press = (event) => { app.setFocus(voxelAt(event)); };
    canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); press(event); };
    canvas.onpointermove = (event) => { if (event.buttons) press(event); else app.read(app.active, voxelAt(event)); };
    canvas.onpointerup = (event) => { if (app.measuring) app.tape.add(app.active, app.middleOf(voxelAt(event))); };
    input.oninput = () => {
      const voxel = app.focusVoxel();
      voxel[2 - axis] = Number(input.value);
      app.setFocus(voxel);
    };
    return { draw };
  });
  return panels;
}
