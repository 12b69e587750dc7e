// Streamlines: ribbons with the light of tubes, drawn into a picture of their own with the depth of each, which the marcher reads.
"use strict";

const RIBBON = 1.6;   // half a ribbon's width, CSS pixels

class LineLayer {
  constructor(drawing) {
    this.gl = drawing.gl;
    this.program = drawing.link("linefragment", [], "linevertex");
    this.array = this.gl.createVertexArray();
    this.buffer = this.gl.createFramebuffer();
    this.sources = new Map();
    [this.width, this.height] = [0, 0];
  }

  resize(width, height) {
    const { gl } = this;
    if (this.width === width && this.height === height) return;
    for (const texture of [this.colour, this.depth]) if (texture) gl.deleteTexture(texture);
    Object.assign(this, { width, height, colour: gl.createTexture(), depth: gl.createTexture() });
    gl.activeTexture(gl.TEXTURE0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    for (const [texture, format, place] of [[this.colour, gl.RGBA8, gl.COLOR_ATTACHMENT0], [this.depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, place, gl.TEXTURE_2D, texture, 0);
    }
  }

  // The segments of a volume's lines: both ends (x, y, z in its unit) and the speed.
  sourceOf(volume) {
    const { gl } = this, known = this.sources.get(volume);
    if (known) return known;
    const { points, values, parts } = volume.lines, count = values.length / 4;
    const at = (k) => [0, 1, 2].map((i) => values[i * count + k] / parts * volume.edges[i]);
    const floats = [];
    let first = 0;
    for (const many of points) {
      for (let k = first; k < first + many - 1; k++) floats.push(...at(k), ...at(k + 1), values[3 * count + k] / 65535);
      first += many;
    }
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(floats), gl.STATIC_DRAW);
    const source = { buffer, segments: floats.length / 7 };
    this.sources.set(volume, source);
    return source;
  }

  // Draw the lines of a volume; returns the length along a ray that stands for a depth of 1, in smallest voxel edges.
  draw(volume, [left, bottom, width, height], { camera, pixel, foot }, jitter, density) {
    const { gl, program } = this, { buffer, segments } = this.sourceOf(volume), axes = basis(camera);
    const far = Math.hypot(...volume.extent), centre = scaled(volume.extent, 0.5);
    const place = (name) => gl.getUniformLocation(program, name);
    gl.useProgram(program);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    [[3, 0], [3, 12], [1, 24]].forEach(([size, skip], i) => {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, size, gl.FLOAT, false, 28, skip);
      gl.vertexAttribDivisor(i, 1);
    });
    for (const [name, value] of Object.entries({ uCentre: centre, uRight: axes.right, uUp: axes.up, uViewer: axes.viewer })) gl.uniform3fv(place(name), value);
    gl.uniform2fv(place("uPan"), camera.pan);
    gl.uniform2fv(place("uJitter"), jitter);
    gl.uniform2fv(place("uSize"), [width, height]);
    gl.uniform4fv(place("uScale"), [pixel, foot, far, RIBBON * density]);
    gl.uniform3fv(place("uRamp"), TABLE.ramp.flat());
    gl.viewport(left, bottom, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(left, bottom, width, height);
    gl.disable(gl.BLEND);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, segments);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.SCISSOR_TEST);
    return 2 * far / Math.min(...volume.edges);
  }
}
