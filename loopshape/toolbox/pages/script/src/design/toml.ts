// TOML as Python writes it (io/toml_text.py), and a reader of what stands in controller and requirements files.

export type Toml = string | number | boolean | Toml[] | { [key: string]: Toml };
export type Table = { [key: string]: Toml };

const isTable = (value: Toml): value is Table => typeof value === "object" && !Array.isArray(value);
const isTables = (value: Toml): value is Table[] => Array.isArray(value) && value.length > 0 && value.every(isTable);
const keyText = (key: string): string => (/^[A-Za-z0-9_-]+$/.test(key) ? key : JSON.stringify(key));

/** A number that Python reads as a float and prints in the same digits. */
export function floatText(value: number): string {
  const [mantissa, power] = Math.abs(value).toExponential().split("e");
  const digits = mantissa.replace(".", "");
  const exponent = Number(power);
  const sign = value < 0 || Object.is(value, -0) ? "-" : "";
  if (exponent >= 16 || exponent < -4) {
    const size = String(Math.abs(exponent)).padStart(2, "0");
    return `${sign}${mantissa}e${exponent < 0 ? "-" : "+"}${size}`;
  }
  if (exponent < 0) return `${sign}0.${"0".repeat(-exponent - 1)}${digits}`;
  const whole = digits.slice(0, exponent + 1).padEnd(exponent + 1, "0");
  return `${sign}${whole}.${digits.slice(exponent + 1) || "0"}`;
}

/** A whole number, written without a point. */
export class Whole {
  constructor(readonly value: number) {}
}

type Writable = string | number | boolean | Whole | Writable[] | { [key: string]: Writable };

function inline(value: Writable): string {
  if (value instanceof Whole) return String(value.value);
  if (typeof value === "number") return floatText(value);
  if (typeof value === "string") return JSON.stringify(value);
  if (typeof value === "boolean") return String(value);
  if (Array.isArray(value)) return `[${value.map(inline).join(", ")}]`;
  const pairs = Object.entries(value).map(([key, one]) => `${keyText(key)} = ${inline(one)}`);
  return pairs.length ? `{ ${pairs.join(", ")} }` : "{}";
}

function pair(key: string, value: Writable): string {
  const rows = Array.isArray(value) && value.length > 0 && value.every((x) => typeof x === "object" && !(x instanceof Whole));
  if (!rows) return `${keyText(key)} = ${inline(value)}`;
  return `${keyText(key)} = [\n${(value as Writable[]).map((row) => `  ${inline(row)},\n`).join("")}]`;
}

/** A file of plain pairs, `[tables]` and one list of `[[tables]]`. */
export function tomlText(top: Record<string, Writable>, tables: Record<string, Record<string, Writable>>, lists: Record<string, Record<string, Writable>[]>): string {
  const lines = Object.entries(top).map(([key, value]) => pair(key, value));
  for (const [name, table] of Object.entries(tables)) {
    lines.push("", `[${keyText(name)}]`, ...Object.entries(table).map(([key, value]) => pair(key, value)));
  }
  for (const [name, list] of Object.entries(lists)) {
    for (const table of list) {
      lines.push("", `[[${keyText(name)}]]`, ...Object.entries(table).map(([key, value]) => pair(key, value)));
    }
  }
  return `${lines.join("\n")}\n`;
}

/** Reads TOML; an Error's message has the line where it stops and why. */
export function readToml(text: string): Table {
  return new Reader(text).file();
}

class Reader {
  private at = 0;
  constructor(private readonly text: string) {}

  file(): Table {
    const top: Table = {};
    let here = top;
    for (;;) {
      this.blank();
      if (this.at >= this.text.length) return top;
      if (this.taken("[[")) here = this.listed(top, this.path("]]"));
      else if (this.taken("[")) here = this.opened(top, this.path("]"));
      else this.assign(here);
      this.endOfLine();
    }
  }

  private fail(why: string): never {
    const line = this.text.slice(0, this.at).split("\n").length;
    throw new Error(`line ${line}: ${why}`);
  }

  private taken(sign: string): boolean {
    if (!this.text.startsWith(sign, this.at)) return false;
    this.at += sign.length;
    return true;
  }

  private space(): void {
    while (this.text[this.at] === " " || this.text[this.at] === "\t") this.at += 1;
  }

  private blank(): void {
    for (;;) {
      this.space();
      if (this.text[this.at] === "#") while (this.at < this.text.length && this.text[this.at] !== "\n") this.at += 1;
      if (this.text[this.at] !== "\n" && this.text[this.at] !== "\r") return;
      this.at += 1;
    }
  }

  private endOfLine(): void {
    this.space();
    if (this.at < this.text.length && !/[#\r\n]/.test(this.text[this.at])) this.fail("more stands here than one value");
  }

  private key(): string {
    this.space();
    if (this.text[this.at] === '"' || this.text[this.at] === "'") return this.string();
    const found = /^[A-Za-z0-9_-]+/.exec(this.text.slice(this.at, this.at + 200));
    if (!found) this.fail("a name is expected");
    this.at += found[0].length;
    return found[0];
  }

  private keys(): string[] {
    const out = [this.key()];
    this.space();
    while (this.taken(".")) {
      out.push(this.key());
      this.space();
    }
    return out;
  }

  private path(end: string): string[] {
    const out = this.keys();
    if (!this.taken(end)) this.fail(`${end} is missing`);
    return out;
  }

  private opened(top: Table, path: string[]): Table {
    return path.reduce<Table>((table, key) => {
      const known = (table[key] ??= {});
      const last = isTables(known) ? known[known.length - 1] : known;
      return isTable(last) ? last : this.fail(`${key} is given twice`);
    }, top);
  }

  private listed(top: Table, path: string[]): Table {
    const parent = this.opened(top, path.slice(0, -1));
    const list = (parent[path[path.length - 1]] ??= []);
    if (!Array.isArray(list)) this.fail(`${path.join(".")} is given twice`);
    const made: Table = {};
    list.push(made);
    return made;
  }

  private assign(table: Table): void {
    const path = this.keys();
    const inner = this.opened(table, path.slice(0, -1));
    const key = path[path.length - 1];
    if (!this.taken("=")) this.fail(`= is missing behind ${key}`);
    if (Object.hasOwn(inner, key)) this.fail(`${key} is given twice`);
    inner[key] = this.value();
  }

  private value(): Toml {
    this.space();
    const sign = this.text[this.at];
    if (sign === '"' || sign === "'") return this.string();
    if (sign === "[") return this.list();
    if (sign === "{") return this.table();
    const found = /^[^\s,\]}#]+/.exec(this.text.slice(this.at, this.at + 400));
    if (!found) this.fail("a value is missing");
    this.at += found[0].length;
    if (found[0] === "true" || found[0] === "false") return found[0] === "true";
    const plain = found[0].replaceAll("_", "");
    const value = /^[+-]?(\d+(\.\d+)?([eE][+-]?\d+)?)$/.test(plain) ? Number(plain) : NaN;
    if (!Number.isFinite(value)) this.fail(`${found[0]} is no number; words stand in quotation marks`);
    return value;
  }

  private list(): Toml[] {
    this.at += 1;
    const out: Toml[] = [];
    for (;;) {
      this.blank();
      if (this.taken("]")) return out;
      out.push(this.value());
      this.blank();
      if (!this.taken(",") && this.text[this.at] !== "]") this.fail("a list has a comma between its values, and ends with ]");
    }
  }

  private table(): Table {
    this.at += 1;
    const out: Table = {};
    for (;;) {
      this.blank();
      if (this.taken("}")) return out;
      this.assign(out);
      this.blank();
      if (!this.taken(",") && this.text[this.at] !== "}") this.fail("an inline table has a comma between its pairs, and ends with }");
    }
  }

  private string(): string {
    const sign = this.text[this.at];
    const end = sign === "'" ? this.text.indexOf("'", this.at + 1) : this.closing();
    const line = this.text.indexOf("\n", this.at);
    if (end < 0 || (line >= 0 && line < end)) this.fail("quotation marks are not closed");
    const inside = this.text.slice(this.at + 1, end);
    this.at = end + 1;
    if (sign === "'") return inside;
    try {
      return JSON.parse(`"${inside.replaceAll("\t", "\\t")}"`) as string;
    } catch {
      return this.fail("a word has an unknown sequence behind \\");
    }
  }

  private closing(): number {
    for (let k = this.at + 1; k < this.text.length; k++) {
      if (this.text[k] === "\\") k += 1;
      else if (this.text[k] === '"') return k;
    }
    return -1;
  }
}
