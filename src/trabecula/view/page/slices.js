// Three slices of a volume on 2-D canvases; they need no WebGL.
"use strict";

const AXES = [["z", 0, 1, 2], ["y", 1, 0, 2], ["x", 2, 0, 1]];

// The slice across an axis of (z, y, x) as pixels; rows and columns are the other two axes in their order.
function slicePixels(volume, axis, at) {
  const { voxels, shape, kind } = volume;
  const [rows, columns] = AXES[axis].slice(2).map((k) => shape[k]);
  const steps = [shape[1] * shape[2], shape[2], 1];
  const [down, right] = AXES[axis].slice(2).map((k) => steps[k]);
  const image = new ImageData(columns, rows);
  const palette = kind === "labels" ? volume.phases.map(({ colour, visible, hidden }) => (visible ? colour : hidden)) : null;
  const [low, high] = volume.window;
  for (let r = 0, to = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++, to += 4) {
      const from = at * steps[axis] + r * down + c * right;
      if (palette) image.data.set(palette[voxels[from]], to);
      else if (kind === "colour") for (let k = 0; k < 3; k++) image.data[to + k] = voxels[3 * from + k];
      else image.data.fill(255 * (voxels[from] - low) / Math.max(high - low, 1), to, to + 3);
      image.data[to + 3] = 255;
    }
  }
  return image;
}

function slicePanels(host) {
  return AXES.map(([name], axis) => {
    const canvas = make("canvas", { role: "img" });
    const input = make("input", { type: "range", min: 0, step: 1, "aria-label": `slice across ${name}` });
    const note = make("output");
    host.append(make("figure", {}, canvas, make("label", {}, `${name} `, input, note)));
    const draw = (volume) => {
      const at = Math.min(Number(input.value), volume.shape[axis] - 1);
      const image = slicePixels(volume, axis, at);
      [canvas.width, canvas.height] = [image.width, image.height];
      canvas.getContext("2d").putImageData(image, 0, 0);
      const [rows, columns] = AXES[axis].slice(2).map((k) => volume.shape[k] * volume.edges[2 - k]);
      canvas.style.aspectRatio = `${columns} / ${rows}`;
      canvas.setAttribute("aria-label", `slice ${at} of ${volume.shape[axis]} across ${name}`);
      note.textContent = `${at}`;
    };
    const show = (volume) => {
      input.max = volume.shape[axis] - 1;
      input.value = Math.floor(volume.shape[axis] / 2);
      input.oninput = () => draw(volume);
      draw(volume);
    };
    return { show, draw };
  });
}
