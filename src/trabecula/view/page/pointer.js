// Mouse, touch and keyboard: turn, pan, zoom; handles that move the planes of the cut.
"use strict";

function turn(camera, dx, dy) {
  camera.azimuth = (camera.azimuth - 0.4 * dx + 540) % 360 - 180;
  camera.elevation = Math.max(-90, Math.min(90, camera.elevation + 0.4 * dy));
}

function zoom(camera, factor) {
  camera.zoom = Math.max(0.5, Math.min(16, camera.zoom * factor));
}

function pan(camera, cell, dx, dy) {
  camera.pan[0] += dx * cell.pixel;
  camera.pan[1] -= dy * cell.pixel;
}

function listen(app, canvas) {
  const fingers = new Map();
  let began = null;
  const middle = () => {
    const all = [...fingers.values()];
    const x = all.reduce((sum, f) => sum + f.x, 0) / all.length, y = all.reduce((sum, f) => sum + f.y, 0) / all.length;
    return { x, y, apart: all.length > 1 ? Math.hypot(all[0].x - all[1].x, all[0].y - all[1].y) : 0 };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    began = fingers.size === 1 ? { x: event.clientX, y: event.clientY } : null;
    app.choose(app.cellAt(event.offsetX, event.offsetY));
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) {
      app.hover(event.offsetX, event.offsetY);
      return;
    }
    // A press that trembles is still a press.
    if (began && Math.hypot(event.clientX - began.x, event.clientY - began.y) < 4) return;
    began = null;
    const before = middle();
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const now = middle(), camera = app.cameras[app.active], dx = now.x - before.x, dy = now.y - before.y;
    if (fingers.size > 1) {
      if (before.apart > 0) zoom(camera, now.apart / before.apart);
      pan(camera, app.cells[app.active], dx, dy);
    } else if (event.shiftKey || event.buttons & 6) pan(camera, app.cells[app.active], dx, dy);
    else turn(camera, dx, dy);
    app.redraw();
  });
  const up = (event) => {
    fingers.delete(event.pointerId);
    if (event.type === "pointerup" && began) app.press(event.offsetX, event.offsetY);
    began = null;
  };
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, up);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(app.cameras[app.active], Math.exp(-event.deltaY * 0.0015));
    app.redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => keys(app, event));
}

function keys(app, event) {
  const arrows = { ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12] };
  const camera = app.cameras[app.active];
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key in arrows) {
    const [dx, dy] = arrows[event.key];
    if (event.shiftKey) pan(camera, app.cells[app.active], dx, dy); else turn(camera, dx, dy);
  } else if (event.key === "+" || event.key === "=") zoom(camera, 1.15);
  else if (event.key === "-") zoom(camera, 1 / 1.15);
  else if (event.key === "0") app.home();
  else if (event.key === "c") app.setCut({ corner: "planes", planes: "none", none: "corner" }[app.cut.mode]);
  else if (event.key === "l") app.setLook(after(Object.keys(TABLE.looks), app.look));
  else if (event.key === "s") app.screenshot();
  else if (event.key === "m") app.measureBy(!app.measuring);
  else if (event.key === "p") probeByKey(app);
  else return;
  event.preventDefault();
  app.redraw();
}

// Where the slices cross: read it, and set an end of the tape there while it is out.
function probeByKey(app) {
  const voxel = app.focusVoxel();
  app.read(app.active, voxel);
  if (app.measuring) app.tape.add(app.active, app.middleOf(voxel));
}

const after = (names, name) => names[(names.indexOf(name) + 1) % names.length];

// Round handles in the middle of the cut faces; the range inputs of the panel do the same for keyboards.
function placeHandles(app, host, volume, cell, camera) {
  const axes = basis(camera), found = grips(volume, app.cut);
  for (const name of ["x", "y", "z", "plane", "tilt"]) {
    let handle = host.querySelector(`[data-grip=${name}]`);
    if (!handle) {
      handle = make("div", { class: "handle", "data-grip": name, "aria-hidden": "true", title: `drag the cut (${name})` });
      host.append(handle);
    }
    const grip = found.find((one) => one.name === name);
    handle.hidden = !grip;
    if (!grip) continue;
    const [x, y] = project(grip.point, volume, axes, camera.pan, cell, cell.width, cell.height);
    const inside = x > 8 && y > 8 && x < cell.width - 8 && y < cell.height - 8;
    handle.hidden = !inside;
    handle.style.transform = `translate(${x}px, ${y}px)`;
    handle.onpointerdown = (event) => {
      handle.setPointerCapture(event.pointerId);
      event.stopPropagation();
      [app.grabX, app.grabY] = [event.clientX, event.clientY];
    };
    handle.onpointermove = (event) => {
      if (!event.buttons) return;
      moveGrip(app, grip, axes, cell, event.clientX - app.grabX, event.clientY - app.grabY);
      [app.grabX, app.grabY] = [event.clientX, event.clientY];
    };
  }
}

function moveGrip(app, { axis, normal, length }, { right, up }, { pixel }, dx, dy) {
  const { cut } = app;
  if (axis === 4) {
    const towards = added(added(normal, scaled(right, dx * pixel / length)), scaled(up, -dy * pixel / length));
    const [x, y, z] = unit(towards);
    cut.azimuth = Math.atan2(x, -y) * 180 / Math.PI;
    cut.elevation = Math.asin(Math.max(-1, Math.min(1, z))) * 180 / Math.PI;
  } else {
    const across = dot(normal, right), above = dot(normal, up), seen = across ** 2 + above ** 2;
    // A plane that faces the viewer moves with the mouse up and down.
    const along = seen > 0.02 ? (dx * across - dy * above) / seen : -dy;
    const shift = along * pixel / length, clamp = (value) => Math.max(0, Math.min(1, value));
    if (axis < 3) cut.at[axis] = clamp(cut.at[axis] + shift); else cut.offset = clamp(cut.offset + shift);
  }
  app.redraw();
}
