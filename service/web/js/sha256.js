// SHA-256 (FIPS 180-4) of a file. The browser's own is six to ten times as fast, but takes all bytes at once, and none at all
// of a page that came over plain HTTP from another machine: then, and of large files, a slice at a time.
const AT_ONCE = 2 ** 28;
const SLICE = 2 ** 22; // a multiple of the block of 64 bytes
const PRIMES = [...Array(312).keys()].filter((n) => n > 1 && ![...Array(n).keys()].some((d) => d > 1 && n % d === 0));
const fraction = (x) => ((x % 1) * 2 ** 32) | 0;
const K = Int32Array.from(PRIMES, (prime) => fraction(Math.cbrt(prime)));
const turned = (x, n) => (x >>> n) | (x << (32 - n));

/**
 * @param {Blob} file
 * @param {AbortSignal} signal
 * @param {(read: number) => void} tell  bytes so far
 * @returns {Promise<string>} 64 hexadecimal digits
 */
export async function sha256(file, signal, tell) {
  if (!crypto.subtle || file.size > AT_ONCE) return bySlices(file, signal, tell);
  tell(0);
  const digest = await crypto.subtle.digest("SHA-256", await file.arrayBuffer());
  signal.throwIfAborted();
  return hex(new DataView(digest));
}

/** The same, without the browser's own. */
export async function bySlices(file, signal, tell) {
  const state = Int32Array.from(PRIMES.slice(0, 8), (prime) => fraction(Math.sqrt(prime)));
  for (let start = 0; start + 64 <= file.size; start += SLICE) {
    signal.throwIfAborted();
    tell(start);
    const end = Math.min(start + SLICE, file.size);
    const bytes = await file.slice(start, end - (end % 64)).arrayBuffer();
    absorb(state, new DataView(bytes));
  }
  const rest = new Uint8Array(await file.slice(file.size - (file.size % 64)).arrayBuffer());
  const last = new Uint8Array(rest.length < 56 ? 64 : 128);
  last.set(rest);
  last[rest.length] = 0x80;
  new DataView(last.buffer).setBigUint64(last.length - 8, 8n * BigInt(file.size));
  absorb(state, new DataView(last.buffer));
  state.forEach((word, at) => last.set([word >>> 24, word >>> 16, word >>> 8, word], 4 * at));
  return hex(new DataView(last.buffer, 0, 32));
}

const hex = (view) => [0, 4, 8, 12, 16, 20, 24, 28].map((at) => view.getUint32(at).toString(16).padStart(8, "0")).join("");

function absorb(state, view) {
  const w = new Int32Array(64);
  for (let at = 0; at < view.byteLength; at += 64) {
    for (let i = 0; i < 16; i++) w[i] = view.getInt32(at + 4 * i);
    for (let i = 16; i < 64; i++) {
      const [early, late] = [w[i - 15], w[i - 2]];
      const s0 = turned(early, 7) ^ turned(early, 18) ^ (early >>> 3);
      const s1 = turned(late, 17) ^ turned(late, 19) ^ (late >>> 10);
      w[i] = w[i - 16] + s0 + w[i - 7] + s1;
    }
    let [a, b, c, d, e, f, g, h] = state;
    for (let i = 0; i < 64; i++) {
      const s1 = turned(e, 6) ^ turned(e, 11) ^ turned(e, 25);
      const t1 = (h + s1 + ((e & f) ^ (~e & g)) + K[i] + w[i]) | 0;
      const s0 = turned(a, 2) ^ turned(a, 13) ^ turned(a, 22);
      const t2 = (s0 + ((a & b) ^ (a & c) ^ (b & c))) | 0;
      [h, g, f, e, d, c, b, a] = [g, f, e, (d + t1) | 0, c, b, a, (t1 + t2) | 0];
    }
    const words = [a, b, c, d, e, f, g, h];
    for (let i = 0; i < 8; i++) state[i] += words[i];
  }
}
