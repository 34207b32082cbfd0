/** The form beside the picture; every change of it goes through `changed`. */
class Controls {
  constructor(sample, choices, picture) {
    Object.assign(this, { sample, choices, picture });
    this.switches = {};
    this.buildLists();
    this.buildSlices();
    this.listen();
    this.usePreset(0);
    this.judge();
    element("subtitle").style.minHeight = `${element("subtitle").getBoundingClientRect().height}px`;  // snapshots say less: nothing jumps
    choices.time = 0;  // the first snapshot; without snapshots the end of the run
    this.judge();
    this.followLink();
  }
  tick(parent, text, colour, on, act) {
    const label = document.createElement("label"), box = document.createElement("input"), count = document.createElement("span");
    label.className = "tick";
    Object.assign(box, { type: "checkbox", checked: on });
    box.addEventListener("change", () => act(box.checked));
    count.className = "count";
    label.append(box);
    if (colour) label.append(swatch(colour));
    label.append(text, count);
    element(parent).append(label);
    return { label, box, count };
  }
  buildLists() {
    const { sample, choices } = this, flags = (bit) => sample.flags.reduce((sum, f) => sum + ((f & bit) > 0), 0);
    const walls = sample.first.reduce((sum, s, c) => sum + (sample.domain[s] !== sample.domain[sample.second[c]]), 0);
    const bottlenecks = sample.betweenness.reduce((sum, b) => sum + (b > 0 && b >= sample.facts.bottleneck_share), 0);
    this.available = { spheres: sample.spheres, network: 1, slipping: 1, undecided: sample.state.reduce((sum, is) => sum + (is === UNDECIDED || is === TIED), 0), cut: flags(CUT), walls, path: flags(PATH), bottlenecks, domains: Number(sample.has("domain")) };
    PRESETS.forEach(([name], n) => {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: name, disabled: !this.available[PRESETS[n][5]] });
      if (button.disabled) button.title = sample.facts.analysed ? "This sample has none." : "Not analysed: bearings view --analyse shows it.";
      button.addEventListener("click", () => { this.usePreset(n); this.changed(); });
      element("presets").append(button);
    });
    for (const [key, text] of LAYERS)
      this.switches[key] = this.tick("layers", text, LOOK[key], false, (on) => { choices.layers[key] = on; choices.preset = null; this.changed(); });
    for (const [key, text] of COLOURS) element("colour").append(new Option(key === "spin" ? `spin ${sample.facts.spin_name}` : text, key));
    element("kinds").hidden = !sample.has("kind");
    const members = KINDS.map(() => 0);
    for (const kind of sample.kind) members[kind]++;
    element("kinds").append(Object.assign(document.createElement("p"), { className: "note", textContent: "rigid domains that turn with" }));
    this.kinds = KINDS.map(([text], kind) => {
      const made = this.tick("kinds", text, null, true, (on) => { choices.kinds[kind] = on; this.changed(); });
      made.count.textContent = grouped(members[kind]);
      made.label.style.display = members[kind] ? "" : "none";
      return made;
    });
  }
  buildSlices() {
    const { sample, choices } = this;
    this.slices = sample.slices.map(({ steps }, k) => {
      const row = document.createElement("div"), text = document.createElement("output");
      row.className = "slice";
      row.append("xyz"[k]);
      const ends = ["from", "to"].map((which, end) => {
        const slider = Object.assign(document.createElement("input"), { type: "range", min: 0, max: steps, step: 1, value: end ? steps : 0 });
        slider.setAttribute("aria-label", `${"xyz"[k]} ${which}`);
        slider.id = `slice-${"xyz"[k]}-${which}`;
        slider.addEventListener("input", () => {
          const bound = end ? choices.high : choices.low, other = end ? choices.low : choices.high;
          bound[k] = Number(slider.value);
          if (choices.low[k] > choices.high[k]) other[k] = bound[k];
          this.changed();
        });
        row.append(slider);
        return slider;
      });
      row.append(text);
      element("slices").append(row);
      return { ends, text };
    });
  }
  listen() {
    const { sample, choices, picture } = this, last = sample.facts.times.length;
    const on = (id, act) => element(id).addEventListener("input", () => act(element(id).value));
    on("colour", (value) => { choices.colour = value; this.changed(); });
    on("size", (value) => { choices.size = Number(value); this.changed(); });
    on("power", (value) => { choices.power = Number(value); this.changed(); });
    on("threshold", (value) => { choices.threshold = Number(value); this.judge(); });
    on("time", (value) => { choices.time = Number(value); this.judge(); });
    element("moments").hidden = last === 0;
    element("threshold").disabled = sample.facts.jump_speed === 0;  // nothing to compare slips with
    Object.assign(element("time"), { max: last, value: last });
    element("play").addEventListener("click", () => this.play(!this.playing));
    element("reset").addEventListener("click", () => picture.firstView());
    element("picture").addEventListener("click", () => {
      const link = Object.assign(document.createElement("a"), { download: "bearing.png", href: picture.copy() });
      link.click();
    });
    picture.controls.addEventListener("change", () => this.keepLink());
    window.addEventListener("hashchange", () => this.followLink());
    element("controls").addEventListener("submit", (event) => event.preventDefault());
  }
  play(on) {
    clearInterval(this.playing);
    this.playing = null;
    element("play").setAttribute("aria-pressed", String(on));
    element("play").textContent = on ? "❚❚" : "▶";
    if (!on) return;
    const last = this.sample.facts.times.length, pace = Math.max(60, Math.min(700, 9000 / (last + 1)));
    if (this.choices.time === last) this.choices.time = -1;
    this.playing = setInterval(() => {
      this.choices.time++;
      if (this.choices.time >= last) this.play(false);
      this.judge();
    }, pace);
  }
  usePreset(n) {
    const [, layers, colour, size, hidden] = PRESETS[n], { choices, sample } = this, flat = sample.dimension === 2;
    const some = KINDS.some((_, kind) => !hidden.includes(kind) && sample.kind.includes(kind));
    Object.assign(choices, { colour: colour === "turn" && !sample.has(colour) ? "domain" : colour, size, preset: n, power: 0, kinds: KINDS.map((_, kind) => flat || !(some && hidden.includes(kind))) });
    for (const [key] of LAYERS) choices.layers[key] = layers.includes(key) && this.available[key] > 0;
    if (flat) {  // discs stay discs, and lines lie on them
      choices.size = 1;
      choices.layers.spheres = true;
    } else {
      choices.layers.walls = false;
      if (layers.includes("slipping")) choices.power = this.strongest(0.6 * MANY);
    }
  }
  /** Return the position of the power slider at which about `left` slipping contacts are shown; 0 if there are few. */
  strongest(left) {
    const { sample, choices } = this, [least, most] = choices.range;
    const values = sample.valuesNow.filter((value, c) => sample.judged[c] === SLIPPING && value > 0).sort();
    return values.length <= MANY ? 0 : Math.ceil(100 * Math.log(values[values.length - left] / least) / Math.log(most / least));
  }
  /** Find contact states anew, after a change of the threshold or of the time. */
  judge() {
    const { sample, choices } = this, { facts } = sample, step = choices.threshold;
    sample.at(choices.time);
    choices.slip = step === 0 ? null : 10 ** (-12 + 12 * (step - 1) / 119) * facts.jump_speed;
    facts.by_run = choices.slip === null;
    sample.judge(choices.slip);
    const values = sample.valuesNow;
    let least = Infinity, most = 0;
    for (let c = 0; c < sample.contacts; c++)
      if (sample.judged[c] === SLIPPING && values[c] > 0) { least = Math.min(least, values[c]); most = Math.max(most, values[c]); }
    choices.range = most > 0 ? [least, most] : [1, 1];
    this.changed();
  }
  changed() {
    this.picture.refresh();
    this.show();
    this.keepLink();
  }
  /** True if a colouring is known of this sample and at this moment. */
  canColour(colour) {
    const { sample } = this;
    return sample.has(COLOURS.find(([key]) => key === colour)?.[2]) && (sample.isEnd || !OF_THE_END.colours.includes(colour));
  }
  show() {
    const { sample, choices } = this, { facts, counts } = sample;
    for (const [key] of LAYERS) {
      const { box, label } = this.switches[key];
      box.checked = sample.draws(key, choices);
      box.disabled = this.available[key] === 0 || !(sample.isEnd || !OF_THE_END.layers.includes(key));
      label.classList.toggle("off", box.disabled);
    }
    const number = { ...this.available, network: counts.slipless, slipping: counts.slipping, undecided: counts.undecided };
    for (const [key] of LAYERS) this.switches[key].count.textContent = number[key] ? grouped(number[key]) : "none";
    this.kinds.forEach(({ box }, kind) => { box.checked = choices.kinds[kind]; });
    [...element("presets").children].forEach((button, n) => button.setAttribute("aria-pressed", String(n === choices.preset)));
    for (const key of SLIDERS) element(key).value = choices[key];
    element("colour").value = sample.colouring(choices);
    for (const option of element("colour").options) option.disabled = !this.canColour(option.value);
    const own = sample.isEnd ? `those of the run (${facts.proven ? "proven" : "not proven"})` : `those up to |v| = ${six(facts.snapshot_threshold)}`;
    element("threshold-text").textContent = choices.slip === null ? own : `those up to ${(choices.slip / facts.jump_speed).toExponential(1)} ${facts.jump_name}`;
    element("threshold").setAttribute("aria-valuetext", element("threshold-text").textContent);
    const open = counts.undecided ? `, ${facts.open}` : "";
    element("states").textContent = `${grouped(counts.slipless)} slipless, ${grouped(counts.slipping)} slipping${open}. They ${counts.spans ? "join" : "do not join"} ${facts.joined} and touch ${six(100 * counts.reached)} % of the free spheres.`
      + (!facts.analysed ? " Cut, domains, path and bottlenecks are not in this page: bearings view --analyse finds them." : !sample.isEnd ? " Domains, path and bottlenecks are known of the end state alone." : choices.slip === null ? "" : " Domains, path and bottlenecks stay those of the run.");
    const what = sample.isEnd ? "P" : "|v|";
    element("power-text").textContent = choices.power === 0 ? "all" : `${what} ≥ ${weakest(choices).toExponential(2)}`;
    element("power").setAttribute("aria-valuetext", element("power-text").textContent);
    sample.slices.forEach(({ at }, k) => {
      const { ends, text } = this.slices[k];
      ends[0].value = choices.low[k];
      ends[1].value = choices.high[k];
      text.textContent = choices.low[k] === choices.high[k] ? `${at(choices.low[k])}` : `${at(choices.low[k])} – ${at(choices.high[k])}`;
    });
    this.showTime();
    drawLegend(sample, choices);
  }
  /** Write the choices and the camera behind the # of the address, so that this address shows the same picture again. */
  keepLink() {
    clearTimeout(this.linking);
    const { choices, picture: { camera, controls } } = this, camera_at = [camera.position, controls.target].flatMap((place) => place.toArray());
    this.linking = setTimeout(() => {
      const kept = { camera: camera_at.map((x) => Number(x.toPrecision(6))), colour: choices.colour, kinds: choices.kinds.map(Number), low: choices.low, high: choices.high };
      kept.layers = LAYERS.map(([key]) => key).filter((key) => choices.layers[key]);
      for (const key of SLIDERS) kept[key] = choices[key];
      try {
        history.replaceState(null, "", "#" + Object.entries(kept).map(([key, value]) => `${key}=${value}`).join("&"));
      } catch { /* a page within another may have no address */ }
    }, 200);
  }
  /** Take choices and camera from the address, as far as this sample has what it names. */
  followLink() {
    const { sample, choices, picture: { camera, controls } } = this, said = new URLSearchParams(location.hash.slice(1));
    if (!said.has("camera")) return;
    const numbers = (key, length) => {
      const found = (said.get(key) ?? "").split(",").map(Number);
      return found.length === length && found.every(Number.isFinite) ? found : null;
    };
    const within = (value, least, most) => Math.min(most, Math.max(least, value));
    const place = numbers("camera", 6), kinds = numbers("kinds", KINDS.length), layers = (said.get("layers") ?? "").split(",");
    for (const key of SLIDERS) {
      const value = numbers(key, 1), { min, max } = element(key);
      if (value) choices[key] = within(value[0], Number(min), Number(max));
    }
    choices.time = Math.round(choices.time);
    for (const key of ["low", "high"])
      choices[key] = numbers(key, sample.dimension)?.map((value, k) => within(Math.round(value), 0, sample.slices[k].steps)) ?? choices[key];
    for (const [key] of LAYERS) choices.layers[key] = layers.includes(key) && this.available[key] > 0;
    if (kinds) choices.kinds = kinds.map(Boolean);
    if (sample.has(COLOURS.find(([key]) => key === said.get("colour"))?.[2])) choices.colour = said.get("colour");
    choices.preset = null;
    if (place) {
      camera.position.fromArray(place);
      controls.target.fromArray(place, 3);
      controls.update();
    }
    this.judge();
  }
  showTime() {
    const { facts, isEnd } = this.sample, { time } = this.choices;
    const text = isEnd ? (facts.time === null ? "" : `t = ${six(facts.time)}`) : `t = ${six(facts.times[time])}`;
    element("time-text").textContent = isEnd && text ? `${text}, end` : text;
    element("time").setAttribute("aria-valuetext", element("time-text").textContent);
    element("title").textContent = [facts.title, text].filter(Boolean).join(", ");
    element("subtitle").textContent = isEnd ? facts.subtitle : `snapshot ${time + 1} of ${facts.times.length}${facts.left_out}`;
  }
}
