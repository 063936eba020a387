// The mechanism in space, from the joints that the arm tells. It moves only while it is looked at.
import { made } from "./made.js";

const EVERY = 66, BLUE = "#005aff", BLACK = "#000000", YELLOW = "#e6c000", GREY = "#808080"; // ms
const BALL = 4; // mm

export function start(rcm) {
  let it = null, drawn = null;
  const again = async () => {
    const { id } = window.RCMSERVO.scene;
    it = made(id) || it;
    if (it?.renderer && !drawn) drawn = await build(it, window.RCMSERVO.scene.limits);
    if (drawn && drawn.seen()) {
      drawn.tool.to(rcm.board.tool);
      drawn.target.to(rcm.board.tool_target);
    }
    setTimeout(again, EVERY);
  };
  again();
}

async function build(it, limits) {
  const { THREE } = await import("nicegui-scene");
  const seen = () => it.$el.isConnected && it.$el.offsetParent !== null && !document.hidden;
  const render = it.renderer.render.bind(it.renderer);
  it.renderer.render = (...what) => { if (seen()) render(...what); };
  const far = Math.max(...limits.flat().map((point) => Math.hypot(...point)));
  it.scene.add(ball(THREE, YELLOW, 1.3 * BALL), new THREE.AxesHelper(0.3 * far));
  it.scene.add(surface(THREE, limits));
  const target = stick(THREE, it.scene, BLACK), tool = stick(THREE, it.scene, BLUE);
  return { seen, tool, target };
}

function ball(THREE, color, radius) {
  return new THREE.Mesh(
    new THREE.SphereGeometry(radius, 20, 14), new THREE.MeshPhongMaterial({ color }));
}

// A tool from the RCM to its tip, with balls at both markers.
function stick(THREE, scene, color) {
  const shaft = new THREE.Mesh(
    new THREE.CylinderGeometry(1.2, 1.2, 1, 12), new THREE.MeshPhongMaterial({ color }));
  const all = new THREE.Group(), balls = [ball(THREE, color, BALL), ball(THREE, color, BALL)];
  all.add(shaft, ...balls);
  scene.add(all);
  const up = new THREE.Vector3(0, 1, 0);
  const to = (points) => {
    all.visible = Array.isArray(points);
    if (!all.visible) return;
    const [one, two, tip] = points.map((point) => new THREE.Vector3(...point));
    balls[0].position.copy(one);
    balls[1].position.copy(two);
    shaft.position.copy(tip).multiplyScalar(0.5);
    shaft.scale.set(1, tip.length(), 1);
    shaft.quaternion.setFromUnitVectors(up, tip.clone().normalize());
  };
  to(null);
  return { to, all };
}

// Where marker 1 can be at full insertion.
function surface(THREE, limits) {
  const rows = limits.length, columns = limits[0].length, index = [];
  for (let i = 0; i + 1 < rows; i += 1) {
    for (let j = 0; j + 1 < columns; j += 1) {
      const a = i * columns + j, b = a + 1, c = a + columns, d = c + 1;
      index.push(a, c, b, b, c, d);
    }
  }
  const geometry = new THREE.BufferGeometry();
  const places = new Float32Array(limits.flat(2));
  geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
  geometry.setIndex(index);
  const look = { color: GREY, transparent: true, opacity: 0.25, side: THREE.DoubleSide,
    depthWrite: false };
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(look));
}
