// The scene of one replay: the athlete's bodies as the physics has them, bar and mat, forces, the path of the jump.
// World frame: x through the bar, y up, metres. Colours and first view are those of the pictures the worker renders.
import {
  AmbientLight, ArrowHelper, BasicShadowMap, BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, DirectionalLight, Fog, Group,
  HemisphereLight, Line, LineBasicMaterial, Mesh, MeshLambertMaterial, PCFShadowMap, PerspectiveCamera, PlaneGeometry,
  Quaternion, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "./vendor/three.module.js";
import { OrbitControls } from "./vendor/OrbitControls.js";

const EYE = new Vector3(-1.7, 0.55, 3.1);
const FIELD = 42;
const LEFT = 0xed7d30;
const RIGHT = 0x2973bd;
const TRUNK = 0x4d5461;
const SKIN = 0xd9a887;
const GRAVITY = 9.81;
const WEIGHT_ARROW = 0.3; // metres for a force of one body weight
const LONGEST_ARROW = 1.5; // a landing pushes with tens of body weights for an instant

// What changes between a light and a dark page: the surroundings, not the athlete.
const SURROUNDINGS = {
  light: { fog: 0xe6eaed, floor: 0xb9bfc4, runway: 0xcc6b54, mat: 0x5c9985, post: 0xe6e6e6, path: 0x101418, sky: 1.5, sun: 2.1 },
  dark: { fog: 0x262d34, floor: 0x3b434b, runway: 0x9c5342, mat: 0x417060, post: 0xc4c8cc, path: 0xf2f4f6, sky: 1.15, sun: 1.9 },
};

export class NoWebGL extends Error {}

let known = null;

// What this browser can draw. Without a graphics card the processor does it, and each pixel's fourfold smoothing shows
// in the frame rate.
function capabilities() {
  if (known) return known;
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) throw new NoWebGL("This browser has no WebGL, which the moving picture needs.");
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "");
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  known = { software: /swiftshader|llvmpipe|software/i.test(name) };
  return known;
}

function geometry({ shape, size }) {
  if (shape === "sphere") return new SphereGeometry(size[0], 20, 14);
  if (shape === "box") return new BoxGeometry(...size);
  // Bullet's capsules lie along z, three's along y.
  return new CapsuleGeometry(size[0], size[1], 6, 16).rotateX(Math.PI / 2);
}

function colourOf(name) {
  if (name === "neck") return SKIN;
  return name.startsWith("left") ? LEFT : name.startsWith("right") ? RIGHT : TRUNK;
}

export class Stage {
  constructor(canvas, replay, { onDraw = () => {}, dark = false } = {}) {
    this.replay = replay;
    this.onDraw = onDraw;
    this.follow = true;
    this.time = 0;
    const { software } = capabilities();
    this.renderer = new WebGLRenderer({ canvas, antialias: !software, alpha: true });
    this.sharpest = software ? 1 : 2;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = software ? BasicShadowMap : PCFShadowMap;
    this.shadowSize = software ? 512 : 1024;
    this.scene = new Scene();
    // The floor ends where nobody can see it.
    this.scene.fog = new Fog(0xe6eaed, 7, 19);
    this.camera = new PerspectiveCamera(FIELD, 1, 0.05, 60);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = Math.PI / 2 - 0.02;
    this.controls.minDistance = 0.8;
    this.controls.maxDistance = 14;
    this.controls.addEventListener("change", () => this.draw());
    this.#light();
    this.#furnish();
    this.#athlete();
    this.#path();
    this.dress(dark);
    this.home();
  }

  dress(dark) {
    const look = SURROUNDINGS[dark ? "dark" : "light"];
    this.scene.fog.color.set(look.fog);
    for (const [part, material] of this.dressed) material.color.set(look[part]);
    this.sky.intensity = look.sky;
    this.sun.intensity = look.sun;
    this.draw();
  }

  #light() {
    this.sky = new HemisphereLight(0xffffff, 0x8a8f96, 1.5);
    this.scene.add(this.sky, new AmbientLight(0xffffff, 0.25));
    const sun = (this.sun = new DirectionalLight(0xffffff, 2.1));
    sun.position.set(-3, 6, 4.5);
    sun.castShadow = true;
    sun.shadow.mapSize.set(this.shadowSize, this.shadowSize);
    Object.assign(sun.shadow.camera, { left: -4, right: 4, top: 4, bottom: -4, near: 0.5, far: 16 });
    sun.shadow.bias = -0.0006;
    this.scene.add(sun, sun.target);
  }

  #solid(shape, colour) {
    const mesh = new Mesh(shape, new MeshLambertMaterial({ color: new Color(colour) }));
    mesh.castShadow = mesh.receiveShadow = true;
    return mesh;
  }

  #box(size, centre, colour) {
    const mesh = this.#solid(new BoxGeometry(...size), colour);
    mesh.position.set(...centre);
    this.scene.add(mesh);
    return mesh;
  }

  #furnish() {
    const { bar, mat_height: mat, wall_half_thickness: wall = 0.02 } = this.replay.header;
    const { light } = SURROUNDINGS;
    const floor = this.#solid(new PlaneGeometry(40, 40).rotateX(-Math.PI / 2), light.floor);
    floor.castShadow = false;
    floor.position.y = -0.021;
    this.scene.add(floor);
    if (!(mat > 0)) {
      // No jump: a track without end, with a line across every metre to see the speed by.
      const track = this.#box([40, 0.02, 3], [10, -0.01, 0], light.runway);
      track.castShadow = false;
      this.dressed = [["floor", floor.material], ["runway", track.material]];
      for (let x = -9; x < 30; x++) {
        const line = this.#box([0.03, 0.004, 3], [x, 0, 0], light.post);
        line.castShadow = false;
        this.dressed.push(["post", line.material]);
      }
      return;
    }
    const obstacle = wall > 0.0201; // the wall that stands for a bar is 0.02 m thick on either side
    const runway = this.#box([6.2, 0.02, 12], [-3, -0.01, 0], light.runway);
    runway.castShadow = false;
    this.dressed = [["floor", floor.material], ["runway", runway.material], ["mat", this.#box([4, mat, 6], [obstacle ? wall + 2 : 2.05, mat / 2, 0], light.mat).material]];
    if (!(bar > 0)) return;
    if (obstacle) {
      this.#box([2 * wall, bar, 4], [0, bar / 2, 0], 0xf2cc26);
      return;
    }
    this.#box([0.04, 0.04, 4], [0, bar - 0.02, 0], 0xf2cc26);
    for (const z of [-2, 2]) this.dressed.push(["post", this.#box([0.06, bar + 0.2, 0.06], [0, bar / 2 + 0.1, z], light.post).material]);
  }

  #athlete() {
    const { header, bodies } = this.replay;
    this.bodies = Array.from({ length: bodies }, () => new Group());
    for (const part of header.shapes) {
      const mesh = this.#solid(geometry(part), colourOf(header.bodies[part.body]));
      mesh.position.set(...part.offset);
      mesh.quaternion.set(...part.rotation);
      this.bodies[part.body].add(mesh);
    }
    this.scene.add(...this.bodies);
    this.weight = header.masses.reduce((sum, mass) => sum + mass, 0) * GRAVITY;
    this.foot = header.bodies.indexOf(header.foot);
    this.arrows = Array.from({ length: bodies }, () => new ArrowHelper(new Vector3(0, 1, 0), new Vector3(), 1, 0x8a2be2, 0.12, 0.08));
    for (const arrow of this.arrows) arrow.visible = false;
    this.scene.add(...this.arrows);
  }

  #path() {
    const points = new BufferGeometry();
    points.setAttribute("position", new BufferAttribute(new Float32Array(this.replay.arrays.com), 3));
    this.path = new Line(points, new LineBasicMaterial({ color: 0x101418, transparent: true, opacity: 0.55 }));
    // What is still to come, faintly.
    const coming = new Line(points.clone(), new LineBasicMaterial({ color: 0x101418, transparent: true, opacity: 0.16 }));
    this.scene.add(this.path, coming);
    this.dressed.push(["path", this.path.material], ["path", coming.material]);
  }

  com(time) {
    const { arrays, frames, step } = this.replay;
    const at = Math.max(0, Math.min(time / step, frames - 1));
    const [i, k] = [Math.floor(at), Math.min(Math.floor(at) + 1, frames - 1)];
    const a = new Vector3().fromArray(arrays.com, 3 * i);
    return a.lerp(new Vector3().fromArray(arrays.com, 3 * k), at - i);
  }

  // The view of the worker's pictures: from beside the bar, on the athlete's side.
  home() {
    const at = this.com(this.time);
    this.controls.target.copy(at);
    this.camera.position.copy(at).add(EYE);
    this.controls.update();
  }

  // The pose at a time, between the frames on either side.
  seek(time) {
    const { arrays, frames, bodies, step } = this.replay;
    const before = this.com(this.time);
    this.time = time;
    const along = Math.max(0, this.com(time).x);
    // Shadows are sharp only near where the light looks: it goes with those who leave the bar behind.
    this.sun.position.x = along - 3;
    this.sun.target.position.x = along;
    const at = Math.max(0, Math.min(time / step, frames - 1));
    const [i, k] = [Math.floor(at), Math.min(Math.floor(at) + 1, frames - 1)];
    const share = at - i;
    const [one, other] = [new Vector3(), new Quaternion()];
    for (let body = 0; body < bodies; body++) {
      const [from, to] = [i * bodies + body, k * bodies + body];
      this.bodies[body].position.fromArray(arrays.position, 3 * from).lerp(one.fromArray(arrays.position, 3 * to), share);
      this.bodies[body].quaternion.fromArray(arrays.orientation, 4 * from).slerp(other.fromArray(arrays.orientation, 4 * to), share);
    }
    this.#push(Math.round(at));
    this.path.geometry.setDrawRange(0, i + 2);
    if (this.follow) {
      const moved = this.com(time).sub(before);
      this.controls.target.add(moved);
      this.camera.position.add(moved);
    }
    this.controls.update();
    this.draw();
  }

  // The forces of ground, wall and mat on each body, where they act. Older files have one number, for the foot.
  #push(frame) {
    const { arrays, bodies } = this.replay;
    this.force = arrays.ground_force[frame] / this.weight;
    for (const [body, arrow] of this.arrows.entries()) {
      const at = 3 * (frame * bodies + body);
      const force = new Vector3();
      if (arrays.contact_force) {
        force.fromArray(arrays.contact_force, at).divideScalar(this.weight);
        arrow.position.fromArray(arrays.contact_point, at);
      } else if (body === this.foot) {
        force.set(0, this.force, 0);
        arrow.position.set(this.bodies[body].position.x, 0, this.bodies[body].position.z);
      }
      const size = force.length();
      arrow.visible = size > 0.02;
      if (!arrow.visible) continue;
      const length = Math.min(LONGEST_ARROW, size * WEIGHT_ARROW);
      arrow.setDirection(force.normalize());
      arrow.setLength(length, Math.min(0.12, 0.4 * length), 0.08);
    }
  }

  // Look from where another stage looks, each at its own athlete.
  lookLike(other) {
    this.camera.position.copy(other.camera.position).sub(other.controls.target).add(this.controls.target);
    this.controls.update();
  }

  resize(width, height) {
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, this.sharpest));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
    this.onDraw();
  }

  dispose() {
    this.scene.traverse((part) => { part.geometry?.dispose(); part.material?.dispose?.(); });
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}
