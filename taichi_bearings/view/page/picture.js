/** Draws a sample with the layers, colours and slices that the choices of the form name. */
class Picture {
  constructor(sample, choices, canvas) {
    Object.assign(this, { sample, choices, canvas, layers: {}, shown: new Uint8Array(sample.spheres) });
    THREE.ColorManagement.enabled = false;  // colours on the screen are those of the legend
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, powerPreference: "high-performance" });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.setClearColor(0xffffff);
    this.extent = Math.hypot(...sample.sides);
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(0xffffff, 1, 2);
    this.uniforms = { fade: { value: new THREE.Vector2() }, pixel: { value: 1 }, round: { value: sample.facts.shape ? 0 : 1 } };
    const least = sample.size.reduce((a, b) => Math.min(a, b), 1);
    this.camera = new THREE.PerspectiveCamera(28, 1, 0.1 * least, 20 * this.extent + 50);
    this.camera.up.set(0, 0, 1);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xc3c9d2, 2.35), this.camera);
    const lamp = new THREE.DirectionalLight(0xffffff, 1.25);
    lamp.position.set(-0.5, 0.8, 1);
    this.camera.add(lamp);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { zoomToCursor: true, enableRotate: sample.dimension === 3, minDistance: 2 * least, maxDistance: 8 * this.extent + 20 });
    if (sample.dimension === 2) this.controls.mouseButtons.LEFT = 2;  // drags
    this.controls.addEventListener("change", () => this.draw());
    this.marker = new THREE.Mesh(new THREE.BoxGeometry(1, 1, 1), new THREE.MeshBasicMaterial({ color: "#000000", wireframe: true, fog: false, depthTest: sample.dimension === 3 }));
    this.marker.renderOrder = 3;
    this.scene.add(this.marker);
    this.marker.visible = false;
    this.arrows = new THREE.Object3D();
    this.scene.add(this.arrows);
    if (sample.dimension === 3) this.frame();
    this.nameAxes();
    this.firstView();
  }
  firstView() {
    const flat = this.sample.dimension === 2, aspect = Math.max(0.4, this.canvas.clientWidth / this.canvas.clientHeight);
    const away = 1 / Math.tan(this.camera.fov * Math.PI / 360);
    if (flat) this.camera.position.set(0, -away * 0.62 * Math.max(this.sample.sides[1] + 1, (this.sample.sides[0] + 1) / aspect) - 1, 0);
    else this.camera.position.set(0.56, -0.75, 0.42).normalize().multiplyScalar(away * 0.57 * this.extent * Math.max(1, 1 / aspect));
    this.controls.target.set(0, 0, 0);
    this.controls.update();
    this.draw();
  }
  /** Return the squares of a layer; they are made when it is first shown. */
  squares(name, shaders, most = this.sample.lines) {
    const made = this.layers[name] ??= new Squares(this.scene, shaders, this.uniforms, most);
    if (this.sample.dimension === 2 && shaders === ROD) Object.assign(made.mesh, { renderOrder: this.isAcross(name) ? 1 : 2 }).material.depthTest = false;
    if (OVER.includes(name)) Object.assign(made.mesh, { renderOrder: 2 }).material.transparent = true;
    return made;
  }
  /** True if a layer draws its contacts as something across them (plates, in 2D lines), not from centre to centre. */
  isAcross(name) { return ACROSS.includes(name) || (this.sample.dimension === 2 && name === "slipping"); }
  /** Set `shown` of each sphere: 1 if it lies between the chosen slices of all axes, else 0. */
  slice() {
    const { low, high } = this.choices;
    this.shown.fill(1);
    this.sample.slices.forEach(({ cell }, k) => { for (let s = 0; s < cell.length; s++) this.shown[s] &= cell[s] >= low[k] && cell[s] <= high[k]; });
  }
  refresh() {
    this.slice();
    this.fillSpheres();
    this.fillContacts();
    this.fillArrows();
    this.draw();
  }
  /** Return a function that gives the colour of a sphere by its number. */
  colourOf() {
    const { sample, choices } = this, { turn, spinNow: w, sphere_betweenness: share, size, domain, domain_size: members, body } = sample, { spin_max } = sample.facts;
    const chosen = sample.colouring(choices), listed = sample.listed(chosen);
    if (listed) {
      const { table, value } = listed, colours = table.map(([, hex]) => rgb(hex));
      return (s) => colours[value[s]];
    }
    const grey = rgb(LOOK.plain), telling = TELLING.map(rgb);
    if (chosen === "domain") {  // colours go to the domains in the order of their sizes
      const place = new Int32Array(members.length);
      [...members.keys()].sort((a, b) => members[b] - members[a]).forEach((label, n) => { place[label] = n; });
      return (s) => members[domain[s]] > 1 ? telling[place[domain[s]] % telling.length] : grey;
    }
    return {
      spin: (s) => shade(sample.map_spin, size[s] * Math.hypot(w[3 * s], w[3 * s + 1], w[3 * s + 2]) / spin_max),
      body: (s) => body[s] < 0 ? grey : telling[body[s] % telling.length],
      turn: (s) => [turn[3 * s] / 255, turn[3 * s + 1] / 255, turn[3 * s + 2] / 255],
      betweenness: (s) => shade(sample.map_share, 1 - Math.log10(Math.max(1e-30, share[s])) / SHARES),
      plain: () => grey,
    }[chosen];
  }
  fillSpheres() {
    const { sample, choices, shown } = this, { spheres, place } = sample, balls = this.squares("spheres", SPHERE, spheres);
    balls.begin();
    if (choices.layers.spheres) {
      const drawn = shown.map((is, s) => is && (!sample.isEnd || choices.kinds[sample.kind[s]])), colour = this.colourOf();
      const hidden = choices.size >= 0.95 && sample.facts.enclosing ? this.inner(this.inner(drawn)) : null;
      for (let s = 0; s < spheres; s++)
        if (drawn[s] && !hidden?.[s]) balls.put(s, place[3 * s], place[3 * s + 1], place[3 * s + 2], 0, 0, 0, choices.size * sample.size[s], colour(s));
    }
    balls.end();
  }
  /** Return a mask of the spheres that have `facts.enclosing` neighbours in a mask. A sphere whose neighbours all have so
   * many drawn ones cannot be seen. */
  inner(there) {
    const { first, second, over, contacts, facts } = this.sample, around = new Uint8Array(there.length);
    for (let c = 0; c < contacts; c++) {
      const a = first[c], b = second[c];
      if (!over[c] && there[a] && there[b]) { around[a]++; around[b]++; }
    }
    return around.map((count) => count >= facts.enclosing);
  }
  fillContacts() {
    const { sample, choices } = this, { judged, flags, domain, first, second, betweenness } = sample;
    const thin = sample.dimension === 2 ? 0.09 : 0.075, plain = Object.fromEntries(Object.entries(LOOK).map(([name, hex]) => [name, rgb(hex)]));
    const values = sample.valuesNow, least = weakest(choices), decades = Math.log10(choices.range[1] / least) || 1;
    const faint = choices.power > 0 ? least : 0;
    const { bottleneck_share, busiest_share: busiest } = sample.facts, bold = Math.max(1, this.extent / 30);
    this.fill("network", thin, (c) => judged[c] === SLIPLESS ? plain.network : null);
    this.fill("slipping", 1.5 * thin, (c) => judged[c] !== SLIPPING || values[c] < faint ? null
      : shade(sample.map_power, Math.log10(Math.max(values[c], least) / least) / decades));
    this.fill("undecided", 1.5 * thin, (c) => judged[c] === UNDECIDED || judged[c] === TIED ? plain.undecided : null);
    this.fill("cut", 0.94, (c) => flags[c] & CUT ? plain.cut : null);
    this.fill("walls", 0.94, (c) => domain[first[c]] !== domain[second[c]] && this.bounds(c) ? plain.walls : null);
    this.fill("path", 2.2 * bold * thin, (c) => flags[c] & PATH ? plain.path : null);
    this.fill("bottlenecks", 3 * bold * thin, (c) => betweenness[c] > 0 && betweenness[c] >= bottleneck_share
      ? shade(sample.map_share, 1 - Math.log10(betweenness[c]) / SHARES) : null, (c) => bold * thin * (1.4 + 3 * Math.sqrt(betweenness[c] / busiest)));
  }
  /** True if the domain boundary at a contact is drawn: if one of its spheres is in a domain of a kind that is shown. */
  bounds(c) { const { kind, first, second } = this.sample; return this.choices.kinds[kind[first[c]]] || this.choices.kinds[kind[second[c]]]; }
  /** Draw one layer of contacts. colour : function of a contact, null where it does not belong to the layer. radius : of
   * a rod between spheres of size 1. In 2D lines lie on the discs, and what is across a contact is a line, too. */
  fill(name, radius, colour, radiusOf = null) {
    const { sample, choices, shown } = this, { place, way, size, over, first, second } = sample, flat = sample.dimension === 2, across = this.isAcross(name);
    const drawn = sample.draws(name, choices);
    if (!drawn && !this.layers[name]) return;
    const squares = this.squares(name, across && !flat ? PLATE : ROD);
    squares.begin();
    if (drawn)
      for (let c = 0; c < sample.contacts; c++) {
        const a = first[c], b = second[c], paint = (across ? shown[a] || shown[b] : shown[a] && shown[b]) ? colour(c) : null;
        if (!paint) continue;
        const smaller = Math.min(size[a], size[b]), wide = smaller * (flat && across ? FLAT[name] : radiusOf ? radiusOf(c) : radius);
        const u = way[3 * c], v = way[3 * c + 1], w = way[3 * c + 2], turned = smaller / (size[a] + size[b]);
        for (let n = 0; n <= over[c]; n++) {  // one line, or two from both centres to the contact across a periodic side
          const s = 3 * (n ? b : a), part = n ? -size[b] / (size[a] + size[b]) : over[c] || across ? size[a] / (size[a] + size[b]) : 1;
          const at = across ? part : part / 2, half = across ? turned : at, [x, y, z] = flat && across ? [-w, v, u] : [u, v, w];
          squares.put(c, place[s] + at * u, place[s + 1] + at * v, place[s + 2] + at * w, half * x, half * y, half * z, wide, paint);
        }
      }
    squares.end();
    if (name === "network" && !flat) squares.see(Math.max(FAINTEST, Math.min(1, 2 * MANY / squares.count)));
  }
  /** Draw the edges of the block; those of driven planes have their colours. */
  frame() {
    const { sides, facts } = this.sample, number = sides.map(Math.ceil), squares = this.squares("frame", ROD, 4 * number.reduce((a, b) => a + b));
    squares.begin();
    for (let axis = 0; axis < 3; axis++)
      for (const u of [-0.5, 0.5])
        for (const w of [-0.5, 0.5])
          for (let n = 0; n < number[axis]; n++) {
            const at = [0, 0, 0], way = [0, 0, 0], [k, l] = [(axis + 1) % 3, (axis + 2) % 3];
            at[axis] = ((n + 0.5) / number[axis] - 0.5) * sides[axis]; at[k] = u * sides[k]; at[l] = w * sides[l];
            way[axis] = sides[axis] / number[axis] / 2;
            squares.put(-1, ...at, ...way, 0.002 * this.extent, rgb(axis === 2 || !facts.shape ? LOOK.frame : at[2] < 0 ? LOOK.bottom : LOOK.top));
          }
    squares.end();
  }
  /** Write the coordinates of the first corner of the block, and of the ends of its edges along the axes. */
  nameAxes() {
    const { slices, sides, dimension } = this.sample, along = dimension === 2 ? [0, 2] : [0, 1, 2];
    const corner = new THREE.Vector3(), name = (place, textContent) => {
      const text = Object.assign(document.createElement("span"), { textContent });
      element("axes").append(text);
      return { place, text };
    };
    along.forEach((axis, k) => corner.setComponent(axis, -sides[k] / 2));
    const start = (k) => k === 1 && dimension === 3 ? corner.clone().setX(sides[0] / 2) : corner.clone();
    this.names = along.map((axis, k) => name(start(k).setComponent(axis, sides[k] / 2 + 0.03 * this.extent), `${"xyz"[k]} = ${slices[k].at(slices[k].steps)}`));
    this.names.push(name(corner.clone().multiplyScalar(1 + 0.04 * this.extent / corner.length()), slices.map(({ at }) => at(0)).join(", ")));
  }
  /** Return where a place of the world is on the canvas, in pixels from its upper left corner. */
  seen(place) {
    const { x, y } = place.clone().project(this.camera), { clientWidth: width, clientHeight: height } = this.canvas;
    return [(x + 1) / 2 * width, (1 - y) / 2 * height];
  }
  /** Return the picture as it is seen, with the names of its axes, as the address of a PNG. */
  copy() {
    this.draw();
    const { canvas, names } = this, copy = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height }), paper = copy.getContext("2d");
    const ratio = canvas.width / canvas.clientWidth;
    paper.drawImage(canvas, 0, 0);
    Object.assign(paper, { font: `${11 * ratio}px sans-serif`, fillStyle: "#566372", textAlign: "center", textBaseline: "middle" });
    for (const { place, text } of names) paper.fillText(text.textContent, ...this.seen(place).map((x) => x * ratio));
    return copy.toDataURL("image/png");
  }
  /** Draw the spins of the spheres of the path as arrows. */
  fillArrows() {
    const { sample, choices } = this, { path, place } = sample;
    for (const part of [...this.arrows.children]) { this.arrows.remove(part); part.dispose(); }
    if (!sample.draws("path", choices) || sample.dimension === 2) return;
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
    for (const part of [shafts, heads]) { Object.assign(part, { frustumCulled: false, renderOrder: 2 }); this.arrows.add(part); }
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
    for (const { place, text } of this.names) {
      const [x, y] = this.seen(place);
      text.style.transform = `translate(-50%, -50%) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
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
  /** Return the sphere or contact under a point of the canvas, as {sphere} or {contact}; null for neither. It is the
   * nearest one that the line of sight meets. */
  pick(x, y) {
    const ray = this.ray ??= new THREE.Raycaster(), { clientWidth: width, clientHeight: height } = this.canvas;
    ray.setFromCamera(new THREE.Vector2(2 * x / width - 1, 1 - 2 * y / height), this.camera);
    const o = ray.ray.origin.toArray(), d = ray.ray.direction.toArray();
    const pixel = 2 * Math.tan(this.camera.fov * Math.PI / 360) / height;  // its size at distance 1
    let nearest = Infinity, found = null;
    const keep = (distance, what) => { if (distance < nearest) { nearest = distance; found = what; } };
    const before = this.sample.dimension === 2 ? 1e9 : 0;  // in 2D contacts lie in front of all discs
    for (const [name, { ids, count, place, way, wide, shaders }] of Object.entries(this.layers)) {
      if (name === "frame") continue;
      for (let n = 0; n < count; n++) {
        const at = 12 * n, q = [place[at] - o[0], place[at + 1] - o[1], place[at + 2] - o[2]], size = wide[4 * n];
        const ahead = q[0] * d[0] + q[1] * d[1] + q[2] * d[2], off = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] - ahead * ahead;
        const half = [way[at], way[at + 1], way[at + 2]], reach = size + Math.hypot(...half) + 4 * pixel * ahead;
        if (ahead <= 0 || off > reach * reach) continue;
        if (shaders === SPHERE) {
          const radius = Math.max(size / 2, 3 * pixel * ahead);
          if (off < radius * radius) keep(ahead - Math.sqrt(Math.max(0, size * size / 4 - off)), { sphere: ids[n] });
          continue;
        }
        const hit = shaders === PLATE ? onPlate(q, d, half, size / 2, this.uniforms.round.value) : onRod(q, d, half, ahead, Math.max(size, 4 * pixel * ahead));
        if (hit > 0) keep(hit - before, { contact: ids[n] });
      }
    }
    return found;
  }
  mark(found) {
    const { sample, marker } = this;
    marker.visible = found !== null;
    if (!found) return;
    const { contact: c, sphere } = found, { place, way, size, first, second, over } = sample;
    marker.quaternion.identity();
    marker.position.fromArray(place, 3 * (c === undefined ? sphere : first[c]));
    if (c === undefined) { marker.scale.setScalar(1.02 * size[sphere]); return; }
    const along = new THREE.Vector3().fromArray(way, 3 * c), part = over[c] ? size[first[c]] / (size[first[c]] + size[second[c]]) : 1;
    marker.position.addScaledVector(along, part / 2);
    marker.scale.setScalar(0.3 * Math.min(size[first[c]], size[second[c]])).setX(part * along.length());
    marker.quaternion.setFromUnitVectors(new THREE.Vector3(1, 0, 0), along.normalize());
  }
}

/** Return the colour of a colour map at a part of its length, from 0 to 1. */
function shade(map, part) {
  const at = 3 * Math.round(255 * Math.min(1, Math.max(0, part)));
  return [map[at] / 255, map[at + 1] / 255, map[at + 2] / 255];
}

/** Return the least power, or slip, of the slipping contacts that are shown. */
function weakest({ range: [least, most], power }) { return least * (most / least) ** (power / 100); }

/** Return the distance along a line of sight d at which it meets a plate, NaN if it does not. The plate has its middle at
 * q and the normal n; it is a disc, or a square whose sides lie along axes. */
function onPlate(q, d, n, radius, isRound) {
  const t = (q[0] * n[0] + q[1] * n[1] + q[2] * n[2]) / (d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), off = q.map((x, k) => Math.abs(t * d[k] - x));
  return (isRound ? Math.hypot(...off) : Math.max(...off)) <= radius ? t : NaN;
}

/** Return the distance along a line of sight d at which it meets a rod, NaN if it does not. The rod has its middle at q, and
 * the vector `half` leads from there to its end. ahead : the part of q along d. */
function onRod(q, d, half, ahead, radius) {
  const reach = Math.hypot(...half), e = half.map((x) => x / reach), slope = d[0] * e[0] + d[1] * e[1] + d[2] * e[2], rest = 1 - slope * slope;
  const along = Math.max(-reach, Math.min(reach, rest < 1e-9 ? 0 : (ahead * slope - q[0] * e[0] - q[1] * e[1] - q[2] * e[2]) / rest));
  const t = ahead + along * slope, gap = [0, 1, 2].map((k) => q[k] + along * e[k] - t * d[k]);
  return gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2 < radius * radius ? t - radius : NaN;
}

/** Return the median time of a frame in milliseconds while the camera turns; reading a pixel waits until it is drawn. */
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
