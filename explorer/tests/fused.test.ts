// The fused products against rational arithmetic, also where its error-free parts would underflow or overflow.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { Kernels } from "../src/kernels";

const kernels = await Kernels.load(readFileSync(join(process.cwd(), "../build/explorer/public/kernels.wasm")));
type Product = (a: number, b: number, c: number) => number;
const ofPair = kernels.wasm.probe_fma_of_pair as (a: number, b: number, c: number, lane: number) => number;
const PRODUCTS: Record<string, Product> = {
  alone: kernels.wasm.probe_fma as Product,
  first: (a, b, c) => ofPair(a, b, c, 0),
  second: (a, b, c) => ofPair(a, b, c, 1),
};
const view = new DataView(new ArrayBuffer(8));

// A finite number as an integer multiple of 2^-1074.
function integer(x: number): bigint {
  view.setFloat64(0, x);
  const bits = view.getBigUint64(0), exponent = (bits >> 52n) & 0x7ffn, fraction = bits & 0xfffffffffffffn;
  const size = exponent === 0n ? fraction : (fraction | (1n << 52n)) << (exponent - 1n);
  return bits >> 63n ? -size : size;
}

// The double nearest to n 2^-2148, to even at ties.
function rounded(n: bigint): number {
  const size = n < 0n ? -n : n, unit = 1074n;
  const length = BigInt(size.toString(2).length), drop = length - 53n > unit ? length - 53n : unit;
  const half = 1n << (drop - 1n), rest = size & ((1n << drop) - 1n);
  let kept = size >> drop;
  if (rest > half || (rest === half && kept & 1n)) kept += 1n;
  const power = Number(drop - 2n * unit);
  const result = Number(kept) * 2 ** Math.max(power, -1074) * (power < -1074 ? 2 ** (power + 1074) : 1);
  return n < 0n ? -result : result;
}

const exact = (a: number, b: number, c: number) => rounded(integer(a) * integer(b) + (integer(c) << 1074n));

// A reproducible generator of words (Marsaglia, 2003).
let word = 2463534242;
function next(): number {
  word ^= word << 13;
  word ^= word >>> 17;
  word ^= word << 5;
  return word >>> 0;
}

function drawn(exponents: number): number {
  const exponent = (next() % (2 * exponents + 1)) - exponents;
  const few = next() % 3 === 0; // ties need products of few digits
  const size = few ? (next() % 256) / 128 : (next() + next() / 2 ** 32) / 2 ** 31;
  return (next() % 2 ? -size : size) * 2 ** exponent;
}

for (const exponents of [3, 30, 60, 500])
  test(`exponents up to ${exponents}`, () => {
    for (let k = 0; k < 20000; ++k) {
      const a = drawn(exponents), b = drawn(exponents), p = a * b;
      const c = k % 4 === 0 ? -p : k % 4 === 1 ? p * 2 ** ((next() % 120) - 60) : drawn(exponents);
      if (!Number.isFinite(p) || !Number.isFinite(c) || !Number.isFinite(p + c)) continue;
      const expected = exact(a, b, c) + 0;
      for (const [name, fused] of Object.entries(PRODUCTS)) assert.equal(fused(a, b, c) + 0, expected, `${name}: ${a} ${b} ${c}`);
    }
  });

for (const [name, fused] of Object.entries(PRODUCTS)) test(`zeros, infinities and numbers that are none, ${name}`, () => {
  assert.ok(Object.is(fused(-0, 1, -0), -0) && Object.is(fused(0, 1, -0), 0) && Object.is(fused(3, 1, -3), 0));
  assert.equal(fused(1e300, 1e300, -Infinity), -Infinity);
  assert.equal(fused(1e300, 1e300, 1), Infinity);
  assert.equal(fused(1e200, 1e200, -1e308), Infinity);
  assert.equal(fused(2 ** -1000, 2 ** -100, 2 ** -1074), 2 ** -1074);
  assert.ok(Number.isNaN(fused(0, Infinity, 1)) && Number.isNaN(fused(NaN, 1, 1)));
  assert.ok(Object.is(fused(-0, 5, 2), 2) && Object.is(fused(0, -3, -0), -0) && Object.is(fused(2, -0, 0), 0));
});
