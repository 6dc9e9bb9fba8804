// Numbers of the run: arrays from bytes, random numbers, small linear algebra.

/** The array of a packed tree {shape, f8|f4|u2: base64}; a nested list is flattened. */
export function arrayOf(packed) {
  if (typeof packed === "number") return Float64Array.of(packed);
  if (Array.isArray(packed)) return Float64Array.from(packed.flat(Infinity));
  const [kind] = Object.keys(READ).filter((name) => name in packed);
  const text = atob(packed[kind]);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const view = new DataView(bytes.buffer);
  const [size, read] = READ[kind];
  return Float64Array.from({ length: bytes.length / size }, (_, i) => view[read](size * i, true));
}

/** Bytes of a number, and what reads it, by the name that Python's NumPy gives it. */
const READ = { f8: [8, "getFloat64"], f4: [4, "getFloat32"], u2: [2, "getUint16"] };

/** Number of rows of a packed or listed array. */
export function rowsOf(packed) {
  return Array.isArray(packed) ? packed.length : packed.shape[0];
}

/** Uniform random numbers in [0, 1), repeatable by their seed (mulberry32). */
export function uniformGenerator(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let z = state;
    z = Math.imul(z ^ (z >>> 15), z | 1);
    z ^= z + Math.imul(z ^ (z >>> 7), z | 61);
    return ((z ^ (z >>> 14)) >>> 0) / 4294967296;
  };
}

/** Standard normal random numbers (Box and Muller). */
export function normalGenerator(seed) {
  const uniform = uniformGenerator(seed);
  let spare = null;
  return () => {
    if (spare !== null) {
      const value = spare;
      spare = null;
      return value;
    }
    const radius = Math.sqrt(-2 * Math.log(1 - uniform()));
    const angle = 2 * Math.PI * uniform();
    spare = radius * Math.sin(angle);
    return radius * Math.cos(angle);
  };
}

/** log det(I + A) of a symmetric positive A, by Cholesky; A is overwritten. */
export function logDeterminantOfOnePlus(matrix, n) {
  let total = 0;
  for (let i = 0; i < n; i++) matrix[i * n + i] += 1;
  for (let j = 0; j < n; j++) {
    for (let i = j; i < n; i++) {
      let value = matrix[i * n + j];
      for (let k = 0; k < j; k++) value -= matrix[i * n + k] * matrix[j * n + k];
      matrix[i * n + j] = i === j ? Math.sqrt(Math.max(value, 1e-300)) : value / matrix[j * n + j];
    }
    total += 2 * Math.log(matrix[j * n + j]);
  }
  return total;
}

/** A number for a reader, to so many significant digits. */
export function shown(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return value.toExponential(digits - 1).replace("-", "−");
  return String(Number(value.toPrecision(digits))).replace("-", "−");
}
