// Random numbers by coordinate, to the bit those of core/seeds.py, engine/random.py and engine/gaussian_random.py. A word of 64
// bits is two of 32, low and high, since numbers here are exact up to 53 bits.
"use strict";

// BLAKE2b (RFC 7693): its initial words, and the order of the message's words in each of the rounds.
const BLAKE = [0xf3bcc908, 0x6a09e667, 0x84caa73b, 0xbb67ae85, 0xfe94f82b, 0x3c6ef372, 0x5f1d36f1, 0xa54ff53a,
  0xade682d1, 0x510e527f, 0x2b3e6c1f, 0x9b05688c, 0xfb41bd6b, 0x1f83d9ab, 0x137e2179, 0x5be0cd19];
const SIGMA = ["0123456789abcdef", "ea489fd61c02b753", "b8c052fdae367194", "7931dcbe265a40f8", "905724afe1bc683d", "2c6a0b834d75fe19",
  "c51fed4a0763928b", "db7ec13950f4862a", "6fe9b308c2d714a5", "a2847615fb9e3cd0", "0123456789abcdef", "ea489fd61c02b753"];
const MIXED = [[0, 4, 8, 12], [1, 5, 9, 13], [2, 6, 10, 14], [3, 7, 11, 15], [0, 5, 10, 15], [1, 6, 11, 12], [2, 7, 8, 13], [3, 4, 9, 14]];

function addWord(v, a, low, high) {
  const sum = v[2 * a] + low;
  v[2 * a] = sum;
  v[2 * a + 1] = v[2 * a + 1] + high + (sum > 0xffffffff ? 1 : 0);
}

// v[a] = (v[a] xor v[b]), turned right by a number of bits.
function turnWord(v, a, b, bits) {
  let low = v[2 * a] ^ v[2 * b], high = v[2 * a + 1] ^ v[2 * b + 1];
  if (bits >= 32) [low, high] = [high, low];
  const rest = bits % 32;
  v[2 * a] = rest ? (low >>> rest) | (high << (32 - rest)) : low;
  v[2 * a + 1] = rest ? (high >>> rest) | (low << (32 - rest)) : high;
}

// The key [low, high] of a stage of a seed: BLAKE2b of "seed/stage" in 8 bytes, of at most 128 letters.
function seedKey(seed, stage) {
  const bytes = new Uint8Array(128), text = new TextEncoder().encode(`${seed}/${stage}`);
  bytes.set(text);
  const message = new DataView(bytes.buffer), v = new Uint32Array(32);
  v.set(BLAKE);
  v.set(BLAKE, 16);
  v[0] ^= 0x01010008;
  v[24] ^= text.length;
  v[28] = ~v[28];
  v[29] = ~v[29];
  for (const order of SIGMA) {
    MIXED.forEach(([a, b, c, d], i) => {
      const [x, y] = [0, 1].map((k) => 8 * parseInt(order[2 * i + k], 16));
      const word = (at) => [message.getUint32(at, true), message.getUint32(at + 4, true)];
      const step = (at, far, near) => {
        addWord(v, a, v[2 * b], v[2 * b + 1]);
        addWord(v, a, ...word(at));
        turnWord(v, d, a, far);
        addWord(v, c, v[2 * d], v[2 * d + 1]);
        turnWord(v, b, c, near);
      };
      step(x, 32, 24);
      step(y, 16, 63);
    });
  }
  return [0, 1].map((k) => (BLAKE[k] ^ (k ? 0 : 0x01010008) ^ v[k] ^ v[16 + k]) >>> 0);
}

// The upper 32 bits of a product of two words of 32, by halves: no product of halves passes 53 bits.
function highProduct(a, b) {
  const a0 = a & 0xffff, a1 = a >>> 16, b0 = b & 0xffff, b1 = b >>> 16;
  const one = a1 * b0 + ((a0 * b0) >>> 16), two = a0 * b1 + (one & 0xffff);
  return (a1 * b1 + (one >>> 16) + (two >>> 16)) >>> 0;
}

// Philox4x32-10 (Salmon et al. 2011) of a counter of four words under a key, into `words`.
function philox([k0, k1], c0, c1, c2, c3, words) {
  let [x0, x1, x2, x3] = [c0, c1, c2, c3];
  for (let round = 0; round < 10; round++) {
    const [high0, low0] = [highProduct(0xd2511f53, x0 >>> 0), Math.imul(0xd2511f53, x0)];
    const [high1, low1] = [highProduct(0xcd9e8d57, x2 >>> 0), Math.imul(0xcd9e8d57, x2)];
    [x0, x1, x2, x3] = [high1 ^ x1 ^ k0, low1, high0 ^ x3 ^ k1, low0];
    k0 = (k0 + 0x9e3779b9) | 0;
    k1 = (k1 + 0xbb67ae85) | 0;
  }
  words[0] = x0;
  words[1] = x1;
  words[2] = x2;
  words[3] = x3;
}

// Standard normal numbers of the cells from `corner` (z, y, x) on, (channels, Z, Y, X) float32: eight channels a draw, each 16 bits
// that choose a quantile of `table` (65536, in 1 / 4096).
function normalCells(cells, channels, [depth, height, width], key, corner, table) {
  const words = new Uint32Array(4), size = depth * height * width;
  for (let z = 0, at = 0; z < depth; z++) {
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++, at++) {
        for (let c = 0; c < channels; c++) {
          if (c % 8 === 0) philox(key, corner[0] + z, corner[1] + y, corner[2] + x, c >> 3, words);
          cells[c * size + at] = table[(words[(c % 8) >> 1] >>> (16 * (c & 1))) & 0xffff] / 4096;
        }
      }
    }
  }
}
