// The compiled kernels in WebAssembly: their memory, their tables, and runs of one trajectory.

export type Fields = Record<string, number | ArrayLike<number>>;

interface Exports {
  memory: WebAssembly.Memory;
  _initialize?: () => void;
  malloc(size: number): number;
  free(at: number): void;
  description(): number;
  taylor_address(): number;
  isospectral_address(): number;
  [name: string]: unknown;
}

type Loop = (
  tables: number, watch: number, members: number, first: bigint, last: bigint, stride: bigint, extent: number,
  schedule: number, saved: number, state: number, k0: bigint, k1: bigint, stop: number,
) => bigint;

interface Field {
  kind: string;
  name: string;
  offset: number;
}

interface Layout {
  fields: Field[];
  size: number;
}

const SCALARS = new Set(["integer", "number", "flag"]);
const POINTERS: Record<string, number> = { bytes: 1, indices: 4, integers: 8, addresses: 8, numbers: 8, constants: 8 };
// A run has no last step: it is continued as long as it is shown.
const STEPS = 2 ** 40;

export class Kernels {
  readonly layouts: Record<string, Layout> = {};
  readonly saved: Array<{ kind: string; name: string; axes: string[] }>;
  readonly state: Array<{ kind: string; name: string; axes: string[] }>;
  readonly codes: Record<string, Record<string, number>> = {};

  private constructor(readonly wasm: Exports) {
    const lines = this.text(wasm.description()).split("\n").filter(Boolean);
    const arrays: Record<string, Array<{ kind: string; name: string; axes: string[] }>> = {};
    for (const line of lines) {
      const [head, rest] = [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 1)];
      const [section, name] = head.split(" ");
      const entries = rest.split(";").filter(Boolean).map((entry) => entry.split(" "));
      if (section === "table") this.layouts[name] = this.layout(entries);
      else if (section === "codes") this.codes[name] = Object.fromEntries(entries.map(([label, code]) => [label, Number(code)]));
      else arrays[name] = entries.map(([kind, label, ...axes]) => ({ kind, name: label, axes: axes.filter((_, k) => k % 2 === 0) }));
    }
    this.saved = arrays.saved;
    this.state = arrays.state;
  }

  static async load(bytes: BufferSource | Response): Promise<Kernels> {
    let memory: WebAssembly.Memory | undefined;
    const refused = () => 52; // ENOSYS
    const system = {
      clock_time_get: (_id: number, _precision: bigint, at: number) => {
        new DataView(memory!.buffer).setBigUint64(at, BigInt(Math.round(performance.now() * 1e6)), true);
        return 0;
      },
      proc_exit: (code: number) => {
        throw new Error(`the kernels ended with code ${code}`);
      },
    };
    const any = (known: object) => new Proxy(known, { get: (target, name) => Reflect.get(target, name) ?? refused });
    const imports = { wasi_snapshot_preview1: any(system), env: any({ emscripten_notify_memory_growth: () => undefined }) };
    const source = bytes instanceof Response ? await bytes.arrayBuffer() : bytes;
    const { instance } = await WebAssembly.instantiate(source, imports as unknown as WebAssembly.Imports);
    const wasm = instance.exports as unknown as Exports;
    memory = wasm.memory;
    wasm._initialize?.();
    return new Kernels(wasm);
  }

  private text(at: number): string {
    const bytes = new Uint8Array(this.wasm.memory.buffer);
    let end = at;
    while (bytes[end]) ++end;
    return new TextDecoder().decode(bytes.subarray(at, end));
  }

  // As the C++ compiler places them: numbers of eight bytes, pointers of four.
  private layout(entries: string[][]): Layout {
    let size = 0;
    const fields = entries.map(([kind, name]) => {
      const width = kind in POINTERS ? 4 : SCALARS.has(kind) ? 8 : this.layouts[kind].size;
      const align = kind in POINTERS ? 4 : 8;
      const offset = Math.ceil(size / align) * align;
      size = offset + width;
      return { kind, name, offset };
    });
    return { fields, size: Math.ceil(size / 8) * 8 };
  }

  run(loop: string, fields: Fields, size: number, invariants: number): Run {
    return new Run(this, loop, fields, size, invariants);
  }
}

const TABLES: Record<string, string> = {
  flow_advance: "FlowTables",
  runge_kutta_advance: "RungeKuttaTables",
  stepping_advance: "Stepping",
};

export interface Points {
  count: number;
  x: Float64Array; // count * size
  group: (point: number) => Float64Array; // the group element at a point, row after row; empty if none is computed
  values: Float64Array; // count * invariants
}

// One trajectory in the memory of the kernels.
export class Run {
  step = 0;
  failure = "";
  private readonly allocated: number[] = [];
  private readonly tables: number;
  private readonly watch: number;
  private readonly extent: number;
  private readonly schedule: number;
  private readonly state: number;
  private readonly members: number;
  private readonly stop: number;
  private saved = 0;
  private capacity = 0;
  private readonly memorySize: number;
  private readonly rows: number; // of the group element

  constructor(
    private readonly kernels: Kernels, private readonly loop: string, fields: Fields, readonly size: number, readonly invariants: number,
  ) {
    const kind = TABLES[loop];
    if (!kind) throw new Error(`${loop} is no loop of the kernels`);
    this.tables = this.table(kind, "tables.", fields);
    this.watch = this.table("Watch", "watch.", fields);
    this.rows = Number(fields["tables.group.size"] ?? fields["tables.tables.group.size"]);
    if (loop === "stepping_advance") {
      const pointer = this.offset("Stepping", "step");
      const at = this.view.getUint32(this.tables + pointer, true);
      const { taylor_address, isospectral_address } = kernels.wasm;
      const address = this.view.getBigInt64(at, true) ? isospectral_address() : taylor_address();
      this.view.setBigInt64(at, BigInt(address), true);
    }
    const memorySize = kernels.wasm[`${loop}_memory_size`] as ((tables: number) => bigint) | undefined;
    this.memorySize = memorySize ? Number(memorySize(this.tables)) : 0;
    this.extent = this.allocate(kernels.layouts.Extent.size);
    this.schedule = this.allocate(kernels.layouts.Schedule.size);
    this.members = this.allocate(8);
    this.stop = this.allocate(8);
    this.writeExtent(0);
    this.state = this.allocate(8 * this.length(kernels.state));
  }

  private get view(): DataView {
    return new DataView(this.kernels.wasm.memory.buffer);
  }

  private allocate(bytes: number): number {
    const at = this.kernels.wasm.malloc(Math.max(bytes, 8));
    if (!at) throw new Error("the kernels have no more memory");
    new Uint8Array(this.kernels.wasm.memory.buffer, at, Math.max(bytes, 8)).fill(0);
    this.allocated.push(at);
    return at;
  }

  free(): void {
    for (const at of this.allocated) this.kernels.wasm.free(at);
    if (this.saved) this.kernels.wasm.free(this.saved);
    this.allocated.length = 0;
    this.saved = 0;
  }

  private offset(table: string, name: string): number {
    return this.kernels.layouts[table].fields.find((field) => field.name === name)!.offset;
  }

  private table(kind: string, path: string, fields: Fields, at = this.allocate(this.kernels.layouts[kind].size)): number {
    for (const field of this.kernels.layouts[kind].fields) {
      const value = fields[path + field.name];
      const here = at + field.offset;
      if (field.kind in POINTERS) {
        if (typeof value === "number" || value === undefined) throw new Error(`${path}${field.name} is no array`);
        this.view.setUint32(here, this.array(field.kind, value), true);
      } else if (SCALARS.has(field.kind)) {
        if (typeof value !== "number") throw new Error(`${path}${field.name} is no number`);
        this.scalar(field.kind, here, value);
      } else this.table(field.kind, `${path}${field.name}.`, fields, here);
    }
    return at;
  }

  private scalar(kind: string, at: number, value: number): void {
    if (kind === "number") this.view.setFloat64(at, value, true);
    else this.view.setBigInt64(at, BigInt(value), true);
  }

  private array(kind: string, values: ArrayLike<number>): number {
    const width = POINTERS[kind];
    const at = this.allocate(width * values.length);
    const { view } = this;
    for (let k = 0; k < values.length; ++k) {
      if (width === 1) view.setUint8(at + k, values[k]);
      else if (width === 4) view.setUint32(at + 4 * k, values[k], true);
      else if (kind === "integers" || kind === "addresses") view.setBigInt64(at + 8 * k, BigInt(values[k]), true);
      else view.setFloat64(at + 8 * k, values[k], true);
    }
    return at;
  }

  private axes(points: number): Record<string, number> {
    return {
      members: 1, points, size: this.size, square: this.rows ** 2, invariants: this.invariants, memory_size: this.memorySize,
      ...this.kernels.codes.Limit,
    };
  }

  private length(arrays: Array<{ axes: string[] }>, points = 0): number {
    const axes = this.axes(points);
    return arrays.reduce((sum, array) => sum + array.axes.reduce((product, axis) => product * axes[axis], 1), 0);
  }

  private positionOf(arrays: Array<{ name: string; axes: string[] }>, wanted: string, points: number): number {
    return 8 * this.length(arrays.slice(0, arrays.findIndex((array) => array.name === wanted)), points);
  }

  private writeExtent(points: number): void {
    const axes = this.axes(points);
    for (const { name, offset } of this.kernels.layouts.Extent.fields) this.scalar("integer", this.extent + offset, axes[name]);
  }

  private writeSchedule(h: number, passed: number): void {
    const values: Record<string, number> = { h, steps: STEPS, save_every: 1, passed, threads: 1 };
    for (const { kind, name, offset } of this.kernels.layouts.Schedule.fields)
      if (SCALARS.has(kind)) this.scalar(kind, this.schedule + offset, values[name] ?? 0);
      else this.view.setUint32(this.schedule + offset, 0, true);
  }

  // Begin at a state, with the unit element of the group.
  begin(x0: ArrayLike<number>): void {
    const { view } = this;
    const momenta = this.state + this.positionOf(this.kernels.state, "momenta", 0);
    for (let i = 0; i < this.size; ++i) view.setFloat64(momenta + 8 * i, x0[i], true);
    const group = this.state + this.positionOf(this.kernels.state, "groups", 0);
    for (let i = 0; i < this.rows; ++i) view.setFloat64(group + 8 * i * (this.rows + 1), 1, true);
    this.step = 0;
    this.failure = "";
  }

  // Take steps of length h, and return the states after each; the first call returns the start too.
  advance(steps: number, h: number): Points {
    const points = steps + (this.step === 0 ? 1 : 0);
    if (points > this.capacity) {
      if (this.saved) this.kernels.wasm.free(this.saved);
      this.saved = this.kernels.wasm.malloc(8 * this.length(this.kernels.saved, points));
      this.capacity = points;
    }
    this.writeExtent(points);
    this.writeSchedule(h, this.step === 0 ? 0 : this.step + 1);
    const loop = this.kernels.wasm[this.loop] as Loop;
    const failed = loop(
      this.tables, this.watch, this.members, 0n, 1n, 0n, this.extent, this.schedule, this.saved, this.state,
      BigInt(this.step), BigInt(this.step + steps), this.stop,
    );
    let count = points;
    if (failed !== 0n) {
      const step = this.result("step"), status = this.result("status");
      count = Math.max(0, step - this.step - (this.step === 0 ? 0 : 1)); // the states before it
      const { OVERFLOWED, TOO_LONG, UNDEFINED } = this.kernels.codes.Status;
      const reasons: Record<number, string> = {
        [OVERFLOWED]: "a number overflowed", [TOO_LONG]: "a flow is too long", [UNDEFINED]: "the body turns too far",
      };
      this.failure = `Step ${step} failed: ${reasons[status] ?? "an iteration did not converge"}. Take a smaller step h.`;
    }
    this.step += steps;
    const numbers = (name: string, width: number) => {
      const at = this.saved + this.positionOf(this.kernels.saved, name, points);
      return new Float64Array(this.kernels.wasm.memory.buffer, at, count * width).slice();
    };
    // The kernels store transposes.
    const { rows } = this, groups = numbers("group", rows ** 2);
    const group = (point: number) =>
      Float64Array.from({ length: rows ** 2 }, (_, k) => groups[point * rows ** 2 + (k % rows) * rows + Math.floor(k / rows)]);
    return { count, x: numbers("x", this.size), group, values: numbers("values", this.invariants) };
  }

  // An integer of the state: the status, or the step that failed.
  private result(name: string): number {
    return Number(this.view.getBigInt64(this.state + this.positionOf(this.kernels.state, name, 0), true));
  }
}
