// WebGL: one canvas, one program, textures for every volume; a volume is drawn into a part of the canvas.
"use strict";

class Drawing {
  constructor(canvas) {
    const options = { antialias: false, depth: false, alpha: false, preserveDrawingBuffer: true };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.largest = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    this.program = this.link();
    gl.useProgram(this.program);
    this.places = {};
    const count = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) {
      const name = gl.getActiveUniform(this.program, i).name.replace("[0]", "");
      this.places[name] = gl.getUniformLocation(this.program, name);
    }
    gl.bindVertexArray(gl.createVertexArray());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  }

  link() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, id] of [[gl.VERTEX_SHADER, "vertex"], [gl.FRAGMENT_SHADER, "fragment"]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, document.getElementById(id).textContent.trim());
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const shaders = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`the renderer does not compile here: ${gl.getProgramInfoLog(program)} ${shaders.join(" ")}`);
    }
    return program;
  }

  // A texture, filled by `fill(z)` a slice at a time: no second copy of the volume is made.
  texture(old, [depth, height, width], fill, { channels = 1, filter, levels = 1 }) {
    const { gl } = this;
    if (old) gl.deleteTexture(old);
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_3D, texture);
    const [inside, outside] = channels === 3 ? [gl.RGB8, gl.RGB] : [gl.R8, gl.RED];
    const most = Math.floor(Math.log2(Math.max(depth, height, width))) + 1;
    gl.texStorage3D(gl.TEXTURE_3D, Math.min(levels, most), inside, width, height, depth);
    for (let z = 0; z < depth; z++) {
      gl.texSubImage3D(gl.TEXTURE_3D, 0, 0, 0, z, width, height, 1, outside, gl.UNSIGNED_BYTE, fill(z));
    }
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) {
      gl.texParameteri(gl.TEXTURE_3D, wrap, gl.CLAMP_TO_EDGE);
    }
    gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_3D, gl.TEXTURE_MIN_FILTER, levels > 1 ? gl.LINEAR_MIPMAP_NEAREST : filter);
    if (levels > 1) gl.generateMipmap(gl.TEXTURE_3D);
    return texture;
  }

  // Textures of a volume, again where what is drawn of it has changed.
  upload(volume) {
    const { gl } = this, { shape, voxels } = volume, old = volume.textures || {};
    const size = shape[1] * shape[2], slice = new Uint8Array(size), other = new Uint8Array(size);
    const table = drawnTable(volume), blocks = new Blocks(shape), least = volume.opacity < 1 ? 0 : 127;
    const fieldOf = (z) => {
      fieldSlice(volume, table, z, slice, other);
      blocks.add(slice, z, shape, least);
      return slice;
    };
    const field = this.texture(old.field, shape, fieldOf, { filter: gl.LINEAR, levels: TABLE.levels });
    const away = blocks.measured(), layer = blocks.size[1] * blocks.size[2];
    const part = (values, length) => (z) => values.subarray(z * length, (z + 1) * length);
    const blockTexture = this.texture(old.blocks, blocks.size, part(away, layer), { filter: gl.NEAREST });
    volume.only = Math.max(0, volume.phases.findIndex((phase) => phase.visible));
    const several = volume.phases.filter((phase) => phase.visible).length > 1;
    volume.mode = { grey: 2, colour: 3 }[volume.kind] ?? (several ? 1 : 0);
    let source = old.source ?? null;
    if (volume.mode === 1) {
      const spread = (z) => { spreadSlice(volume, z, slice); return slice; };
      source = this.texture(source, shape, spread, { filter: gl.NEAREST });
    } else if (volume.mode > 1 && !source) {
      const channels = volume.mode === 3 ? 3 : 1;
      source = this.texture(null, shape, part(voxels, channels * size), { channels, filter: gl.LINEAR });
    }
    volume.textures = { field, blocks: blockTexture, source };
  }

  resize(width, height) {
    const { canvas } = this.gl;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  }

  // Draw a volume into (left, bottom, width, height) of the canvas; `blend` below 1 mixes it with what is there.
  // view: { camera, cut, look, pixel (its edge in the volume's unit), foot (free pixels below) }.
  draw(volume, [left, bottom, width, height], view, { jitter = [0, 0], blend = 1, skip = true, count = false } = {}) {
    const { gl, places } = this;
    const axes = basis(view.camera), ray = rays(volume, axes, view.camera.pan, view, width, height);
    const cut = cutOf(volume, view.cut), stretch = scaled(volume.edges, 1 / Math.min(...volume.edges));
    const { lamp, strength, around } = TABLE.light, look = TABLE.looks[view.look];
    const toLamp = unit(added(added(scaled(axes.right, lamp[0]), scaled(axes.up, lamp[1])), scaled(axes.viewer, lamp[2])));
    const vectors = {
      uSides: volume.sides, uInverse: volume.sides.map((side) => 1 / side), uStretch: stretch, uCorner: ray.corner, uRight: ray.right, uDown: ray.down,
      uDirection: ray.direction, uKeepLow: cut.keepLow, uKeepHigh: cut.keepHigh, uGoneLow: cut.goneLow,
      uGoneHigh: cut.goneHigh, uLamp: toLamp, uViewer: axes.viewer, uStrength: strength, uShade: toLinear(look.shade),
      uBackground: toLinear(look.background), uDye: toLinear(look.cut), uAround: around.flat(),
      uAlbedo: volume.phases.flatMap((phase) => toLinear(phase.colour)),
    };
    for (const [name, value] of Object.entries(vectors)) gl.uniform3fv(places[name], value);
    gl.uniform4fv(places.uPlane, cut.plane);
    gl.uniform4fv(places.uFinish, volume.phases.flatMap(({ finish: [rough, mirror, absorbs, turns] }) => (
      [rough, mirror, absorbs * volume.coarse, turns * volume.coarse])));
    gl.uniform2fv(places.uWindow, volume.window.map((value) => value / 255));
    gl.uniform2fv(places.uOrigin, [left, bottom]);
    gl.uniform2fv(places.uJitter, jitter);
    const numbers = { uOpacity: volume.opacity < 1 ? 0.02 + 0.6 * volume.opacity ** 2 : 1, uHeight: height };
    for (const [name, value] of Object.entries(numbers)) gl.uniform1f(places[name], value);
    const whole = { uKind: volume.mode, uOnly: volume.kind === "labels" ? volume.only : 1, uLevels: TABLE.levels, uSkip: skip,
      uCount: count, uField: 0, uSource: 1, uBlocks: 2 };
    for (const [name, value] of Object.entries(whole)) gl.uniform1i(places[name], Number(value));
    [volume.textures.field, volume.textures.source || volume.textures.field, volume.textures.blocks].forEach((texture, i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_3D, texture);
    });
    gl.viewport(left, bottom, width, height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    gl.blendColor(0, 0, 0, blend);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
