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
    this.arrows = new THREE.Object3D();
    this.scene.add(this.arrows);
    if (sample.dimension === 3) this.frame();
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
  squares(name, shaders, most = this.sample.lines, opacity = 1) {
    const made = this.layers[name] ??= new Squares(this.scene, shaders, this.uniforms, most, opacity);
    if (OVER.includes(name)) Object.assign(made.mesh, { renderOrder: 2 }).material.transparent = true;
    return made;
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
  /** The colour of a sphere, as a function. */
  colourOf() {
    const { sample, choices } = this, { turn, spinNow: w, sphere_betweenness: share } = sample, { spin_max } = sample.facts;
    const listed = { kind: [KINDS, sample.kind], piece: [PIECES, sample.piece], side: [SIDES, sample.above] }[choices.colour];
    if (listed) {
      const [table, value] = listed, colours = table.map(([, hex]) => rgb(hex));
      return (s) => colours[value[s]];
    }
    const grey = rgb(LOOK.plain);
    return {
      spin: (s) => shade(sample.map_spin, Math.hypot(w[3 * s], w[3 * s + 1], w[3 * s + 2]) / spin_max),
      turn: (s) => [turn[3 * s] / 255, turn[3 * s + 1] / 255, turn[3 * s + 2] / 255],
      betweenness: (s) => shade(sample.map_share, 1 - Math.log10(Math.max(1e-30, share[s])) / SHARES),
      plain: () => grey,
    }[choices.colour];
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
    const { sample, choices } = this, { judged, flags, domain, low, high, betweenness } = sample;
    const thin = sample.dimension === 2 ? 0.09 : 0.075, plain = Object.fromEntries(Object.entries(LOOK).map(([name, hex]) => [name, rgb(hex)]));
    const values = sample.valuesNow, least = weakest(choices), decades = Math.log10(choices.range[1] / least) || 1;
    const faint = choices.power > 0 ? least : 0;
    const { bottleneck_share, busiest_share: busiest } = sample.facts, bold = Math.max(1, this.extent / 30);
    this.fill("network", thin, (c) => judged[c] === SLIPLESS ? plain.network : null);
    this.fill("slipping", 1.5 * thin, (c) => judged[c] !== SLIPPING || values[c] < faint ? null
      : shade(sample.map_power, Math.log10(Math.max(values[c], least) / least) / decades));
    this.fill("undecided", 1.5 * thin, (c) => judged[c] === UNDECIDED ? plain.undecided : null);
    this.fill("cut", 0.94, (c) => flags[c] & CUT ? plain.cut : null);
    this.fill("walls", 0.94, (c) => domain[low[c]] !== domain[high[c]] && this.bounds(c) ? plain.walls : null);
    this.fill("path", 2.2 * bold * thin, (c) => flags[c] & PATH ? plain.path : null);
    this.fill("bottlenecks", 3 * bold * thin, (c) => betweenness[c] > 0 && betweenness[c] >= bottleneck_share
      ? shade(sample.map_share, 1 - Math.log10(betweenness[c]) / SHARES) : null, (c) => bold * thin * (1.4 + 3 * Math.sqrt(betweenness[c] / busiest)));
  }
  /** Boundaries are drawn around the spheres that are. */
  bounds(c) { const { kind, low, high } = this.sample; return this.choices.kinds[kind[low[c]]] || this.choices.kinds[kind[high[c]]]; }
  /** One layer of contacts; colour : of a contact, null where it does not belong. In 2D lines lie on the discs, and
   * what is across a contact is a line, too. */
  fill(name, radius, colour, radiusOf = null) {
    const { sample, choices, shown } = this, { place, low, high, axis, along } = sample, flat = sample.dimension === 2;
    const across = ACROSS.includes(name) || (flat && name === "slipping"), before = !flat ? 0 : across ? -0.56 : -0.62;
    if (!choices.layers[name] && !this.layers[name]) return;
    const squares = this.squares(name, across && !flat ? PLATE : ROD, sample.lines, name === "network" && !flat && sample.contacts > 4 * MANY ? 0.16 : 1);
    squares.begin();
    squares.radius = radius;
    if (choices.layers[name])
      for (let c = 0; c < sample.contacts; c++) {
        const a = low[c], b = high[c], paint = (across ? shown[a] || shown[b] : shown[a] && shown[b]) ? colour(c) : null;
        if (!paint) continue;
        const k = along[axis[c]], sides = sample.isOver(c) ? 2 : 1, half = sides === 2 && !across, far = half ? 0.25 : 0.5;
        for (let n = 0; n < sides; n++) {
          const s = 3 * (n ? b : a), way = n ? -far : far;
          squares.put(c, place[s] + (k === 0 ? way : 0), place[s + 1] + (k === 1 ? way : 0) + before, place[s + 2] + (k === 2 ? way : 0),
            (flat && across ? 2 - k : k) + (half ? 3 : 0), flat && across ? FLAT[name] : radiusOf ? radiusOf(c) : radius, paint);
        }
      }
    squares.end();
  }
  /** The edges of the block, those of the driven planes in their colours. */
  frame() {
    const sides = this.sample.shape, squares = this.squares("frame", ROD, 4 * (sides[0] + sides[1] + sides[2]));
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
    for (const part of [...this.arrows.children]) { this.arrows.remove(part); part.dispose(); }
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
    for (const [name, { ids, count, radius, place, paint }] of Object.entries(this.layers)) {
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
        const hit = plate && !flat ? onPlate(q, d, axis) : onRod(q, d, plate ? 2 - axis : axis, ahead, plate ? 0.12 : Math.max(radius, 4 * pixel * ahead), paint[16 * n + 3] > 2 ? 0.25 : 0.5);
        if (hit !== null) keep(hit, { contact: ids[n] });
      }
    }
    return found;
  }
  mark(found) {
    const { sample, marker } = this;
    marker.visible = found !== null;
    if (!found) return;
    const c = found.contact;
    marker.position.fromArray(sample.place, 3 * (c === undefined ? found.sphere : sample.low[c]));
    marker.scale.setScalar(c === undefined ? 1.02 : 0.3);
    if (c === undefined) return;
    const k = sample.along[sample.axis[c]], length = sample.isOver(c) ? 0.5 : 1;
    marker.position.setComponent(k, marker.position.getComponent(k) + length / 2);
    marker.scale.setComponent(k, length);
  }
}

/** The colour of a map at a part of its length. */
function shade(map, part) {
  const at = 3 * Math.round(255 * Math.min(1, Math.max(0, part)));
  return [map[at] / 255, map[at + 1] / 255, map[at + 2] / 255];
}

/** Least power, or slip, of the slipping contacts that are shown. */
function weakest({ range: [least, most], power }) { return least * (most / least) ** (power / 100); }

/** Distance along a line of sight d at which it meets a unit square across an axis, whose middle is at q; or null. */
function onPlate(q, d, axis) {
  const t = q[axis] / d[axis];
  const misses = [0, 1, 2].some((k) => k !== axis && Math.abs(t * d[k] - q[k]) > 0.47);
  return Number.isFinite(t) && !misses ? t : null;
}

/** The same for a rod of a radius that reaches so far from its middle. */
function onRod(q, d, axis, ahead, radius, reach) {
  const slope = d[axis], rest = 1 - slope * slope;
  const along = Math.max(-reach, Math.min(reach, rest < 1e-9 ? 0 : (ahead * slope - q[axis]) / rest));
  const t = ahead + along * slope, gap = [0, 1, 2].map((k) => q[k] + (k === axis ? along : 0) - t * d[k]);
  return gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2 < radius * radius ? t - radius : null;
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
