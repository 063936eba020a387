// 3-D scene of the mechanism at the measured joints. It is updated only while it is visible.
import { niceguiElement } from "./nicegui_element.js";

const REFRESH_MS = 66, BALL_RADIUS_MM = 4;
const BLUE = "#005aff", BLACK = "#000000", YELLOW = "#e6c000", GREY = "#808080";

export function start(rcm) {
  let element = null, drawing = null;
  const repeat = async () => {
    const { id, limits } = window.RCMSERVO.scene;
    element = niceguiElement(id) || element;
    if (element?.renderer && !drawing) drawing = await build(element, limits);
    if (drawing && drawing.isVisible()) {
      drawing.tool.moveTo(rcm.board.tool);
      drawing.target.moveTo(rcm.board.tool_target);
    }
    setTimeout(repeat, REFRESH_MS);
  };
  repeat();
}

async function build(element, limits) {
  const { THREE } = await import("nicegui-scene");
  const isVisible = () =>
    element.$el.isConnected && element.$el.offsetParent !== null && !document.hidden;
  const render = element.renderer.render.bind(element.renderer);
  element.renderer.render = (...scene) => { if (isVisible()) render(...scene); };
  const extent = Math.max(...limits.flat().map((point) => Math.hypot(...point)));
  element.scene.add(
    makeBall(THREE, YELLOW, 1.3 * BALL_RADIUS_MM), new THREE.AxesHelper(0.3 * extent));
  element.scene.add(makeSurface(THREE, limits));
  const target = addTool(THREE, element.scene, BLACK), tool = addTool(THREE, element.scene, BLUE);
  return { isVisible, tool, target };
}

function makeBall(THREE, color, radius) {
  return new THREE.Mesh(
    new THREE.SphereGeometry(radius, 20, 14), new THREE.MeshPhongMaterial({ color }));
}

// Add a tool from the RCM to its tip, with balls at both markers.
function addTool(THREE, scene, color) {
  const shaft = new THREE.Mesh(
    new THREE.CylinderGeometry(1.2, 1.2, 1, 12), new THREE.MeshPhongMaterial({ color }));
  const balls = [1, 2].map(() => makeBall(THREE, color, BALL_RADIUS_MM));
  const group = new THREE.Group();
  group.add(shaft, ...balls);
  scene.add(group);
  const up = new THREE.Vector3(0, 1, 0);
  const moveTo = (points) => {
    group.visible = Array.isArray(points);
    if (!group.visible) return;
    const [p1, p2, tip] = points.map((point) => new THREE.Vector3(...point));
    balls[0].position.copy(p1);
    balls[1].position.copy(p2);
    shaft.position.copy(tip).multiplyScalar(0.5);
    shaft.scale.set(1, tip.length(), 1);
    shaft.quaternion.setFromUnitVectors(up, tip.clone().normalize());
  };
  moveTo(null);
  return { moveTo };
}

// Surface of marker 1 at full insertion.
function makeSurface(THREE, limits) {
  const rows = limits.length, columns = limits[0].length, index = [];
  for (let i = 0; i + 1 < rows; i += 1) {
    for (let j = 0; j + 1 < columns; j += 1) {
      const a = i * columns + j, b = a + 1, c = a + columns, d = c + 1;
      index.push(a, c, b, b, c, d);
    }
  }
  const geometry = new THREE.BufferGeometry();
  const vertices = new Float32Array(limits.flat(2));
  geometry.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
  geometry.setIndex(index);
  const material = { color: GREY, transparent: true, opacity: 0.25, side: THREE.DoubleSide,
    depthWrite: false };
  return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(material));
}
