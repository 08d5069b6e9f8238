// numpy's default generator (PCG64, O'Neill 2014) and its normal numbers (ziggurat, Marsaglia and Tsang 2000).

/** A generator's state as Python writes it: two numbers of 128 bits in hexadecimal digits. */
export interface State {
  state: string;
  inc: string;
}

const MULTIPLIER = 0x2360ed051fc65da44385df649fccf645n;
const MASK_128 = (1n << 128n) - 1n;
const MASK_64 = (1n << 64n) - 1n;
const RIGHTMOST = 3.6541528853610087963519472518;
const AREA = 0.00492867323399;
const TWO_52 = 4503599627370496;

function layers(): { x: Float64Array; f: Float64Array } {
  const x = new Float64Array(256);
  x[255] = RIGHTMOST;
  for (let k = 254; k > 0; k--) {
    x[k] = Math.sqrt(-2 * Math.log(areaExact / x[k + 1] + Math.exp(-0.5 * x[k + 1] ** 2)));
  }
  x[0] = areaExact / Math.exp(-0.5 * RIGHTMOST ** 2);
  return { x, f: x.map((value, k) => (k === 0 ? 1 : Math.exp(-0.5 * value * value))) };
}

/** Area of a layer to all digits: the rectangle up to the rightmost edge, and the tail past it. */
const areaExact = RIGHTMOST * Math.exp(-0.5 * RIGHTMOST ** 2) + tail(RIGHTMOST);

function tail(x: number): number {
  let fraction = 0;
  for (let k = 60; k > 0; k--) fraction = k / (x + fraction);
  return Math.exp(-0.5 * x * x) / (x + fraction);
}

/** Normal numbers in numpy's order. */
export class Normals {
  private state: bigint;
  private readonly inc: bigint;
  private readonly layers = layers();

  constructor(from: State) {
    if (Math.abs(areaExact - AREA) > 1e-12) throw new Error("the ziggurat's area is off");
    this.state = BigInt(`0x${from.state}`);
    this.inc = BigInt(`0x${from.inc}`);
  }

  private next(): bigint {
    this.state = (this.state * MULTIPLIER + this.inc) & MASK_128;
    const high = this.state >> 64n;
    const value = high ^ (this.state & MASK_64);
    const turn = high >> 58n;
    return ((value >> turn) | (value << (64n - turn))) & MASK_64;
  }

  /** One number between 0 and 1. */
  uniform(): number {
    return Number(this.next() >> 11n) / 9007199254740992;
  }

  /** One normal number. */
  one(): number {
    const { x, f } = this.layers;
    for (;;) {
      const bits = this.next();
      const low = Number(bits & 0x1ffn);
      const index = low & 0xff;
      const size = Number((bits >> 9n) & 0xfffffffffffffn);
      const sign = low & 0x100 ? -1 : 1;
      const value = (size * x[index]) / TWO_52;
      if (index === 0) {
        if (value < RIGHTMOST) return sign * value;
        return this.tail(Math.floor(size / 256) % 2 === 1);
      }
      if (index > 1 && value < x[index - 1]) return sign * value;
      if ((f[index - 1] - f[index]) * this.uniform() + f[index] < Math.exp(-0.5 * value * value)) return sign * value;
    }
  }

  private tail(negative: boolean): number {
    for (;;) {
      const far = -Math.log1p(-this.uniform()) / RIGHTMOST;
      const near = -Math.log1p(-this.uniform());
      if (near + near > far * far) return negative ? -(RIGHTMOST + far) : RIGHTMOST + far;
    }
  }

  /** The next numbers. */
  take(count: number): Float64Array {
    const out = new Float64Array(count);
    for (let k = 0; k < count; k++) out[k] = this.one();
    return out;
  }
}
