// Convolutions on planes of floats: a kernel of WebAssembly with vectors of four, put together here byte by byte; where a
// browser has none, the same sums in JavaScript. Both round every product and every sum to 32 bits, in the same order: so they
// give the same bits, in every browser.
"use strict";

const LANES = 8, GROUP = 4;   // floats along a row, and channels of the output, that the kernel holds at a time

// Whole numbers as WebAssembly writes them: seven bits a byte, the low ones first.
function leb(value) {
  const bytes = [];
  do {
    bytes.push(value > 127 ? value & 127 | 128 : value);
    value >>>= 7;
  } while (value);
  return bytes;
}

// The kernel conv(input, offsets, offsets' end, weights, bias, output, bytes, stride), all of them places or lengths in bytes:
// for p = 0, 32, ... below `bytes`, output[c stride + p] = bias[c] + sum over k of weights[4 k + c] input[p + offsets[k]] of four
// channels c and the eight floats from p on.
function kernelBytes() {
  const [INPUT, OFFSETS, END, WEIGHTS, BIAS, OUTPUT, BYTES, STRIDE, P, K, W, AT] = Array(12).keys(), SUM = 12, PART = 20, WEIGHT = 22;
  const get = (local) => [0x20, ...leb(local)], set = (local) => [0x21, ...leb(local)], number = (value) => [0x41, ...leb(value)];
  const vector = (code, ...rest) => [0xfd, ...leb(code), ...rest];
  const load = (from, skip) => [...get(from), ...vector(0, 0, ...leb(skip))], splat = (from, skip) => [...get(from), ...vector(9, 0, ...leb(skip))];
  const store = (what, skip) => [...get(AT), ...get(what), ...vector(11, 0, ...leb(skip))];
  const plus = [0x6a], times = vector(230), sum = vector(228), channels = [...Array(GROUP).keys()];
  const advance = (local, step) => [...get(local), ...number(step), ...plus, ...set(local)];
  const again = (local, end) => [...get(local), ...get(end), 0x49, 0x0d, 0, 0x0b];   // lower: go on
  const start = channels.flatMap((c) => [...splat(BIAS, 4 * c), 0x22, ...leb(SUM + 2 * c), ...set(SUM + 2 * c + 1)]);
  const added = channels.flatMap((c) => [...splat(W, 4 * c), ...set(WEIGHT), ...[0, 1].flatMap((k) => [
    ...get(SUM + 2 * c + k), ...get(PART + k), ...get(WEIGHT), ...times, ...sum, ...set(SUM + 2 * c + k)])]);
  const taps = [...get(INPUT), ...get(P), ...plus, ...get(K), 0x28, 2, 0, ...plus, ...set(AT),
    ...load(AT, 0), ...set(PART), ...load(AT, 16), ...set(PART + 1), ...added, ...advance(K, 4), ...advance(W, 16)];
  const written = channels.flatMap((c) => [...store(SUM + 2 * c, 0), ...store(SUM + 2 * c + 1, 16), ...get(AT), ...get(STRIDE), ...plus, ...set(AT)]);
  const body = [2, 4, 0x7f, 11, 0x7b,   // locals: four places, eleven vectors
    0x03, 0x40, ...start, ...get(OFFSETS), ...set(K), ...get(WEIGHTS), ...set(W),
    0x03, 0x40, ...taps, ...again(K, END),
    ...get(OUTPUT), ...get(P), ...plus, ...set(AT), ...written, ...advance(P, 4 * LANES), ...again(P, BYTES), 0x0b];
  const part = (id, ...bytes) => [id, ...leb(bytes.length), ...bytes];
  const name = (text) => [text.length, ...new TextEncoder().encode(text)];
  return new Uint8Array([0, 0x61, 0x73, 0x6d, 1, 0, 0, 0,
    ...part(1, 1, 0x60, 8, ...Array(8).fill(0x7f), 0),
    ...part(2, 1, ...name("page"), ...name("memory"), 2, 0, 1),
    ...part(3, 1, 0),
    ...part(7, 1, ...name("conv"), 0, 0),
    ...part(10, 1, ...leb(body.length), ...body)]);
}

// The same in JavaScript, on the floats of a memory.
function plainKernel(memory) {
  return (input, offsets, end, weights, bias, output, bytes, stride) => {
    const floats = new Float32Array(memory.buffer), whole = new Uint32Array(memory.buffer), { fround } = Math, count = bytes / 4;
    for (let c = 0; c < GROUP; c++) {
      const to = (output + c * stride) / 4;
      for (let from = 0; from < count; from += 256) {   // short rows stay near at hand
        const stop = Math.min(count, from + 256);
        floats.fill(floats[bias / 4 + c], to + from, to + stop);
        for (let k = offsets / 4, w = weights / 4 + c; k < end / 4; k++, w += GROUP) {
          const weight = floats[w], start = (input + whole[k]) / 4;
          for (let p = from; p < stop; p++) floats[to + p] = fround(floats[to + p] + fround(weight * floats[start + p]));
        }
      }
    }
  };
}

// Memory for convolutions, and the kernel on it.
class Convolver {
  constructor(bytes, { plain = false } = {}) {
    const pages = Math.ceil(bytes / 65536);
    this.vectors = false;
    if (!plain) {
      try {
        this.memory = new WebAssembly.Memory({ initial: pages });
        const module = new WebAssembly.Module(kernelBytes());
        this.kernel = new WebAssembly.Instance(module, { page: { memory: this.memory } }).exports.conv;
        this.vectors = true;
      } catch { /* an old browser, or one whose policy keeps WebAssembly out */ }
    }
    if (!this.vectors) {
      this.memory = { buffer: new ArrayBuffer(65536 * pages) };
      this.kernel = plainKernel(this.memory);
    }
    this.floats = new Float32Array(this.memory.buffer);
    this.whole = new Uint32Array(this.memory.buffer);
    this.top = 0;
  }

  // Room for so many floats, at a place in bytes.
  take(count) {
    const at = this.top;
    this.top += Math.ceil(4 * count / 64) * 64;
    if (this.top > this.memory.buffer.byteLength) throw new Error(`${this.top} bytes do not fit into the memory of convolutions`);
    return at;
  }
}
