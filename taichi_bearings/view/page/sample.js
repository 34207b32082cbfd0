/** The lattice and what is known of it; what depends on the slip threshold or the time is found by `judge`. */
class Sample {
  constructor(facts, arrays) {
    Object.assign(this, { facts, ...arrays });
    this.shape = facts.shape;
    this.dimension = this.shape.length;
    this.sites = this.shape.reduce((a, b) => a * b);
    this.along = this.dimension === 2 ? [0, 2] : [0, 1, 2];  // lattice axis -> axis of the world, height up
    this.cell = this.shape.map(() => new Int16Array(this.sites));
    this.place = new Float32Array(3 * this.sites);
    const stride = this.shape.map((_, k) => this.shape.slice(k + 1).reduce((a, b) => a * b, 1));
    for (let s = 0; s < this.sites; s++)
      for (let k = 0; k < this.dimension; k++) {
        const index = Math.floor(s / stride[k]) % this.shape[k];
        this.cell[k][s] = index;
        this.place[3 * s + this.along[k]] = index - (this.shape[k] - 1) / 2;
      }
    this.contacts = this.slip.length;
    this.axis = new Uint8Array(this.contacts);
    this.low = new Int32Array(this.contacts);
    this.high = new Int32Array(this.contacts);
    let c = 0;
    for (let k = 0; k < this.dimension; k++)
      for (let s = 0; s < this.sites; s++)
        if (this.cell[k][s] < this.shape[k] - 1 || facts.periodic.includes(k)) {
          this.axis[c] = k; this.low[c] = s; this.high[c] = s + stride[k] * (this.cell[k][s] < this.shape[k] - 1 ? 1 : 1 - this.shape[k]);
          c++;
        }
    this.lines = this.contacts + this.low.reduce((sum, s, c) => sum + this.isOver(c), 0);
    this.stride = stride;
    this.judged = new Uint8Array(this.contacts);
    this.piece = new Uint8Array(this.sites);
  }
  /** Whether a contact leads over a periodic side: it is drawn as two halves, at both sides. */
  isOver(c) { return this.high[c] < this.low[c]; }
  isDriven(s) { const z = this.cell[this.dimension - 1][s]; return z === 0 || z === this.shape[this.dimension - 1] - 1; }
  /** Spins and slips at a moment, the last of which is the answer of the run. */
  at(moment) {
    const kept = moment < this.facts.times.length;
    this.isEnd = !kept;
    this.spinNow = kept ? this.snapshot_spin.subarray(3 * this.sites * moment, 3 * this.sites * (moment + 1)) : this.spin;
    this.slipNow = kept ? this.snapshot_slip.subarray(this.contacts * moment, this.contacts * (moment + 1)) : this.slip;
  }
  /** What colours slipping contacts: their power, or the slip where power is not kept. */
  get valuesNow() { return this.isEnd ? this.power : this.slipNow; }
  /** Contact states by a slip threshold, or those of the run (null), and what the slipless ones join. */
  judge(threshold) {
    const limit = threshold ?? (this.isEnd ? null : this.facts.snapshot_threshold);
    this.counts = { slipless: 0, slipping: 0, undecided: 0 };
    for (let c = 0; c < this.contacts; c++) {
      const was = this.state[c];
      const is = was === DRIVEN || limit === null ? was : this.slipNow[c] > limit ? SLIPPING : SLIPLESS;
      this.judged[c] = is;
      if (is !== DRIVEN) this.counts[["slipless", "slipping", "undecided"][is]]++;
    }
    this.join();
  }
  /** The pieces of the slipless network: each driven plane is one body. */
  join() {
    const root = Int32Array.from({ length: this.sites }, (_, s) => s), touched = new Uint8Array(this.sites);
    const find = (s) => { while (root[s] !== s) s = root[s] = root[root[s]]; return s; };
    const height = this.cell[this.dimension - 1], top = this.sites - 1, highest = this.shape[this.dimension - 1] - 1;
    for (let s = 0; s < this.sites; s++) {
      if (height[s] === 0) root[s] = 0;
      if (height[s] === highest) root[s] = top;
    }
    for (let c = 0; c < this.contacts; c++)
      if (this.judged[c] === SLIPLESS) {
        touched[this.low[c]] = touched[this.high[c]] = 1;
        root[find(this.low[c])] = find(this.high[c]);
      }
    const bottom = find(0), upper = find(top);
    let reached = 0;
    for (let s = 0; s < this.sites; s++) {
      const mine = find(s), low = mine === bottom, high = mine === upper, driven = this.isDriven(s);
      this.piece[s] = low && high ? 0 : low ? 1 : high ? 2 : touched[s] ? 3 : 4;
      reached += touched[s] && !driven;
    }
    this.counts.spans = bottom === upper;
    this.counts.reached = reached / (this.sites - 2 * this.sites / this.shape[this.dimension - 1]);
  }
}

/** What is known of a sphere or contact, as rows of a name and a value. */
function numbersOf(sample, found) {
  const { facts } = sample, position = (s) => `(${sample.cell.map((index) => index[s]).join(", ")})`;
  if (found.sphere !== undefined) {
    const s = found.sphere, spin = [0, 1, 2].map((k) => sample.spinNow[3 * s + k]);
    const size = Math.hypot(...spin);
    const ofDomain = sample.domain_size[sample.domain[s]];
    const atEnd = !sample.isEnd ? [] : [["rigid domain", `${grouped(sample.domain[s])}, of ${grouped(ofDomain)} ${ofDomain === 1 ? "sphere" : "spheres"}`],
      ["locked to", KINDS[sample.kind[s]][0]], ["shortest paths", `${six(100 * sample.sphere_betweenness[s])} % visit it`]];
    return { title: `sphere ${position(s)}${sample.isDriven(s) ? ", driven" : ""}`, rows: [
      ["spin ω", `${sample.dimension === 2 ? six(spin[2]) : `(${spin.map(six).join(", ")})`} 1/time`],
      ["|ω| / ω max", six(size / facts.spin_max)], ["slipless network", PIECES[sample.piece[s]][0]], ...atEnd] };
  }
  const c = found.contact, name = "xyz"[sample.axis[c]], is = sample.judged[c], was = sample.state[c];
  const words = ["slipless", "slipping", "undecided", "between driven spheres or absent"];
  const byRun = sample.isEnd && is === was && facts.by_run;
  const how = is === DRIVEN ? "" : byRun ? `, ${facts.decided}` : ", by slip alone";
  const rows = [["state", words[is] + how], ["slip |v|", `${six(sample.slipNow[c])} length/time`]];
  if (sample.isEnd) {
    rows.push(["power P", `${six(sample.power[c])} energy/time`], ["force |f|", `${six(sample.force[c])} force`]);
    if (facts.friction_limit) rows.push(["|f| / (μ Fₙ)", six(sample.force[c] / (facts.normal_force * sample.coefficient[c]))]);
  } else rows.push(["power, force", "not kept with a snapshot"]);
  for (const { key, name: what, unit } of facts.coefficients) rows.push([what, six(sample[key][c]) + (unit === "1" ? "" : ` ${unit}`)]);
  if (sample.betweenness[c] > 0) rows.push(["shortest paths", `${six(100 * sample.betweenness[c])} % of pairs run through it`]);
  const part = [[CUT, "minimum cut"], [PATH, "shortest path"]].filter(([bit]) => sample.flags[c] & bit).map(([, text]) => text);
  if (part.length) rows.push(["belongs to", part.join(", ")]);
  return { title: `contact ${name} of sphere ${position(sample.low[c])}`, rows };
}
