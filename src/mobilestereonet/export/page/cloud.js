// A point cloud to turn, with three.js.
import {
  BufferAttribute,
  BufferGeometry,
  LinearSRGBColorSpace,
  PerspectiveCamera,
  Points,
  PointsMaterial,
  Scene,
  WebGLRenderer,
} from "./runtime/three.module.js";
import { OrbitControls } from "./runtime/OrbitControls.js";

let renderer, controls, camera, columns;
const scene = new Scene();

// Shows points (x right, y up, -z ahead, in any unit) with colours in 0..255, seen from the camera
// that took them.
//   view: its vertical angle in degrees, its columns, the distance of what to turn around, and
//     whether to stay where the visitor has turned to
export function showCloud(canvas, positions, colours, view) {
  const first = !renderer;
  if (first) {
    renderer = new WebGLRenderer({ canvas, antialias: true });
    renderer.outputColorSpace = LinearSRGBColorSpace; // the colours are a photo's already
    camera = new PerspectiveCamera();
    controls = new OrbitControls(camera, canvas);
    controls.addEventListener("change", render);
    new ResizeObserver(fit).observe(canvas);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("color", new BufferAttribute(colours, 3, true));
  const material = new PointsMaterial({ sizeAttenuation: false, vertexColors: true });
  for (const points of [...scene.children]) {
    points.geometry.dispose();
    points.material.dispose();
    scene.remove(points);
  }
  scene.add(new Points(geometry, material));
  columns = view.columns;
  if (first || !view.stay) {
    camera.fov = view.angle;
    [camera.near, camera.far] = [view.distance / 100, view.distance * 100];
    camera.position.set(0.15 * view.distance, 0.1 * view.distance, 0.1 * view.distance);
    controls.target.set(0, 0, -view.distance);
    controls.update();
  }
  fit();
}

function fit() {
  const canvas = renderer.domElement;
  renderer.setPixelRatio(devicePixelRatio);
  renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
  camera.aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
  camera.updateProjectionMatrix();
  // Points of a surface that is seen from the front touch one another.
  const size = Math.ceil((1.5 * canvas.clientWidth * devicePixelRatio) / columns);
  for (const points of scene.children) points.material.size = size;
  render();
}

function render() {
  renderer.render(scene, camera);
}
