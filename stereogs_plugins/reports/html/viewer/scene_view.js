// The 3D view of a report: Gaussians drawn by Spark, seen from poses of a Motion.
// `make viewer-bundle` makes viewer.js from this file; the page calls showScene with what it holds.
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import {
  Color,
  MathUtils,
  PerspectiveCamera,
  Scene,
  SRGBColorSpace,
  WebGLRenderer,
} from "three";
import { listen } from "./hands.js";
import { Motion } from "./motion.js";
import { eyeOf, poseOf } from "./poses.js";

const MOST_PIXELS_A_POINT = 2; // finer screens cost four times the time and show no more detail
const SLOW_FRAME = 0.06; // seconds; slower ones are drawn with fewer pixels while the camera moves
const FEWEST_PIXELS_A_POINT = 0.5;
const LONGEST_STEP = 0.25; // seconds; after a pause the camera goes on where it was
const TOO_SLOW = 1; // seconds a frame; without a graphics card, the sweep stops after some of these
const MOST_TOO_SLOW = 8;

/**
 * Show a scene in an element until the page is closed.
 *
 * @param {HTMLElement} place - what the canvas fills.
 * @param {Uint8Array} splats - the Gaussians, as an SPZ file.
 * @param {object} setup - up: [x, y, z]; background: [r, g, b] in [0, 1]; dilation, and
 *   compensate: whether opacities make up for it; shown: share of a photograph's width and height
 *   that is in view, at least; limits: {angle, nearest, farthest, shift}; views:
 *   [{pose, fov, aspect, reach, train}], pose being camera-to-world in OpenGL's axes, row by row,
 *   fov vertical, in degrees, and reach the distance to the subject.
 * @param {() => void} onChange - called when `sweeping` or `away` may have changed.
 * @returns {Promise<object>} - once the Gaussians are there: look(index) moves the camera to a view,
 *   back() to the nearest photograph, play() and pause() the sweep; sweeping and away tell where it
 *   is; eye() and target() return [x, y, z].
 */
async function showScene(place, splats, setup, onChange) {
  const renderer = new WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
  renderer.setClearColor(new Color().setRGB(...setup.background, SRGBColorSpace));
  const camera = new PerspectiveCamera();
  const scene = new Scene();
  const spark = new SparkRenderer({
    renderer,
    onDirty: () => wake(),
    sortRadial: false,
    preBlurAmount: setup.compensate ? 0 : setup.dilation,
    blurAmount: setup.compensate ? setup.dilation : 0,
  });
  const mesh = new SplatMesh({ fileBytes: splats, fileType: "spz" });
  scene.add(spark, mesh);
  const canvas = renderer.domElement;
  place.replaceChildren(canvas);

  const poses = setup.views.map(poseOf);
  const motion = new Motion(
    poses.filter((_, index) => setup.views[index].train),
    setup,
  );
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  let away = false;

  const aim = () => {
    const { target, up, radius, fov, aspect } = motion.pose;
    camera.position.copy(eyeOf(motion.pose));
    camera.up.copy(up);
    camera.lookAt(target);
    // Fill the element with the photograph, but hide no more than a part of it.
    const wider = camera.aspect / aspect;
    const least = setup.shown;
    const share = wider > 1 ? Math.max(1 / wider, least) : Math.max(1, least / wider);
    const height = Math.tan(MathUtils.degToRad(fov / 2)) * share;
    camera.fov = MathUtils.radToDeg(2 * Math.atan(height));
    camera.near = radius / 1000;
    camera.far = radius * 1000;
    camera.updateProjectionMatrix();
  };

  const finest = Math.min(window.devicePixelRatio, MOST_PIXELS_A_POINT);
  let [coarse, pixels] = [finest, finest];
  const usePixels = (wanted) => {
    if (wanted === pixels) return;
    pixels = wanted;
    renderer.setPixelRatio(pixels);
  };
  renderer.setPixelRatio(pixels);

  let [asked, last, visible, tooSlow] = [false, null, true, 0];
  const wake = () => {
    if (asked || !visible) return;
    asked = true;
    requestAnimationFrame(frame);
  };
  const frame = (time) => {
    asked = false;
    const seconds = last === null ? 0 : (time - last) / 1000;
    if (seconds > SLOW_FRAME) coarse = Math.max(coarse * 0.8, FEWEST_PIXELS_A_POINT);
    tooSlow = seconds > TOO_SLOW ? tooSlow + 1 : 0;
    if (motion.sweeping && tooSlow > MOST_TOO_SLOW) change(() => motion.stop(), away);
    const moving = motion.advance(Math.min(seconds, LONGEST_STEP)) || motion.held;
    last = moving ? time : null;
    usePixels(moving ? coarse : finest);
    aim();
    renderer.render(scene, camera);
    if (moving) wake();
  };
  const fit = () => {
    const { clientWidth: width, clientHeight: height } = place;
    if (!width || !height) return;
    renderer.setSize(width, height);
    camera.aspect = width / height;
    wake();
  };
  new ResizeObserver(fit).observe(place);
  new IntersectionObserver(([entry]) => {
    visible = entry.isIntersecting;
    wake();
  }).observe(place);

  const change = (action, isAway) => {
    action();
    away = isAway;
    onChange();
    wake();
  };
  const back = () => change(() => motion.back(still.matches), false);
  listen(canvas, {
    push: (step) => change(() => motion.push(step), true),
    hold: (held) => {
      motion.held = held;
      change(() => motion.sweeping && motion.stop(), away || held);
    },
    home: back,
  });
  fit();
  await mesh.initialized;
  if (!still.matches) motion.sweep();
  wake();
  return {
    look: (index) => change(() => motion.fly(poses[index], still.matches), false),
    back,
    play: () => change(() => motion.sweep(), false),
    pause: () => change(() => motion.stop(), true),
    get sweeping() {
      return motion.sweeping;
    },
    get away() {
      return away;
    },
    eye: () => eyeOf(motion.pose).toArray(),
    target: () => motion.pose.target.toArray(),
  };
}

globalThis.showScene = showScene;
