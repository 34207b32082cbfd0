function swatch(colour) {
  const square = Object.assign(document.createElement("span"), { className: "swatch" });
  square.style.background = colour;
  return square;
}

function drawLegend(sample, choices) {
  const legend = element("legend"), { facts } = sample;
  legend.replaceChildren();
  const bar = (title, map, ticks) => {
    const entry = document.createElement("div"), strip = document.createElement("div"), row = document.createElement("div");
    const stops = Array.from({ length: 17 }, (_, n) => `rgb(${map.slice(3 * Math.round(n * 255 / 16), 3 * Math.round(n * 255 / 16) + 3).join()})`);
    strip.className = "bar";
    strip.style.background = `linear-gradient(90deg, ${stops.join()})`;
    row.className = "ticks";
    for (const tick of ticks) row.append(Object.assign(document.createElement("span"), { textContent: tick }));
    entry.append(title, strip, row);
    legend.append(entry);
  };
  const list = (entries) => {
    for (const [text, colour] of entries) {
      const entry = document.createElement("div");
      entry.append(swatch(colour), text);
      legend.append(entry);
    }
  };
  const colour = sample.colouring(choices), layers = Object.fromEntries(LAYERS.map(([key]) => [key, sample.draws(key, choices)])), shares = ["≤ 0.01 %", "0.1 %", "1 %", "10 %", "100 %"];
  if (layers.spheres) {
    const listed = sample.listed(colour);
    if (colour === "spin") bar(`spheres: ${facts.spin_name}`, sample.map_spin, ["0", "0.5", facts.beyond ? "≥ 1" : "1"]);
    if (colour === "turn") bar(`spheres: how their domain turns${sample.dimension === 3 ? " (yellow, green: by component)" : ""}`, sample.map_spin, ["as the bottom", "as the top"]);
    if (colour === "betweenness") bar("spheres: share of shortest paths", sample.map_share, shares);
    if (colour === "domain") list([["rigid domains of several spheres, largest first", `linear-gradient(90deg, ${TELLING.join()})`], ["single spheres", LOOK.plain]]);
    if (colour === "body") list([...sample.bodies.slice(0, TELLING.length).map((body) => [facts.shape ? ["driven with the bottom", "driven with the top"][body] : `driven body ${body}`, TELLING[body % TELLING.length]]), ["free", LOOK.plain]]);
    if (listed) list(listed.table.filter((_, n) => listed.value.includes(n)));
  }
  if (sample.dimension === 3 && facts.shape) list([["top plane, driven", LOOK.top], ["bottom plane, driven", LOOK.bottom]]);
  if (layers.network) list([["slipless contacts", LOOK.network]]);
  if (layers.slipping && sample.counts.slipping) {
    const least = weakest(choices), most = choices.range[1], middle = Math.sqrt(least * most), digits = (value) => value.toExponential(1);
    bar(sample.isEnd ? "slipping contacts: power P, energy/time" : "slipping contacts: slip |v|, length/time", sample.map_power, [digits(least), digits(middle), digits(most)]);
  }
  if (layers.undecided && sample.counts.undecided) list([["tied and undecided contacts", LOOK.undecided]]);
  if (layers.cut) list([["minimum cut", LOOK.cut]]);
  if (layers.walls) list([["boundaries of rigid domains", LOOK.walls]]);
  if (layers.path) list([[sample.dimension === 3 ? "a shortest path; arrows: its spins" : "a shortest path", LOOK.path]]);
  if (layers.bottlenecks && !(layers.spheres && colour === "betweenness")) bar("bottlenecks: share of shortest paths", sample.map_share, shares);
}
