// Everything is drawn as squares of two triangles. Squares of spheres and rods face the eye, and their shaders draw a
// sphere or a rod on them; plates lie across their contacts. All squares of a layer are one mesh, which is faster than
// thousands of copies of a square.
const COMMON = `
  uniform float pixel, opacity;
  uniform vec2 fade;
  varying vec3 colour;`;
const VERTEX = `${COMMON}
  attribute vec4 paint;
  attribute vec3 way;
  attribute float wide;
  vec2 corner() { return vec2(float(gl_VertexID & 1), float((gl_VertexID >> 1) & 1)) - 0.5; }`;
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
      vec3 middle = (modelViewMatrix * vec4(position, 1.0)).xyz, along = normalize(mat3(modelViewMatrix) * way);
      float radius = max(wide, 0.6 * pixel * length(middle));
      sideways = normalize(cross(along, middle) + vec3(1e-6, 0.0, 0.0));
      facing = normalize(cross(sideways, along));
      facing *= sign(dot(facing, -middle) + 1e-9);
      reach = length(way) / radius;
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
    varying vec2 at;
    void main() {
      colour = paint.rgb;
      at = corner();
      vec3 n = normalize(way), size = abs(n);
      vec3 u = normalize(cross(n, size.x <= size.y && size.x <= size.z ? vec3(1.0, 0.0, 0.0) : size.y <= size.z ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0)));
      point = (modelViewMatrix * vec4(position + wide * (at.x * u + at.y * cross(n, u)), 1.0)).xyz;
      across = mat3(modelViewMatrix) * n;
      gl_Position = projectionMatrix * vec4(point, 1.0);
    }`,
  fragmentShader: `${FRAGMENT}
    uniform float round;
    varying vec3 across, point;
    varying vec2 at;
    void main() {
      if (round * dot(at, at) > 0.25) discard;
      gl_FragColor = shaded(normalize(dot(across, point) > 0.0 ? -across : across), length(point), 1.0);
    }`,
};

/** The squares of one layer, of which there are at most `most`: fill it by begin(), put(...) for each square, end(). */
class Squares {
  constructor(scene, shaders, uniforms, most) {
    const shape = this.shape = new THREE.BufferGeometry(), index = new Uint32Array(6 * most);
    this.shaders = shaders;
    for (let n = 0; n < most; n++) index.set([4 * n, 4 * n + 1, 4 * n + 2, 4 * n + 2, 4 * n + 1, 4 * n + 3], 6 * n);
    shape.setIndex(new THREE.BufferAttribute(index, 1));
    this.place = new Float32Array(12 * most);
    this.way = new Float32Array(12 * most);
    this.paint = new Uint8Array(16 * most);
    this.wide = new Float32Array(4 * most);
    shape.setAttribute("position", new THREE.BufferAttribute(this.place, 3));
    shape.setAttribute("way", new THREE.BufferAttribute(this.way, 3));
    shape.setAttribute("paint", new THREE.BufferAttribute(this.paint, 4, true));
    shape.setAttribute("wide", new THREE.BufferAttribute(this.wide, 1));
    this.mesh = new THREE.Mesh(shape, new THREE.ShaderMaterial({
      ...shaders, uniforms: { ...uniforms, opacity: { value: 1 } }, side: THREE.DoubleSide,
    }));
    this.mesh.frustumCulled = false;
    this.ids = new Int32Array(most);
    this.begin();
    scene.add(this.mesh);
  }
  begin() { this.count = 0; }
  /** Set the opacity of the layer: 1 hides everything behind it, less lets it shine through. */
  see(opacity) {
    this.mesh.renderOrder = opacity < 1 ? 1 : 0;
    this.mesh.material.uniforms.opacity.value = opacity;
    Object.assign(this.mesh.material, { transparent: opacity < 1, depthWrite: opacity === 1 });
  }
  /** Add the square of the sphere or contact `id`, with its middle at (x, y, z).
   * (u, v, w) : vector along half a rod, or normal of a plate. wide : diameter of a sphere, side of a plate, radius of a rod. */
  put(id, x, y, z, u, v, w, wide, colour) {
    const n = this.count++, { place, way, paint } = this;
    for (let k = 4 * n; k < 4 * n + 4; k++) {
      place[3 * k] = x; place[3 * k + 1] = y; place[3 * k + 2] = z;
      way[3 * k] = u; way[3 * k + 1] = v; way[3 * k + 2] = w;
      paint[4 * k] = 255 * colour[0]; paint[4 * k + 1] = 255 * colour[1]; paint[4 * k + 2] = 255 * colour[2];
      this.wide[k] = wide;
    }
    this.ids[n] = id;
  }
  end() {
    this.mesh.visible = this.count > 0;
    this.shape.setDrawRange(0, 6 * this.count);
    for (const name of ["position", "way", "paint", "wide"]) {
      const attribute = this.shape.getAttribute(name);
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, 4 * attribute.itemSize * this.count);
      attribute.needsUpdate = true;
    }
  }
}
