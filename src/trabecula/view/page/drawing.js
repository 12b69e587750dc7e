// WebGL: one canvas, textures for every volume; a volume is drawn into a part of the canvas. Passes are averaged as linear
// light in half floats, where the browser draws into those, and shown from there.
"use strict";

class Drawing {
  constructor(canvas) {
    const options = { antialias: false, depth: false, alpha: false, preserveDrawingBuffer: true };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.largest = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    this.start();
  }

  // Everything that a lost context takes with it.
  start() {
    const { gl } = this;
    this.programs = {};
    this.marcher([]);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    this.lines = null;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.mean = gl.getExtension("EXT_color_buffer_float") && { width: 0, height: 0, buffer: gl.createFramebuffer(), program: this.link("showing") };
    const names = gl.getExtension("WEBGL_debug_renderer_info");
    const renderer = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
    this.onProcessor = /swiftshader|llvmpipe|software/i.test(renderer);
  }

  // The program with those words defined, and the places of its uniforms.
  marcher(words) {
    const { gl } = this, known = this.programs[words];
    if (known) return known;
    const program = this.link("fragment", words), places = {};
    const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) {
      const name = gl.getActiveUniform(program, i).name.replace("[0]", "");
      places[name] = gl.getUniformLocation(program, name);
    }
    return (this.programs[words] = { program, places });
  }

  link(fragment, words = [], vertex = "vertex") {
    const { gl } = this, defined = words.map((word) => `#define ${word}\n`).join("");
    const program = gl.createProgram();
    for (const [kind, id] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, document.getElementById(id).textContent.trim().replace("\n", `\n${defined}`));
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
    const size = shape[1] * shape[2];
    volume.only = Math.max(0, volume.phases.findIndex((phase) => phase.visible));
    const shown = volume.phases.filter((phase) => phase.visible), several = shown.length > 1;
    const sheer = (phase) => phase.opacity < 1;
    volume.cloud = volume.kind === "labels" ? shown.length > 0 && shown.every(sheer) : sheer(volume);
    volume.veiled = volume.kind === "labels" && !volume.cloud && shown.some(sheer);
    volume.mode = { grey: 2, colour: 3 }[volume.kind] ?? (several ? 1 : 0);
    const blocks = new Blocks(shape), field = this.fieldTexture(old.field, volume, blocks, TABLE.levels);
    let source = old.source ?? null;
    if (volume.mode === 1) source = this.nearestTexture(source, volume, volume);
    else if (volume.mode > 1 && !source) {
      const channels = volume.mode === 3 ? 3 : 1, part = (z) => voxels.subarray(z * channels * size, (z + 1) * channels * size);
      source = this.texture(null, shape, part, { channels, filter: gl.LINEAR });
    }
    volume.textures = { ...old, field, source, blocks: null };
    if (old.blocks) gl.deleteTexture(old.blocks);
    volume.marks = blocks;
    this.tint(volume);
    this.refine(volume);
  }

  // How much is drawn, blurred, with coarser levels; blocks that hold something are marked.
  fieldTexture(old, grid, blocks, levels, place = {}) {
    const { gl } = this, size = grid.shape[1] * grid.shape[2], slice = new Uint8Array(size), other = new Uint8Array(size);
    const table = surfaceTable(grid), least = grid.cloud ? 0 : 127;
    const fill = (z) => {
      if (grid.veiled) {
        for (let i = 0; i < size; i++) other[i] = isVeil(grid, grid.voxels[z * size + i]) ? 255 : 0;
        blocks.add(other, z, grid.shape, least, place);
      }
      fieldSlice(grid, table, z, slice, other);
      blocks.add(slice, z, grid.shape, least, place);
      return slice;
    };
    return this.texture(old, grid.shape, fill, { filter: gl.LINEAR, levels });
  }

  // Labels, or what stands for them (`values`), with drawn ones spread by a voxel.
  nearestTexture(old, grid, { voxels }) {
    const slice = new Uint8Array(grid.shape[1] * grid.shape[2]);
    const spread = (z) => { spreadSlice(grid, voxels, z, slice); return slice; };
    return this.texture(old, grid.shape, spread, { filter: this.gl.NEAREST });
  }

  // The field that colours what is drawn.
  tint(volume) {
    const { textures } = volume, chosen = volume.fields[volume.field];
    if (textures.tint) this.gl.deleteTexture(textures.tint);
    textures.tint = chosen ? this.nearestTexture(null, volume, chosen) : null;
  }

  // The box that is there in finer voxels, and the blocks that hold something of either.
  refine(volume) {
    const { gl } = this, { textures, fine } = volume, marks = volume.marks.copy();
    for (const name of ["fineField", "fineSource", "blocks"]) if (textures[name]) gl.deleteTexture(textures[name]);
    [textures.fineField, textures.fineSource] = [null, null];
    if (fine) {
      const grid = { ...volume, voxels: fine.voxels, shape: fine.shape };
      textures.fineField = this.fieldTexture(null, grid, marks, TABLE.levels + Math.log2(fine.fine), fine);
      if (volume.mode === 1) textures.fineSource = this.nearestTexture(null, grid, grid);
    }
    const away = marks.measured(), layer = marks.size[1] * marks.size[2];
    textures.blocks = this.texture(null, marks.size, (z) => away.subarray(z * layer, (z + 1) * layer), { filter: gl.NEAREST });
  }

  resize(width, height) {
    const { gl, mean } = this, { canvas } = gl;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    if (!mean || (mean.width === width && mean.height === height)) return;
    if (mean.light) gl.deleteTexture(mean.light);
    Object.assign(mean, { width, height, light: gl.createTexture() });
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, mean.light);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, mean.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, mean.light, 0);
  }

  // Bring the mean of the passes to the canvas.
  show() {
    const { gl, mean } = this;
    if (!mean) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(mean.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, mean.light);
    gl.viewport(0, 0, mean.width, mean.height);
    gl.disable(gl.BLEND);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  drawLines(volume, place, view, jitter) {
    const { gl } = this;
    this.lines ||= new LineLayer(this);
    this.lines.resize(gl.canvas.width, gl.canvas.height);
    const reach = this.lines.draw(volume, place, view, jitter, view.density);
    gl.bindVertexArray(this.array);
    return reach;
  }

  // Draw a volume into (left, bottom, width, height) of the canvas; `blend` below 1 mixes it with what is there.
  // view: { camera, cut, look, pixel (its edge in the volume's unit), foot (free pixels below), density (pixels a CSS pixel) }; `pass` from 0 on is one of
  // the refined light. `count` draws the number of samples in place of light, and to the canvas at once.
  draw(volume, [left, bottom, width, height], view, { jitter = [0, 0], blend = 1, skip = true, count = false, pass = -1 } = {}) {
    const { gl } = this, { textures, fine } = volume, averaged = Boolean(this.mean) && !count;
    const lined = volume.lines && volume.lines.shown, reach = lined ? this.drawLines(volume, [left, bottom, width, height], view, jitter) : 0;
    const wanted = { LINES: lined, FINE: fine, FIELD: textures.tint, VEILED: volume.veiled, REFINED: pass >= 0 };
    const { program, places } = this.marcher(Object.keys(wanted).filter((word) => wanted[word]));
    gl.useProgram(program);
    gl.bindFramebuffer(gl.FRAMEBUFFER, averaged ? this.mean.buffer : null);
    const axes = basis(view.camera), ray = rays(volume, axes, view.camera.pan, view, width, height);
    const cut = cutOf(volume, view.cut), stretch = scaled(volume.edges, 1 / Math.min(...volume.edges));
    const { lamp, strength, around } = TABLE.light, look = TABLE.looks[view.look];
    const toLamp = unit(added(added(scaled(axes.right, lamp[0]), scaled(axes.up, lamp[1])), scaled(axes.viewer, lamp[2])));
    const vectors = {
      uSides: volume.sides, uInverse: volume.sides.map((side) => 1 / side), uStretch: stretch, uCorner: ray.corner, uRight: ray.right, uDown: ray.down,
      uDirection: ray.direction, uKeepLow: cut.keepLow, uKeepHigh: cut.keepHigh, uGoneLow: cut.goneLow,
      uGoneHigh: cut.goneHigh, uLamp: toLamp, uViewer: axes.viewer, uStrength: strength, uShade: toLinear(look.shade),
      uBackground: toLinear(look.background), uDye: toLinear(look.cut), uAround: around.flat(),
      uAlbedo: volume.phases.flatMap((phase) => toLinear(phase.colour)), uRamp: TABLE.ramp.flat(),
      uFineLow: fine ? fine.low : [0, 0, 0], uFineHigh: fine ? fine.low.map((low, i) => low + fine.sides[i] / fine.fine) : [0, 0, 0],
    };
    for (const [name, value] of Object.entries(vectors)) gl.uniform3fv(places[name], value);
    gl.uniform4fv(places.uPlane, cut.plane);
    gl.uniform4fv(places.uFinish, volume.phases.flatMap(({ finish: [rough, mirror, absorbs, turns] }) => (
      [rough, mirror, absorbs * volume.coarse, turns * volume.coarse])));
    gl.uniform2fv(places.uWindow, volume.window.map((value) => value / 255));
    gl.uniform2fv(places.uOrigin, [left, bottom]);
    gl.uniform2fv(places.uJitter, jitter);
    const dense = ({ visible = true, opacity }) => (visible && opacity < 1 ? 0.02 + 0.6 * opacity ** 2 : 0);
    gl.uniform1fv(places.uDense, volume.phases.map((phase) => dense(volume.kind === "labels" ? phase : volume)));
    const numbers = { uHeight: height, uFine: fine ? fine.fine : 0 };
    for (const [name, value] of Object.entries(numbers)) gl.uniform1f(places[name], value);
    const whole = { uKind: textures.tint ? 4 : volume.mode, uPass: pass, uLinear: averaged, uOnly: volume.kind === "labels" ? volume.only : 1, uLevels: TABLE.levels, uSkip: skip,
      uCount: count, uCloud: volume.cloud, uField: 0, uSource: 1, uBlocks: 2, uFineField: 3, uFineSource: 4, uLabels: 5 };
    for (const [name, value] of Object.entries(whole)) gl.uniform1i(places[name], Number(value));
    const { field } = textures;
    [field, textures.tint || textures.source, textures.blocks, textures.fineField, textures.fineSource, textures.source].forEach((texture, i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_3D, texture || field);
    });
    if (lined) {
      gl.uniform1f(places.uLineReach, reach);
      gl.uniform1i(places.uLineColour, 6);
      gl.uniform1i(places.uLineDepth, 7);
      [this.lines.colour, this.lines.depth].forEach((texture, i) => {
        gl.activeTexture(gl.TEXTURE6 + i);
        gl.bindTexture(gl.TEXTURE_2D, texture);
      });
    }
    gl.viewport(left, bottom, width, height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    gl.blendColor(0, 0, 0, blend);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
