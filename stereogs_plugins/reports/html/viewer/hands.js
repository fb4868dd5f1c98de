// Mouse, wheel, fingers and keys on the canvas.

const TURN = 0.003; // radians a pixel
const KEY = 0.06; // radians, or logarithm of the zoom
const WHEEL = 0.0012; // logarithm of the zoom a pixel

/**
 * @param {HTMLCanvasElement} canvas
 * @param {(change: object) => void} push - called with changes for Motion.push.
 * @param {(held: boolean) => void} hold - called when the first finger is down and the last one up.
 * @param {() => void} home - called for the key Home.
 */
export function listen(canvas, { push, hold, home }) {
  const fingers = new Map();
  canvas.tabIndex = 0;
  const span = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, wide: Math.hypot(a.x - b.x, a.y - b.y) || 1 };
  };
  const shift = (dx, dy) => ({ right: -dx / canvas.clientHeight, up: dy / canvas.clientHeight });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    hold(true);
  });
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger || fingers.size > 2) return;
    const before = fingers.size === 2 && span();
    const [dx, dy] = [event.clientX - finger.x, event.clientY - finger.y];
    [finger.x, finger.y] = [event.clientX, event.clientY];
    if (before) {
      const now = span();
      push({ zoom: Math.log(before.wide / now.wide), ...shift(now.x - before.x, now.y - before.y) });
    } else if (event.shiftKey || event.buttons & 2) push(shift(dx, dy));
    else push({ yaw: -TURN * dx, pitch: -TURN * dy });
  });
  const lift = (event) => {
    fingers.delete(event.pointerId);
    if (!fingers.size) hold(false);
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  const pageScrolls = () =>
    !document.fullscreenElement && document.documentElement.scrollHeight > window.innerHeight;
  // The wheel scrolls the page, if it can, until the view has been clicked.
  const wheel = (event) => {
    if (pageScrolls() && document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    push({ zoom: WHEEL * event.deltaY * (event.deltaMode ? 16 : 1) });
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
  const keys = {
    ArrowLeft: { yaw: -KEY },
    ArrowRight: { yaw: KEY },
    ArrowUp: { pitch: -KEY },
    ArrowDown: { pitch: KEY },
    "+": { zoom: -KEY },
    "-": { zoom: KEY },
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.key !== "Home" && !keys[event.key]) return;
    event.preventDefault();
    if (event.key === "Home") home();
    else push(keys[event.key]);
  });
}
