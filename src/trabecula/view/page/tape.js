// The measuring tape: two points of a volume and the length between them, drawn over the picture.
"use strict";

class Tape {
  constructor(app) {
    Object.assign(this, { app, volume: 0, points: [] });
  }

  // A further point (in the volume's unit); a third begins anew.
  add(volume, point) {
    if (volume !== this.volume || this.points.length > 1) this.points = [];
    this.volume = volume;
    this.points.push(point);
    this.app.say(this.points.length > 1 ? `tape: ${this.text()}` : "tape: one end is set, the other is next");
    this.app.overlays();
  }

  clear() {
    this.points = [];
    this.app.overlays();
  }

  length() {
    const [a, b] = this.points;
    return Math.hypot(...a.map((value, i) => value - b[i]));
  }

  text() {
    return words(Number(this.length().toPrecision(4)), this.app.volumes[this.volume].unit);
  }

  // Over the picture: dots, the line, its length.
  place() {
    this.app.views.forEach(({ tape }, i) => {
      const here = i === this.volume ? this.points : [];
      const volume = this.app.volumes[i], cell = this.app.cells[i], camera = this.app.cameras[i];
      const spots = here.map((point) => project(point, volume, basis(camera), camera.pan, cell, cell.width, cell.height));
      const drawn = spots.map(([x, y]) => vector("circle", { cx: x, cy: y, r: 4 }));
      if (spots.length > 1) {
        const [[x1, y1], [x2, y2]] = spots;
        drawn.unshift(vector("line", { x1, y1, x2, y2 }));
        const label = vector("text", { x: (x1 + x2) / 2 + 8, y: (y1 + y2) / 2 - 8 });
        label.textContent = this.text();
        drawn.push(label);
      }
      tape.replaceChildren(...drawn);
    });
  }
}

function vector(tag, attributes = {}) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}
