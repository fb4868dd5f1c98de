// Camera poses around the point that a camera looks at, and how far they are from the photographs.
import { MathUtils, Matrix4, Vector3 } from "three";

/**
 * A pose: the camera is at target + radius * out and looks at target.
 *
 * @typedef {{target: Vector3, out: Vector3, up: Vector3, radius: number, fov: number,
 *   aspect: number}} Pose - out and up have length 1; fov is vertical, in degrees; aspect is the
 *   width of the photograph divided by its height.
 */

const PAIR_ANGLE = 60; // degrees between two cameras whose connecting arc counts as photographed
const PAIR_SHIFT = 0.6; // distance of their targets, in units of their distance to it
const STEPS = 8; // parts of such an arc

/** The pose of a view of the page: camera-to-world in OpenGL's axes, row by row. */
export function poseOf({ pose, fov, aspect, reach }) {
  const matrix = new Matrix4().set(...pose);
  const out = new Vector3().setFromMatrixColumn(matrix, 2).normalize();
  const eye = new Vector3().setFromMatrixPosition(matrix);
  return {
    target: eye.addScaledVector(out, -reach),
    out,
    up: new Vector3().setFromMatrixColumn(matrix, 1).normalize(),
    radius: reach,
    fov,
    aspect,
  };
}

export function eyeOf({ target, out, radius }) {
  return target.clone().addScaledVector(out, radius);
}

/** The weighted sum of poses; the weights sum to 1. */
function combined(poses, weights) {
  const vector = (name) =>
    poses.reduce((sum, pose, k) => sum.addScaledVector(pose[name], weights[k]), new Vector3());
  const number = (name) => poses.reduce((sum, pose, k) => sum + weights[k] * pose[name], 0);
  return {
    target: vector("target"),
    out: vector("out").normalize(),
    up: vector("up").normalize(),
    radius: number("radius"),
    fov: number("fov"),
    aspect: number("aspect"),
  };
}

/** The pose between a (share 0) and b (share 1). */
export function mixed(a, b, share) {
  return combined([a, b], [1 - share, share]);
}

/** The pose at a place from 0 to path.length - 1 on a smooth curve (Catmull-Rom) through poses. */
export function onPath(path, place) {
  const start = MathUtils.clamp(Math.floor(place), 0, Math.max(path.length - 2, 0));
  const u = place - start;
  const at = (k) => path[MathUtils.clamp(k, 0, path.length - 1)];
  const weights = [
    u * (-1 + u * (2 - u)),
    2 + u * u * (3 * u - 5),
    u * (1 + u * (4 - 3 * u)),
    u * u * (u - 1),
  ].map((weight) => weight / 2);
  return combined([at(start - 1), at(start), at(start + 1), at(start + 2)], weights);
}

export const degreesBetween = (a, b) => MathUtils.radToDeg(a.angleTo(b));

function areNeighbors(a, b) {
  const shift = a.target.distanceTo(b.target) / Math.min(a.radius, b.radius);
  return degreesBetween(a.out, b.out) < PAIR_ANGLE && shift < PAIR_SHIFT;
}

/** The poses, and poses between all neighbors: what counts as photographed. */
export function photographed(poses) {
  const all = [...poses];
  poses.forEach((a, k) => {
    for (const b of poses.slice(k + 1).filter((b) => areNeighbors(a, b)))
      for (let step = 1; step < STEPS; step++) all.push(mixed(a, b, step / STEPS));
  });
  return all;
}

/** The longest row of neighbors, each the nearest to the one before it. */
export function chain(poses) {
  const distance = (a, b) => eyeOf(a).distanceTo(eyeOf(b));
  const middle = poses.reduce((sum, pose) => sum.add(eyeOf(pose)), new Vector3());
  middle.divideScalar(poses.length);
  const outermost = (a, b) => eyeOf(b).distanceTo(middle) - eyeOf(a).distanceTo(middle);
  const left = [...poses].sort(outermost);
  const rows = [[left.shift()]];
  while (left.length) {
    const last = rows.at(-1).at(-1);
    left.sort((a, b) => distance(a, last) - distance(b, last));
    const next = left.shift();
    if (areNeighbors(last, next)) rows.at(-1).push(next);
    else rows.push([next]);
  }
  return rows.reduce((best, row) => (row.length > best.length ? row : best));
}

/** The nearest of the poses and how far it is: more than 1 is beyond the limits. */
export function nearest(pose, poses, limits) {
  const eye = eyeOf(pose);
  let best = { pose: poses[0], excess: Infinity };
  for (const other of poses) {
    const offset = eye.clone().sub(other.target);
    const zoom = offset.length() / other.radius;
    const excess = Math.max(
      degreesBetween(offset, other.out) / limits.angle,
      Math.log(zoom) / Math.log(zoom < 1 ? limits.nearest : limits.farthest),
      pose.target.distanceTo(other.target) / (limits.shift * other.radius),
    );
    if (excess < best.excess) best = { pose: other, excess };
  }
  return best;
}
