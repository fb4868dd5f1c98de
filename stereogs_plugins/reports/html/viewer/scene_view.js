// The 3D view of a report: Gaussians drawn by Spark, turned with mouse, keys or fingers.
// `make viewer-bundle` makes viewer.js from this file; the page calls showScene with what it holds.
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import {
  Color,
  Matrix4,
  PerspectiveCamera,
  Scene,
  SRGBColorSpace,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const MOST_PIXELS_A_POINT = 2; // finer screens cost four times the time and show no more detail

/**
 * Show a scene in an element until the page is closed.
 *
 * @param {HTMLElement} place - what the canvas fills.
 * @param {Uint8Array} splats - the Gaussians, as an SPZ file.
 * @param {object} setup - up, target: [x, y, z]; background: [r, g, b] in [0, 1]; dilation, and
 *   compensate: whether opacities make up for it; views: [{pose, fov}], pose being camera-to-world
 *   in OpenGL's axes, row by row, and fov vertical, in degrees.
 * @returns {Promise<object>} - once the Gaussians are there: look(index) moves the camera to a view.
 */
async function showScene(place, splats, setup) {
  const renderer = new WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, MOST_PIXELS_A_POINT));
  renderer.setClearColor(new Color().setRGB(...setup.background, SRGBColorSpace));
  const camera = new PerspectiveCamera();
  camera.up.set(...setup.up); // what OrbitControls turns about from now on
  const scene = new Scene();
  let asked = false;
  const draw = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      renderer.render(scene, camera);
    });
  };
  const spark = new SparkRenderer({
    renderer,
    onDirty: draw,
    sortRadial: false,
    preBlurAmount: setup.compensate ? 0 : setup.dilation,
    blurAmount: setup.compensate ? setup.dilation : 0,
  });
  const mesh = new SplatMesh({ fileBytes: splats, fileType: "spz" });
  scene.add(spark, mesh);
  place.replaceChildren(renderer.domElement);

  const controls = new OrbitControls(camera, renderer.domElement);
  controls.addEventListener("change", draw);
  const target = new Vector3(...setup.target);
  const look = (index) => {
    const view = setup.views[index];
    const pose = new Matrix4().set(...view.pose);
    const eye = new Vector3().setFromMatrixPosition(pose);
    const ahead = new Vector3().setFromMatrixColumn(pose, 2).negate();
    camera.up.setFromMatrixColumn(pose, 1); // the photograph's own: it may have been held askew
    // The point to turn about lies on the view's axis, as far as the middle of the scene.
    const reach = Math.max(target.clone().sub(eye).dot(ahead), camera.near);
    camera.position.copy(eye);
    camera.fov = view.fov;
    camera.near = reach / 1000;
    camera.far = reach * 1000;
    camera.updateProjectionMatrix();
    controls.target.copy(eye).addScaledVector(ahead, reach);
    controls.update();
    draw();
  };
  const fit = () => {
    const { clientWidth: width, clientHeight: height } = place;
    if (!width || !height) return;
    renderer.setSize(width, height);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  };
  new ResizeObserver(fit).observe(place);
  fit();
  look(0);
  await mesh.initialized;
  draw();
  return { look };
}

globalThis.showScene = showScene;
