"use strict";
// The page of `bearings view`: the spheres and contacts of one sample as layers that can be switched, sliced and asked.
// Contacts along x come first, then y (, z), each in C order of their lower spheres, as in taichi_bearings.

const SLIPLESS = 0, SLIPPING = 1, UNDECIDED = 2, DRIVEN = 3;
const CUT = 1, PATH = 2;
const KINDS = [["bottom", "#0072b2"], ["top", "#d55e00"], ["both", "#cc79a7"], ["bottom and top, by component", "#e69f00"],
  ["one component only", "#56b4e9"], ["neither", "#a5abb3"]];
const PIECES = [["joined to bottom and top", "#009e73"], ["to the bottom", "#0072b2"], ["to the top", "#d55e00"],
  ["an island", "#e69f00"], ["touches no slipless contact", "#c9ced5"]];
const SIDES = [["below the cut", "#0072b2"], ["above the cut", "#d55e00"]];
const LOOK = { network: "#4b5a6b", cut: "#e69f00", walls: "#3c4653", path: "#009e73", undecided: "#cc79a7", plain: "#d5dae1",
  frame: "#c5ccd5", bottom: "#3b4cc0", top: "#b40426" };
const ACROSS = ["cut", "walls"], FLAT = { cut: 0.13, walls: 0.08, slipping: 0.13 };  // radii of lines across contacts in 2D
const LAYERS = [["spheres", "spheres"], ["network", "slipless contacts"], ["slipping", "slipping contacts"],
  ["undecided", "undecided contacts"], ["cut", "minimum cut"], ["walls", "domain boundaries"], ["path", "shortest path, its spins"],
  ["bottlenecks", "bottlenecks"]];
const COLOURS = [["spin", "spin |ω| / ω max"], ["turn", "how its domain turns"], ["kind", "what its domain is locked to"],
  ["piece", "piece of the slipless network"], ["betweenness", "share of shortest paths"], ["side", "side of the minimum cut"], ["plain", "plain"]];
const PRESETS = [  // name, layers, colour of the spheres, their size in 3D, kinds of domains that are hidden there, needed layer
  ["Spins", ["spheres"], "spin", 1, [], "spheres"],
  ["Network", ["network", "path"], "piece", 0.25, [], "network"],
  ["Slipping", ["slipping", "undecided"], "plain", 0.25, [], "slipping"],
  ["Minimum cut", ["cut"], "side", 0.25, [], "cut"],
  ["Domains", ["spheres", "walls"], "turn", 1, [0, 1], "spheres"],
  ["Bottlenecks", ["bottlenecks", "path"], "betweenness", 0.25, [], "bottlenecks"],
];
const OVER = ["path", "bottlenecks"];  // drawn after what one sees through
const MANY = 5000;  // contacts beyond which a layer hides what is behind it, if nothing is done about that
const SHARES = -4;  // decades of the betweenness that colours tell apart

const element = (id) => document.getElementById(id);
const grouped = (count) => count.toLocaleString("en-GB");
const six = (value) => {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e6) ? value.toExponential(5).replace(/\.?0+e/, "e") : String(Number(value.toPrecision(6)));
};
const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

async function unpacked(id) {
  const text = atob(element(id).textContent.trim()), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  element(id).remove();
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

// Everything on the lattice is a square of two triangles. Those of spheres and rods face the eye, shaded as what they
// stand for; plates lie across their contacts. All squares of a layer are one mesh: copies by the thousand are slow.
const COMMON = `
  uniform float pixel, opacity;
  uniform vec2 fade;
  varying vec3 colour;`;
const VERTEX = `${COMMON}
  attribute vec4 paint;
  attribute float wide;
  vec2 corner() { return vec2(float(gl_VertexID & 1), float((gl_VertexID >> 1) & 1)) - 0.5; }
  vec3 unit(float axis) { return vec3(lessThan(abs(vec3(0.0, 1.0, 2.0) - axis), vec3(0.5))); }
  float axis() { return floor(255.0 * paint.a + 0.5); }`;
const FRAGMENT = `${COMMON}
  vec4 shaded(vec3 normal, float away, float cover) {
    float light = 0.62 + 0.16 * normal.y + 0.32 * max(0.0, dot(normal, normalize(vec3(-0.5, 0.8, 1.0))));
    return vec4(mix(min(light, 1.06) * colour, vec3(1.0), smoothstep(fade.x, fade.y, away)), cover * opacity);
  }`;
const SPHERE = {
  alphaToCoverage: true,
  vertexShader: `${VERTEX}
    varying vec3 centre, point;
    varying float radius;
    void main() {
      colour = paint.rgb;
      centre = (modelViewMatrix * vec4(position, 1.0)).xyz;
      radius = 0.5 * wide;
      float away = length(centre), scale = 2.1 * radius * inversesqrt(max(0.05, 1.0 - radius * radius / (away * away)));
      vec3 right = normalize(cross(vec3(0.0, 1.0, 0.0), -centre)), up = normalize(cross(-centre, right));
      point = centre + scale * (corner().x * right + corner().y * up);
      gl_Position = projectionMatrix * vec4(point, 1.0);
    }`,
  fragmentShader: `${FRAGMENT}
    uniform mat4 projectionMatrix;
    varying vec3 centre, point;
    varying float radius;
    void main() {
      vec3 sight = normalize(point);
      float ahead = dot(sight, centre), inside = radius * radius - dot(centre, centre) + ahead * ahead;
      float cover = clamp(0.5 + inside / max(fwidth(inside), 1e-12), 0.0, 1.0);
      if (cover <= 0.0) discard;
      vec3 surface = sight * (ahead - sqrt(max(0.0, inside)));
      vec4 clip = projectionMatrix * vec4(surface, 1.0);
      gl_FragDepth = 0.5 + 0.5 * clip.z / clip.w;
      gl_FragColor = shaded(normalize(surface - centre), length(surface), cover);
    }`,
};
const ROD = {
  vertexShader: `${VERTEX}
    varying vec3 sideways, facing;
    varying vec2 at;
    varying float away, reach;
    void main() {
      colour = paint.rgb;
      vec3 middle = (modelViewMatrix * vec4(position, 1.0)).xyz, along = normalize(mat3(modelViewMatrix) * unit(axis()));
      float radius = max(wide, 0.6 * pixel * length(middle));
      sideways = normalize(cross(along, middle) + vec3(1e-6, 0.0, 0.0));
      facing = normalize(cross(sideways, along));
      facing *= sign(dot(facing, -middle) + 1e-9);
      reach = 0.5 / radius;
      at = 2.0 * corner() * vec2(1.0, reach + 1.0);
      vec3 point = middle + radius * (at.x * sideways + at.y * along);
      away = length(point);
      gl_Position = projectionMatrix * vec4(point, 1.0);
    }`,
  fragmentShader: `${FRAGMENT}
    varying vec3 sideways, facing;
    varying vec2 at;
    varying float away, reach;
    void main() {
      float past = max(0.0, abs(at.y) - reach), inside = 1.0 - at.x * at.x - past * past;
      if (inside <= 0.0) discard;
      gl_FragColor = shaded(normalize(sideways * at.x + facing * sqrt(inside)), away, 1.0);
    }`,
};
const PLATE = {
  vertexShader: `${VERTEX}
    varying vec3 across, point;
    void main() {
      colour = paint.rgb;
      vec2 at = wide * corner();
      vec3 u = unit(mod(axis() + 1.0, 3.0)), w = unit(mod(axis() + 2.0, 3.0));
      point = (modelViewMatrix * vec4(position + at.x * u + at.y * w, 1.0)).xyz;
      across = mat3(modelViewMatrix) * unit(axis());
      gl_Position = projectionMatrix * vec4(point, 1.0);
    }`,
  fragmentShader: `${FRAGMENT}
    varying vec3 across, point;
    void main() { gl_FragColor = shaded(normalize(dot(across, point) > 0.0 ? -across : across), length(point), 1.0); }`,
};

/** One layer of squares. */
class Squares {
  constructor(scene, shaders, uniforms, most, opacity) {
    const shape = this.shape = new THREE.BufferGeometry(), index = new Uint32Array(6 * most);
    for (let n = 0; n < most; n++) index.set([4 * n, 4 * n + 1, 4 * n + 2, 4 * n + 2, 4 * n + 1, 4 * n + 3], 6 * n);
    shape.setIndex(new THREE.BufferAttribute(index, 1));
    this.place = new Float32Array(12 * most);
    this.paint = new Uint8Array(16 * most);
    this.wide = new Float32Array(4 * most);
    shape.setAttribute("position", new THREE.BufferAttribute(this.place, 3));
    shape.setAttribute("paint", new THREE.BufferAttribute(this.paint, 4, true));
    shape.setAttribute("wide", new THREE.BufferAttribute(this.wide, 1));
    this.mesh = new THREE.Mesh(shape, new THREE.ShaderMaterial({
      ...shaders, uniforms: { ...uniforms, opacity: { value: opacity } }, side: THREE.DoubleSide, transparent: opacity < 1, depthWrite: opacity === 1,
    }));
    this.mesh.renderOrder = opacity < 1 ? 1 : 0;
    this.mesh.frustumCulled = false;
    this.ids = new Int32Array(most);
    this.begin();
    scene.add(this.mesh);
  }
  begin() { this.count = 0; }
  /** One of them, for the sphere or contact `id`; axis : of the world, along the contact. */
  put(id, x, y, z, axis, wide, colour) {
    const n = this.count++, { place, paint } = this;
    for (let k = 4 * n; k < 4 * n + 4; k++) {
      place[3 * k] = x; place[3 * k + 1] = y; place[3 * k + 2] = z;
      paint[4 * k] = 255 * colour[0]; paint[4 * k + 1] = 255 * colour[1]; paint[4 * k + 2] = 255 * colour[2]; paint[4 * k + 3] = axis;
      this.wide[k] = wide;
    }
    this.ids[n] = id;
  }
  end() {
    this.mesh.visible = this.count > 0;
    this.shape.setDrawRange(0, 6 * this.count);
    for (const name of ["position", "paint", "wide"]) {
      const attribute = this.shape.getAttribute(name);
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, 4 * attribute.itemSize * this.count);
      attribute.needsUpdate = true;
    }
  }
}

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
        if (this.cell[k][s] < this.shape[k] - 1) {
          this.axis[c] = k; this.low[c] = s; this.high[c] = s + stride[k];
          c++;
        }
    this.stride = stride;
    this.judged = new Uint8Array(this.contacts);
    this.piece = new Uint8Array(this.sites);
  }
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

/** Draws a sample as the choices say. */
class Picture {
  constructor(sample, choices, canvas) {
    Object.assign(this, { sample, choices, canvas, layers: {}, shown: new Uint8Array(sample.sites) });
    THREE.ColorManagement.enabled = false;  // colours on the screen are those of the legend
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.setClearColor(0xffffff);
    this.extent = Math.hypot(...sample.shape);
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(0xffffff, 1, 2);
    this.uniforms = { fade: { value: new THREE.Vector2() }, pixel: { value: 1 } };
    this.camera = new THREE.PerspectiveCamera(28, 1, 0.1, 20 * this.extent + 50);
    this.camera.up.set(0, 0, 1);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xc3c9d2, 2.35), this.camera);
    const lamp = new THREE.DirectionalLight(0xffffff, 1.25);
    lamp.position.set(-0.5, 0.8, 1);
    this.camera.add(lamp);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { zoomToCursor: true, enableRotate: sample.dimension === 3, minDistance: 2, maxDistance: 8 * this.extent + 20 });
    if (sample.dimension === 2) this.controls.mouseButtons.LEFT = 2;  // drags
    this.controls.addEventListener("change", () => this.draw());
    this.marker = new THREE.Mesh(new THREE.BoxGeometry(1, 1, 1), new THREE.MeshBasicMaterial({ color: "#000000", wireframe: true, fog: false }));
    this.scene.add(this.marker);
    this.marker.visible = false;
    this.arrow = this.arrows();
    this.frame();
    this.firstView();
  }
  firstView() {
    const flat = this.sample.dimension === 2, aspect = Math.max(0.4, this.canvas.clientWidth / this.canvas.clientHeight);
    const away = 1 / Math.tan(this.camera.fov * Math.PI / 360);
    if (flat) this.camera.position.set(0, -away * 0.62 * Math.max(this.sample.shape[1] + 1, (this.sample.shape[0] + 1) / aspect) - 1, 0);
    else this.camera.position.set(0.56, -0.75, 0.42).normalize().multiplyScalar(away * 0.57 * this.extent * Math.max(1, 1 / aspect));
    this.controls.target.set(0, 0, 0);
    this.controls.update();
    this.draw();
  }
  /** The squares of a layer, made when it is first shown. */
  squares(name, shaders, most = this.sample.contacts, opacity = 1) {
    const made = this.layers[name] ??= new Squares(this.scene, shaders, this.uniforms, most, opacity);
    if (OVER.includes(name)) Object.assign(made.mesh, { renderOrder: 2 }).material.transparent = true;
    return made;
  }
  arrows() {
    const group = new THREE.Object3D();
    this.scene.add(group);
    return group;
  }
  /** What the slices leave, of each sphere. */
  slice() {
    const { low, high } = this.choices, { cell, sites } = this.sample;
    for (let s = 0; s < sites; s++) {
      let inside = 1;
      for (let k = 0; k < cell.length; k++) inside &= cell[k][s] >= low[k] && cell[k][s] <= high[k];
      this.shown[s] = inside;
    }
  }
  refresh() {
    this.slice();
    this.fillSpheres();
    this.fillContacts();
    this.fillArrows();
    this.draw();
  }
  colourOf() {
    const { sample, choices } = this, { facts } = sample, paint = [0, 0, 0];
    const pick = (table) => { const colours = table.map(([, hex]) => rgb(hex)); return (index) => colours[index]; };
    const scaled = (map) => (value) => {
      const at = 3 * Math.round(255 * Math.min(1, Math.max(0, value)));
      paint[0] = map[at] / 255; paint[1] = map[at + 1] / 255; paint[2] = map[at + 2] / 255;
      return paint;
    };
    if (choices.colour === "spin") {
      const of = scaled(sample.map_spin), w = sample.spinNow;
      return (s) => of(Math.hypot(w[3 * s], w[3 * s + 1], w[3 * s + 2]) / facts.spin_max);
    }
    if (choices.colour === "betweenness") {
      const of = scaled(sample.map_share);
      return (s) => of(1 - Math.log10(Math.max(1e-30, sample.sphere_betweenness[s])) / SHARES);
    }
    if (choices.colour === "turn") return (s) => { for (let k = 0; k < 3; k++) paint[k] = sample.turn[3 * s + k] / 255; return paint; };
    if (choices.colour === "plain") { const grey = rgb(LOOK.plain); return () => grey; }
    const of = pick({ kind: KINDS, piece: PIECES, side: SIDES }[choices.colour]);
    const value = { kind: sample.kind, piece: sample.piece, side: sample.above }[choices.colour];
    return (s) => of(value[s]);
  }
  fillSpheres() {
    const { sample, choices, shown } = this, balls = this.squares("spheres", SPHERE, sample.sites), size = choices.size;
    balls.begin();
    balls.radius = size / 2;
    if (choices.layers.spheres) {
      const drawn = new Uint8Array(sample.sites), colour = this.colourOf();
      for (let s = 0; s < sample.sites; s++) drawn[s] = shown[s] && choices.kinds[sample.kind[s]];
      const hidden = size >= 0.95 && sample.dimension === 3 ? this.inner(this.inner(drawn)) : null;
      for (let s = 0; s < sample.sites; s++)
        if (drawn[s] && !hidden?.[s]) balls.put(s, sample.place[3 * s], sample.place[3 * s + 1], sample.place[3 * s + 2], 2, size, colour(s));
    }
    balls.end();
  }
  /** Those whose six neighbours are all there: spheres two layers inside are not seen from anywhere. */
  inner(there) {
    const { shape, cell, stride, sites } = this.sample, found = new Uint8Array(sites);
    for (let s = 0; s < sites; s++) {
      let all = there[s];
      for (let k = 0; k < 3 && all; k++)
        all = cell[k][s] > 0 && cell[k][s] < shape[k] - 1 && there[s - stride[k]] && there[s + stride[k]];
      found[s] = all ? 1 : 0;
    }
    return found;
  }
  fillContacts() {
    const { sample, choices } = this, { layers } = choices, { judged, flags, domain, low, high, betweenness } = sample;
    const map = (table, part) => { const at = 3 * Math.round(255 * Math.min(1, Math.max(0, part))); return [table[at] / 255, table[at + 1] / 255, table[at + 2] / 255]; };
    const thin = sample.dimension === 2 ? 0.09 : 0.075, plain = Object.fromEntries(Object.entries(LOOK).map(([k, v]) => [k, rgb(v)]));
    const values = sample.valuesNow, least = weakest(choices), wide = Math.log10(choices.range[1] / least) || 1;
    const faint = choices.power > 0 ? least : 0;
    const { bottleneck_share, busiest_share: busiest } = sample.facts, bold = Math.max(1, this.extent / 30);
    this.fill("network", thin, (c) => judged[c] === SLIPLESS ? plain.network : null);
    this.fill("slipping", 1.5 * thin, (c) => judged[c] !== SLIPPING || values[c] < faint ? null
      : map(sample.map_power, Math.log10(Math.max(values[c], least) / least) / wide));
    this.fill("undecided", 1.5 * thin, (c) => judged[c] === UNDECIDED ? plain.undecided : null);
    this.fill("cut", 0.94, (c) => flags[c] & CUT ? plain.cut : null);
    this.fill("walls", 0.94, (c) => domain[low[c]] !== domain[high[c]] && this.bounds(c) ? plain.walls : null);
    this.fill("path", 2.2 * bold * thin, (c) => flags[c] & PATH ? plain.path : null);
    this.fill("bottlenecks", 3 * bold * thin, (c) => betweenness[c] > 0 && betweenness[c] >= bottleneck_share ? map(sample.map_share, 1 - Math.log10(betweenness[c]) / SHARES) : null,
      (c) => bold * thin * (1.4 + 3 * Math.sqrt(betweenness[c] / busiest)));
  }
  /** Boundaries are drawn around the spheres that are. */
  bounds(c) { const { kind, low, high } = this.sample; return this.choices.kinds[kind[low[c]]] || this.choices.kinds[kind[high[c]]]; }
  /** One layer of contacts; colour : of a contact, null where it does not belong. In 2D lines lie on the discs, and
   * what is across a contact is a line, too. */
  fill(name, radius, colour, radiusOf = null) {
    const { sample, choices, shown } = this, { place, low, high, axis, along } = sample, flat = sample.dimension === 2;
    const across = ACROSS.includes(name) || (flat && name === "slipping"), before = !flat ? 0 : across ? -0.56 : -0.62;
    if (!choices.layers[name] && !this.layers[name]) return;
    const squares = this.squares(name, across && !flat ? PLATE : ROD, sample.contacts, name === "network" && !flat && sample.contacts > 4 * MANY ? 0.16 : 1);
    squares.begin();
    squares.radius = radius;
    if (choices.layers[name])
      for (let c = 0; c < sample.contacts; c++) {
        const a = low[c], b = high[c], paint = (across ? shown[a] || shown[b] : shown[a] && shown[b]) ? colour(c) : null;
        if (!paint) continue;
        squares.put(c, (place[3 * a] + place[3 * b]) / 2, (place[3 * a + 1] + place[3 * b + 1]) / 2 + before,
          (place[3 * a + 2] + place[3 * b + 2]) / 2, flat && across ? 2 - along[axis[c]] : along[axis[c]],
          flat && across ? FLAT[name] : radiusOf ? radiusOf(c) : radius, paint);
      }
    squares.end();
  }
  /** The edges of the block, those of the driven planes in their colours. */
  frame() {
    const { shape, dimension } = this.sample, sides = dimension === 2 ? [shape[0], 1, shape[1]] : shape;
    if (dimension === 2) return;
    const squares = this.squares("frame", ROD, 4 * (shape[0] + shape[1] + shape[2]));
    squares.begin();
    for (let axis = 0; axis < 3; axis++)
      for (const u of [-0.5, 0.5])
        for (const w of [-0.5, 0.5])
          for (let n = 0; n < sides[axis]; n++) {
            const at = [0, 0, 0], [k, l] = [(axis + 1) % 3, (axis + 2) % 3];
            at[axis] = n - (sides[axis] - 1) / 2; at[k] = u * sides[k]; at[l] = w * sides[l];
            squares.put(-1, ...at, axis, 0.002 * this.extent, rgb(axis === 2 ? LOOK.frame : at[2] < 0 ? LOOK.bottom : LOOK.top));
          }
    squares.end();
  }
  /** The spins of the spheres of the path, as arrows. */
  fillArrows() {
    const { sample, choices } = this, { path, place } = sample;
    for (const part of [...this.arrow.children]) this.arrow.remove(part);
    if (!choices.layers.path || sample.dimension === 2) return;
    const chosen = Array.from(path).filter((s) => this.shown[s]);
    if (!chosen.length) return;
    const material = this.arrowMaterial ??= new THREE.MeshLambertMaterial({ color: "#1d2733", transparent: true }), way = new THREE.Object3D();
    const shaft = this.shaft ??= new THREE.CylinderGeometry(0.06, 0.06, 1, 8), head = this.head ??= new THREE.ConeGeometry(0.17, 0.4, 12);
    const [shafts, heads] = [shaft, head].map((shape) => new THREE.InstancedMesh(shape, material, chosen.length));
    const up = new THREE.Vector3(0, 1, 0), spin = new THREE.Vector3();
    chosen.forEach((s, n) => {
      spin.fromArray(sample.spinNow, 3 * s).divideScalar(sample.facts.spin_max);
      const length = 1.3 * spin.length();
      way.quaternion.setFromUnitVectors(up, spin.normalize());
      way.position.fromArray(place, 3 * s);
      way.scale.set(1, Math.max(length, 1e-3), 1);
      way.updateMatrix();
      shafts.setMatrixAt(n, way.matrix);
      way.position.addScaledVector(spin, length / 2);
      way.scale.setScalar(Math.min(1, 2 * length));
      way.updateMatrix();
      heads.setMatrixAt(n, way.matrix);
    });
    for (const part of [shafts, heads]) { Object.assign(part, { frustumCulled: false, renderOrder: 2 }); this.arrow.add(part); }
  }
  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas, ratio = Math.min(2, window.devicePixelRatio || 1);
    if (this.size !== `${width} ${height} ${ratio}`) {
      this.size = `${width} ${height} ${ratio}`;
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    const away = this.camera.position.distanceTo(this.controls.target), deep = this.sample.dimension === 3 ? this.extent : 1e6;
    this.scene.fog.near = Math.max(0.1, away - 0.25 * deep);
    this.scene.fog.far = away + 1.5 * deep;
    this.uniforms.fade.value.set(this.scene.fog.near, this.scene.fog.far);
    this.uniforms.pixel.value = 2 * Math.tan(this.camera.fov * Math.PI / 360) / (height * ratio);
    this.renderer.render(this.scene, this.camera);
  }
  turn(left, up) {
    const { camera, controls } = this, offset = camera.position.clone().sub(controls.target);
    if (this.sample.dimension === 2) {
      const step = 0.06 * offset.length();
      for (const thing of [camera.position, controls.target]) { thing.x -= Math.sign(left) * step; thing.z += Math.sign(up) * step; }
    } else {
      offset.applyAxisAngle(camera.up, left);
      const tilt = Math.acos(offset.z / offset.length()) - up;
      if (tilt > 0.05 && tilt < Math.PI - 0.05) offset.applyAxisAngle(new THREE.Vector3().crossVectors(camera.up, offset).normalize(), -up);
      camera.position.copy(controls.target).add(offset);
    }
    controls.update();
    this.draw();
  }
  zoom(factor) {
    this.camera.position.sub(this.controls.target).multiplyScalar(factor).add(this.controls.target);
    this.controls.update();
    this.draw();
  }
  /** The sphere or contact under a point of the canvas, by a line of sight: {sphere} or {contact}, null for neither. */
  pick(x, y) {
    const ray = this.ray ??= new THREE.Raycaster(), { clientWidth: width, clientHeight: height } = this.canvas;
    ray.setFromCamera(new THREE.Vector2(2 * x / width - 1, 1 - 2 * y / height), this.camera);
    const o = ray.ray.origin.toArray(), d = ray.ray.direction.toArray();
    const pixel = 2 * Math.tan(this.camera.fov * Math.PI / 360) / height;  // its size at distance 1
    let nearest = Infinity, found = null;
    const keep = (distance, what) => { if (distance > 0 && distance < nearest) { nearest = distance; found = what; } };
    for (const [name, { ids, count, radius, place }] of Object.entries(this.layers)) {
      if (name === "frame") continue;
      const plate = ACROSS.includes(name) || (this.sample.dimension === 2 && name === "slipping");
      for (let n = 0; n < count; n++) {
        const at = 12 * n, q = [place[at] - o[0], place[at + 1] - o[1], place[at + 2] - o[2]];
        const ahead = q[0] * d[0] + q[1] * d[1] + q[2] * d[2], off = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] - ahead * ahead;
        if (ahead <= 0 || off > 0.6 + 16 * pixel * pixel * ahead * ahead) continue;
        if (name === "spheres") {
          const reach = Math.max(radius, 3 * pixel * ahead);
          if (off < reach * reach) keep(ahead - Math.sqrt(Math.max(0, radius * radius - off)), { sphere: ids[n] });
          continue;
        }
        const axis = this.sample.along[this.sample.axis[ids[n]]], flat = this.sample.dimension === 2;
        const hit = plate && !flat ? onPlate(q, d, axis) : onRod(q, d, plate ? 2 - axis : axis, ahead, plate ? 0.12 : Math.max(radius, 4 * pixel * ahead));
        if (hit !== null) keep(hit, { contact: ids[n] });
      }
    }
    return found;
  }
  mark(found) {
    const { sample, marker } = this;
    marker.visible = found !== null;
    if (!found) return;
    const [a, b] = found.contact === undefined ? [found.sphere, found.sphere] : [sample.low[found.contact], sample.high[found.contact]];
    marker.position.fromArray(sample.place, 3 * a).lerp(new THREE.Vector3().fromArray(sample.place, 3 * b), 0.5);
    marker.scale.setScalar(found.contact === undefined ? 1.02 : 0.3);
    if (found.contact !== undefined) marker.scale.setComponent(sample.along[sample.axis[found.contact]], 1);
  }
}

/** Least power, or slip, of the slipping contacts that are shown. */
function weakest({ range: [least, most], power }) { return least * (most / least) ** (power / 100); }

/** Distance along a line of sight d at which it meets a unit square across an axis, whose middle is at q; or null. */
function onPlate(q, d, axis) {
  const t = q[axis] / d[axis];
  const misses = [0, 1, 2].some((k) => k !== axis && Math.abs(t * d[k] - q[k]) > 0.47);
  return Number.isFinite(t) && !misses ? t : null;
}

/** The same for a rod of length 1 and a radius. */
function onRod(q, d, axis, ahead, radius) {
  const slope = d[axis], rest = 1 - slope * slope;
  const along = Math.max(-0.5, Math.min(0.5, rest < 1e-9 ? 0 : (ahead * slope - q[axis]) / rest));
  const t = ahead + along * slope, gap = [0, 1, 2].map((k) => q[k] + (k === axis ? along : 0) - t * d[k]);
  return gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2 < radius * radius ? t - radius : null;
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
  const how = is === DRIVEN ? "" : byRun ? (facts.proven ? ", proven" : ", decided by slip and friction, not proven") : ", by slip alone";
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
    const walls = sample.low.reduce((sum, s, c) => sum + (sample.domain[s] !== sample.domain[sample.high[c]]), 0);
    const bottlenecks = sample.betweenness.reduce((sum, b) => sum + (b > 0 && b >= sample.facts.bottleneck_share), 0);
    this.available = { spheres: sample.sites, network: 1, slipping: 1, undecided: sample.state.reduce((sum, is) => sum + (is === UNDECIDED), 0), cut: flags(CUT), walls, path: flags(PATH), bottlenecks };
    PRESETS.forEach(([name], n) => {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: name, disabled: !this.available[PRESETS[n][5]] });
      if (button.disabled) button.title = "This sample has none.";
      button.addEventListener("click", () => { this.usePreset(n); this.changed(); });
      element("presets").append(button);
    });
    for (const [key, text] of LAYERS)
      this.switches[key] = this.tick("layers", text, LOOK[key], false, (on) => { choices.layers[key] = on; this.changed(); });
    for (const [key, text] of COLOURS) element("colour").append(new Option(text, key));
    const members = KINDS.map(() => 0);
    for (const kind of sample.kind) members[kind]++;
    element("kinds").append(Object.assign(document.createElement("p"), { className: "note", textContent: "rigid domains locked to" }));
    this.kinds = KINDS.map(([text], kind) => {
      const made = this.tick("kinds", text, null, true, (on) => { choices.kinds[kind] = on; this.changed(); });
      made.count.textContent = grouped(members[kind]);
      made.label.hidden = made.label.style.display = members[kind] ? "" : "none";
      return made;
    });
  }
  buildSlices() {
    const { sample, choices } = this;
    this.slices = sample.shape.map((side, k) => {
      const row = document.createElement("div"), text = document.createElement("output");
      row.className = "slice";
      row.append("xyz"[k]);
      const ends = ["from", "to"].map((which, end) => {
        const slider = Object.assign(document.createElement("input"), { type: "range", min: 0, max: side - 1, step: 1, value: end ? side - 1 : 0 });
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
    Object.assign(element("time"), { max: last, value: last });
    element("play").addEventListener("click", () => this.play(!this.playing));
    element("reset").addEventListener("click", () => picture.firstView());
    element("picture").addEventListener("click", () => {
      picture.draw();
      const link = Object.assign(document.createElement("a"), { download: "bearing.png", href: picture.canvas.toDataURL("image/png") });
      link.click();
    });
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
    Object.assign(choices, { colour, size, preset: n, power: 0, kinds: KINDS.map((_, kind) => flat || !(some && hidden.includes(kind))) });
    for (const [key] of LAYERS) choices.layers[key] = layers.includes(key) && this.available[key] > 0;
    if (flat) {  // discs stay discs, and lines lie on them
      choices.size = 1;
      choices.layers.spheres = true;
    } else {
      choices.layers.walls = false;
      if (layers.includes("slipping")) choices.power = this.strongest(0.6 * MANY);
    }
  }
  /** Place of the power slider that leaves about so many contacts of many. */
  strongest(left) {
    const { sample, choices } = this, [least, most] = choices.range;
    const values = sample.valuesNow.filter((value, c) => sample.judged[c] === SLIPPING && value > 0).sort();
    return values.length <= MANY ? 0 : Math.ceil(100 * Math.log(values[values.length - left] / least) / Math.log(most / least));
  }
  /** States anew, after a change of the threshold or of the time. */
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
  }
  show() {
    const { sample, choices, picture } = this, { facts, counts } = sample;
    for (const [key] of LAYERS) {
      const { box, label } = this.switches[key];
      box.checked = choices.layers[key];
      box.disabled = this.available[key] === 0;
      label.classList.toggle("off", box.disabled);
    }
    const number = { ...this.available, network: counts.slipless, slipping: counts.slipping, undecided: counts.undecided };
    for (const [key] of LAYERS) this.switches[key].count.textContent = number[key] ? grouped(number[key]) : "none";
    this.kinds.forEach(({ box }, kind) => { box.checked = choices.kinds[kind]; });
    [...element("presets").children].forEach((button, n) => button.setAttribute("aria-pressed", String(n === choices.preset)));
    for (const key of ["colour", "size", "power", "threshold", "time"]) element(key).value = choices[key];
    const own = sample.isEnd ? `those of the run (${facts.proven ? "proven" : "not proven"})` : `those up to |v| = ${six(facts.snapshot_threshold)}`;
    element("threshold-text").textContent = choices.slip === null ? own : `those up to ${(choices.slip / facts.jump_speed).toExponential(1)} R Δω`;
    element("threshold").setAttribute("aria-valuetext", element("threshold-text").textContent);
    const open = counts.undecided ? `, ${grouped(counts.undecided)} undecided` : "";
    element("states").textContent = `${grouped(counts.slipless)} slipless, ${grouped(counts.slipping)} slipping${open}. They ${counts.spans ? "join" : "do not join"} bottom and top and touch ${six(100 * counts.reached)} % of the free spheres.`
      + (choices.slip === null && sample.isEnd ? "" : " Domains, path and bottlenecks stay those of the end state of the run.");
    const what = sample.isEnd ? "P" : "|v|";
    element("power-text").textContent = choices.power === 0 ? "all" : `${what} ≥ ${weakest(choices).toExponential(2)}`;
    element("power").setAttribute("aria-valuetext", element("power-text").textContent);
    sample.shape.forEach((side, k) => {
      const { ends, text } = this.slices[k];
      ends[0].value = choices.low[k];
      ends[1].value = choices.high[k];
      text.textContent = choices.low[k] === choices.high[k] ? `${choices.low[k]}` : `${choices.low[k]} – ${choices.high[k]}`;
    });
    this.showTime();
    drawLegend(sample, choices, picture);
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

function swatch(colour) {
  const square = Object.assign(document.createElement("span"), { className: "swatch" });
  square.style.background = colour;
  return square;
}

function drawLegend(sample, choices, picture) {
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
  const { layers } = choices, shares = ["≤ 0.01 %", "0.1 %", "1 %", "10 %", "100 %"];
  if (layers.spheres) {
    const of = { kind: sample.kind, piece: sample.piece, side: sample.above }[choices.colour];
    if (choices.colour === "spin") bar("spheres: |ω| / ω max", sample.map_spin, ["0", "0.5", facts.beyond ? "≥ 1" : "1"]);
    if (choices.colour === "turn") bar(`spheres: how their domain turns${sample.dimension === 3 ? " (yellow, green: by component)" : ""}`, sample.map_spin, ["as the bottom", "as the top"]);
    if (choices.colour === "betweenness") bar("spheres: share of shortest paths", sample.map_share, shares);
    if (of) list({ kind: KINDS, piece: PIECES, side: SIDES }[choices.colour].filter((_, n) => of.includes(n)));
  }
  if (sample.dimension === 3) list([["top plane, driven", LOOK.top], ["bottom plane, driven", LOOK.bottom]]);
  if (layers.network) list([["slipless contacts", LOOK.network]]);
  if (layers.slipping && sample.counts.slipping) {
    const least = weakest(choices), most = choices.range[1], middle = Math.sqrt(least * most), digits = (value) => value.toExponential(1);
    bar(sample.isEnd ? "slipping contacts: power P, energy/time" : "slipping contacts: slip |v|, length/time", sample.map_power, [digits(least), digits(middle), digits(most)]);
  }
  if (layers.undecided) list([["undecided contacts", LOOK.undecided]]);
  if (layers.cut) list([["minimum cut", LOOK.cut]]);
  if (layers.walls) list([["boundaries of rigid domains", LOOK.walls]]);
  if (layers.path) list([[sample.dimension === 3 ? "a shortest path; arrows: its spins" : "a shortest path", LOOK.path]]);
  if (layers.bottlenecks && !(layers.spheres && choices.colour === "betweenness")) bar("bottlenecks: share of shortest paths", sample.map_share, shares);
}

/** Pointing, clicking and keys on the picture. */
function listenToCanvas(sample, picture) {
  const { canvas } = picture, panel = element("numbers");
  let kept = false, waiting = null, pressed = null;
  const tell = (found, x, y) => {
    panel.hidden = found === null;
    picture.mark(found);
    picture.draw();
    if (!found) return;
    const { title, rows } = numbersOf(sample, found), table = document.createElement("table");
    for (const [name, value] of rows) {
      const row = table.insertRow();
      row.append(Object.assign(document.createElement("th"), { textContent: name, scope: "row" }));
      row.insertCell().textContent = value;
    }
    panel.replaceChildren(Object.assign(document.createElement("b"), { textContent: title }), table);
    panel.style.left = `${Math.min(x + 16, canvas.clientWidth - panel.offsetWidth - 8)}px`;
    panel.style.top = `${Math.max(8, Math.min(y + 16, canvas.clientHeight - panel.offsetHeight - 8))}px`;
  };
  const keep = (found, x, y) => { kept = found !== null; panel.classList.toggle("kept", kept); tell(found, x, y); };
  canvas.addEventListener("pointermove", (event) => {
    if (kept || event.buttons) return;
    const { offsetX: x, offsetY: y } = event;
    if (!waiting) waiting = requestAnimationFrame(() => { waiting = null; if (!kept) tell(picture.pick(x, y), x, y); });
  });
  canvas.addEventListener("pointerleave", () => { if (!kept) tell(null); });
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.offsetX, event.offsetY]; });
  canvas.addEventListener("pointerup", ({ offsetX: x, offsetY: y }) => {
    if (pressed && Math.hypot(x - pressed[0], y - pressed[1]) < 4) keep(picture.pick(x, y), x, y);
    pressed = null;
  });
  const middle = () => [canvas.clientWidth / 2, canvas.clientHeight / 2];
  const keys = {
    ArrowLeft: () => picture.turn(-0.1, 0), ArrowRight: () => picture.turn(0.1, 0), ArrowUp: () => picture.turn(0, 0.1),
    ArrowDown: () => picture.turn(0, -0.1), "+": () => picture.zoom(0.9), "=": () => picture.zoom(0.9), "-": () => picture.zoom(1 / 0.9),
    Home: () => picture.firstView(), p: () => keep(picture.pick(...middle()), ...middle()), Escape: () => keep(null),
  };
  canvas.addEventListener("keydown", (event) => {
    const act = event.ctrlKey || event.metaKey || event.altKey ? null : keys[event.key];
    if (act) { event.preventDefault(); act(); }
  });
  new ResizeObserver(() => picture.draw()).observe(canvas);
}

/** Median time of a frame in milliseconds while the picture turns, with what it has drawn really there. */
function frameTime(picture, frames = 20) {
  const gl = picture.renderer.getContext(), pixel = new Uint8Array(4), times = [], from = picture.camera.position.clone();
  for (let n = 0; n < frames; n++) {
    const began = performance.now();
    picture.camera.position.applyAxisAngle(picture.camera.up, 0.02);
    picture.camera.lookAt(picture.controls.target);
    picture.draw();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    times.push(performance.now() - began);
  }
  picture.camera.position.copy(from);
  picture.controls.update();
  picture.draw();
  return times.sort((a, b) => a - b)[frames >> 1];
}

async function start() {
  const began = performance.now();
  if (!("DecompressionStream" in window)) throw new Error("this browser is too old: it must know DecompressionStream, as all do since 2023");
  const code = await (await unpacked("library")).text();
  document.head.append(Object.assign(document.createElement("script"), { textContent: code }));
  const facts = JSON.parse(element("facts").textContent), bytes = await (await unpacked("arrays")).arrayBuffer(), arrays = {};
  const kinds = { f4: Float32Array, i4: Int32Array, u1: Uint8Array };
  for (const { name, kind, offset, length } of facts.arrays) arrays[name] = new kinds[kind](bytes, offset, length);
  const sample = new Sample(facts, arrays);
  if (sample.dimension === 2) LOOK.cut = "#1d2733";  // lines on coloured discs
  const choices = { layers: {}, power: 0, threshold: 0, time: facts.times.length, low: facts.shape.map(() => 0), high: facts.shape.map((side) => side - 1) };
  let picture;
  try {
    picture = new Picture(sample, choices, element("canvas"));
  } catch (error) {
    throw new Error(`this browser shows nothing in three dimensions (WebGL 2): ${error.message}`);
  }
  const controls = new Controls(sample, choices, picture);
  listenToCanvas(sample, picture);
  element("message").textContent = "";
  window.bearings = { sample, choices, picture, controls, frameTime: (frames) => frameTime(picture, frames), milliseconds: performance.now() - began };
}

window.addEventListener("DOMContentLoaded", () => start().catch((error) => { element("message").textContent = `Nothing can be shown: ${error.message}.`; console.error(error); }));
