// 3-D scene of the mechanism at the measured joints. It is updated only while it is visible.
import { rcm } from "../connection.js";
import { findNiceguiElement } from "./nicegui_element.js";

const REFRESH_MS = 66, BALL_RADIUS_MM = 4, SHAFT_RADIUS_MM = 1.2;
const BLUE = "#005aff", BLACK = "#000000", YELLOW = "#e6c000", GREY = "#808080";

let element = null; // NiceGUI's element of the scene
let mechanism = null; // objects of the scene that move

async function refresh() {
  const { id, limits } = window.RCMSERVO.scene;
  element = findNiceguiElement(id) || element;
  if (element?.renderer && !mechanism) mechanism = await buildMechanism(element, limits);
  if (mechanism && mechanism.isVisible()) {
    mechanism.tool.moveTo(rcm.board.tool);
    mechanism.target.moveTo(rcm.board.tool_target);
  }
  setTimeout(refresh, REFRESH_MS);
}
refresh();

// Add the RCM, the base axes, the surface of marker 1, the target and the tool to the scene.
async function buildMechanism(element, limits) {
  const { THREE } = await import("nicegui-scene");
  const isVisible = () =>
    element.$el.isConnected && element.$el.offsetParent !== null && !document.hidden;
  const render = element.renderer.render.bind(element.renderer);
  element.renderer.render = (...objects) => { if (isVisible()) render(...objects); };
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

// Add a tool from the RCM to its tip, with balls at both markers. `moveTo` takes the points of
// marker 1, marker 2 and tip in mm, or null to hide the tool.
function addTool(THREE, scene, color) {
  const shaft = new THREE.Mesh(
    new THREE.CylinderGeometry(SHAFT_RADIUS_MM, SHAFT_RADIUS_MM, 1, 12),
    new THREE.MeshPhongMaterial({ color }));
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

// Return the surface of marker 1 at full insertion; `limits` is a grid of points in mm.
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
