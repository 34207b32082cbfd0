/** A bearing and what is known of it; `judge` finds what depends on the slip threshold or the time.
 * In coordinates of the picture ("world") its middle is at 0, its height is up, and a sphere of median size has diameter 1. */
class Sample {
  constructor(facts, arrays) {
    const spheres = arrays.radius.length, contacts = arrays.slip.length, dimension = arrays.center.length / spheres;
    const absent = { betweenness: new Float32Array(contacts), flags: new Uint8Array(contacts), kind: new Uint8Array(spheres).fill(KINDS.length - 1), path: [], domain: new Int32Array(spheres), domain_size: [spheres] };
    Object.assign(this, { facts, spheres, contacts, dimension, ...absent, ...arrays });
    this.has = (name) => name in arrays;
    const { center, radius, normal, first, second } = this, unit = 2 * radius.slice().sort()[spheres >> 1];
    const along = dimension === 2 ? [0, 2] : [0, 1, 2];  // axis -> axis of the world
    this.size = radius.map((r) => 2 * r / unit);
    this.place = new Float32Array(3 * spheres);
    this.way = new Float32Array(3 * contacts);  // from the first centre to the second
    this.over = new Uint8Array(contacts);  // 1 for contacts across a periodic side, which are drawn as two parts
    for (let c = 0, s = 0; c < contacts; c++) { s = first[c] += s; second[c] += s; }
    const axes = facts.steps.map((steps, k) => {
      let low = Infinity, high = -Infinity, least = Infinity, most = -Infinity;
      for (let s = 0; s < spheres; s++) {
        const x = center[spheres * k + s];
        low = Math.min(low, x - radius[s]); high = Math.max(high, x + radius[s]); least = Math.min(least, x); most = Math.max(most, x);
      }
      for (let s = 0; s < spheres; s++) this.place[3 * s + along[k]] = (center[spheres * k + s] - (low + high) / 2) / unit;
      for (let c = 0; c < contacts; c++) this.way[3 * c + along[k]] = normal[contacts * k + c] * (radius[first[c]] + radius[second[c]]) / unit;
      const step = (most - least) / steps || 1, cell = new Int16Array(spheres).map((_, s) => Math.round((center[spheres * k + s] - least) / step));
      return { side: (high - low) / unit, cell, steps: most > least ? steps : 0, at: (number) => (facts.origin[k] + least + number * step).toFixed(Math.min(20, Math.max(0, Math.ceil(-Math.log10(step))))) };
    });
    this.slices = axes;  // for each axis: number of steps, step at which each sphere lies, and coordinate of a step
    this.sides = axes.map(({ side }) => side);
    for (let c = 0; c < contacts; c++) {
      const gap = [0, 1, 2].map((k) => this.place[3 * second[c] + k] - this.place[3 * first[c] + k] - this.way[3 * c + k]);
      this.over[c] = Math.hypot(...gap) > (this.size[first[c]] + this.size[second[c]]) / 4;  // half their radii
    }
    this.lines = contacts + this.over.reduce((sum, over) => sum + over, 0);
    this.bodies = [...new Set(this.body)].filter((body) => body >= 0).sort((a, b) => a - b);
    this.judged = new Uint8Array(contacts);
    this.piece = new Uint8Array(spheres);
  }
  /** Set spins and slips to those of a moment: a snapshot, by its number, or after the last one the answer of the run. */
  at(moment) {
    const kept = moment < this.facts.times.length;
    this.isEnd = !kept;
    this.spinNow = kept ? this.snapshot_spin.subarray(3 * this.spheres * moment, 3 * this.spheres * (moment + 1)) : this.spin;
    this.slipNow = kept ? this.snapshot_slip.subarray(this.contacts * moment, this.contacts * (moment + 1)) : this.slip;
  }
  /** True if a layer is drawn now: if it was chosen, and is known at this moment; some are known of the end alone. */
  draws(layer, { layers }) { return layers[layer] && (this.isEnd || !OF_THE_END.layers.includes(layer)); }
  colouring({ colour }) { return this.isEnd || !OF_THE_END.colours.includes(colour) ? colour : "spin"; }
  /** Values by which slipping contacts are coloured: power at the end, slip in snapshots, with which no power is kept. */
  get valuesNow() { return this.isEnd ? this.power : this.slipNow; }
  /** Table of names and colours of a colouring, and the number in it of each sphere; undefined for continuous colours. */
  listed(colour) {
    const named = (names, colours) => names.map((name, n) => [name, colours[n]]), { pieces, sides } = this.facts;
    return { kind: { table: KINDS, value: this.kind }, piece: { table: named(pieces, PIECES), value: this.piece }, side: { table: named(sides, SIDES), value: this.above } }[colour];
  }
  /** Find contact states by a slip threshold (null for those of the run), and the pieces that slipless contacts join. */
  judge(threshold) {
    const limit = threshold ?? (this.isEnd ? null : this.facts.snapshot_threshold);
    this.counts = { slipless: 0, slipping: 0, undecided: 0 };
    for (let c = 0; c < this.contacts; c++) {
      const was = this.state[c];
      const is = was === DRIVEN || limit === null ? was : this.slipNow[c] > limit ? SLIPPING : SLIPLESS;
      this.judged[c] = is;
      if (is !== DRIVEN) this.counts[["slipless", "slipping"][is] ?? "undecided"]++;
    }
    this.join();
  }
  /** Find the pieces of the slipless network by union-find; all spheres of a driven body belong to one piece. */
  join() {
    const { body, bodies, first, second } = this, root = Int32Array.from({ length: this.spheres }, (_, s) => s), touched = new Uint8Array(this.spheres);
    const find = (s) => { while (root[s] !== s) s = root[s] = root[root[s]]; return s; };
    const leader = new Map();
    for (let s = 0; s < this.spheres; s++)
      if (body[s] >= 0) {
        if (!leader.has(body[s])) leader.set(body[s], s);
        root[s] = leader.get(body[s]);
      }
    for (let c = 0; c < this.contacts; c++)
      if (this.judged[c] === SLIPLESS) {
        touched[first[c]] = touched[second[c]] = 1;
        root[find(first[c])] = find(second[c]);
      }
    const held = new Map();  // root -> kind of its piece
    for (const [number, s] of leader) held.set(find(s), held.has(find(s)) ? 0 : bodies.length === 2 ? 1 + bodies.indexOf(number) : 1);
    let reached = 0, free = 0;
    for (let s = 0; s < this.spheres; s++) {
      this.piece[s] = held.get(find(s)) ?? (touched[s] ? 3 : 4);
      free += body[s] < 0;
      reached += touched[s] && body[s] < 0;
    }
    this.counts.spans = [...held.values()].includes(0);
    this.counts.reached = reached / (free || 1);
  }
}

/** What is known of a sphere or contact, as rows of a name and a value. */
function numbersOf(sample, found) {
  const { facts, dimension } = sample, axes = [0, 1, 2].slice(0, dimension), position = (s) => `(${axes.map((k) => six(facts.origin[k] + sample.center[sample.spheres * k + s])).join(", ")})`;
  if (found.sphere !== undefined) {
    const s = found.sphere, spin = [0, 1, 2].map((k) => sample.spinNow[3 * s + k]);
    const ofDomain = sample.domain_size[sample.domain[s]], atEnd = !sample.has("domain") ? [] : [["rigid domain", `${grouped(sample.domain[s])}, of ${grouped(ofDomain)} ${ofDomain === 1 ? "sphere" : "spheres"}`]];
    if (sample.has("kind")) atEnd.push(["domain turns with", KINDS[sample.kind[s]][0]]);
    if (sample.has("sphere_betweenness")) atEnd.push(["shortest paths", `${six(100 * sample.sphere_betweenness[s])} % visit it`]);
    const name = facts.shape ? position(s) : `${s} at ${position(s)}`, by = facts.shape ? "" : ` with body ${sample.body[s]}`;
    return { title: `sphere ${name}${sample.body[s] < 0 ? "" : `, driven${by}`}`, rows: [
      ...(facts.shape ? [] : [["radius", `${six(sample.radius[s])} length`]]),
      ["spin ω", `${dimension === 2 ? six(spin[2]) : `(${spin.map(six).join(", ")})`} 1/time`],
      [facts.spin_name, six(sample.size[s] * Math.hypot(...spin) / facts.spin_max)], ["slipless network", facts.pieces[sample.piece[s]]], ...(sample.isEnd ? atEnd : [])] };
  }
  const c = found.contact, is = sample.judged[c], was = sample.state[c];
  const words = ["slipless", "slipping", "undecided", "between driven spheres or absent", "tied"];
  const byRun = sample.isEnd && is === was && facts.by_run;
  const how = is === DRIVEN ? "" : byRun ? `, ${facts.decided}` : ", by slip alone";
  const rows = [["state", words[is] + how], ["slip |v|", `${six(sample.slipNow[c])} length/time`]];
  if (sample.isEnd) {
    rows.push(["power P", `${six(sample.power[c])} energy/time`], ["force |f|", `${six(sample.force[c])} force`]);
    if (facts.friction_limit) rows.push(["|f| / (μ Fₙ)", six(sample.force[c] / ((facts.normal_force ?? sample.normal_force[c]) * sample.coefficient[c]))]);
  } else rows.push(["power, force", "not kept with a snapshot"]);
  for (const { key, name: what, unit } of facts.coefficients) rows.push([what, six(sample[key][c]) + (unit === "1" ? "" : ` ${unit}`)]);
  if (sample.betweenness[c] > 0) rows.push(["shortest paths", `${six(100 * sample.betweenness[c])} % of pairs run through it`]);
  const part = [[CUT, "minimum cut"], [PATH, "shortest path"]].filter(([bit]) => sample.flags[c] & bit).map(([, text]) => text);
  if (part.length) rows.push(["belongs to", part.join(", ")]);
  const axis = axes.findIndex((k) => sample.normal[sample.contacts * k + c]), a = sample.first[c];
  return { title: facts.shape ? `contact ${"xyz"[axis]} of sphere ${position(a)}` : `contact ${c} of spheres ${a} and ${sample.second[c]}`, rows };
}
