// Where the camera is at each moment: sweeping past the photographs, flying to one, or moved by hand.
import { MathUtils, Vector3 } from "three";
import { chain, degreesBetween, eyeOf, mixed, nearest, onPath, photographed } from "./poses.js";

const SWEEP_SPEED = 6; // degrees a second, on average
const LEAST_SWEEP = 4; // seconds between two photographs, at least
const FLIGHT = 0.9; // seconds
const GIVE = 0.4; // how far beyond the limits a drag can pull the camera, in units of the limits
const PIECE = 0.1; // a drag is made of pieces this small, in units of the limits
const FOLLOWING = 14; // rate at which the camera catches up with a drag, 1 / second
const SPRING = 7; // rate at which it returns inside the limits, 1 / second

export class Motion {
  /**
   * @param {Pose[]} photographs - of the training views.
   * @param {object} setup - up: [x, y, z]; limits: {angle, nearest, farthest, shift}.
   */
  constructor(photographs, setup) {
    this.photographs = photographs;
    this.limits = setup.limits;
    this.inside = photographed(photographs);
    this.path = chain(photographs);
    this.vertical = new Vector3(...setup.up).normalize();
    this.pending = { yaw: 0, pitch: 0, zoom: 0, right: 0, up: 0 };
    this.goal = null; // the pose of a flight or sweep, as a function of seconds since its start
    this.held = false; // by a finger or a mouse button
    this.sweeping = false;
    if (this.path.length === 1) this.path = this.sway(this.path[0]);
    this.pose = this.path[Math.floor(this.path.length / 2)];
    const turns = this.path.slice(1).map((pose, k) => this.apart(this.path[k], pose));
    const angle = turns.reduce((sum, turn) => sum + turn, 0);
    this.period = Math.max(angle / SWEEP_SPEED, LEAST_SWEEP * turns.length);
  }

  /** Degrees between two cameras as the subject sees them. */
  apart(a, b) {
    return degreesBetween(eyeOf(a).sub(b.target), b.out);
  }

  /** A short path through a single photograph. */
  sway(pose) {
    const turned = (share) =>
      this.moved(pose, { yaw: MathUtils.degToRad(share * this.limits.angle) });
    return [turned(-0.6), pose, turned(0.6)];
  }

  sweep() {
    const last = this.path.length - 1;
    // Begin at the place of the path that is nearest to the camera.
    const places = Array.from({ length: 8 * last + 1 }, (_, k) => k / 8);
    const far = (place) => eyeOf(onPath(this.path, place)).distanceTo(eyeOf(this.pose));
    const place = places.reduce((best, one) => (far(one) < far(best) ? one : best));
    const phase = Math.acos(1 - (2 * place) / last);
    this.go((seconds) => {
      const angle = phase + (Math.PI * seconds) / this.period;
      return onPath(this.path, (last * (1 - Math.cos(angle))) / 2);
    });
    this.sweeping = true;
  }

  /** Fly to a pose; jump to it if there should be no motion. */
  fly(pose, still) {
    if (still) {
      this.stop();
      this.pose = pose;
    } else this.go(() => pose);
  }

  go(goal) {
    this.stop();
    this.goal = goal;
    this.from = this.pose;
    this.seconds = 0;
  }

  stop() {
    this.goal = null;
    this.sweeping = false;
    for (const name in this.pending) this.pending[name] = 0;
  }

  back(still) {
    this.fly(nearest(this.pose, this.photographs, this.limits).pose, still);
  }

  /** Move by hand: radians of yaw and pitch, logarithm of the zoom, shift in units of the radius. */
  push(change) {
    if (this.goal) this.stop();
    for (const name in change) this.pending[name] += change[name];
  }

  get excess() {
    return nearest(this.pose, this.inside, this.limits).excess;
  }

  /** Continue for some seconds; return whether anything moves. */
  advance(seconds) {
    if (this.goal) {
      this.seconds += seconds;
      const share = MathUtils.smoothstep(this.seconds, 0, FLIGHT);
      this.pose = mixed(this.from, this.goal(this.seconds), share);
      if (share === 1 && !this.sweeping) this.goal = null;
      return true;
    }
    const before = this.pose;
    const share = 1 - Math.exp(-FOLLOWING * seconds);
    const part = {};
    for (const [name, value] of Object.entries(this.pending)) {
      part[name] = Math.abs(value) < 1e-5 ? value : share * value;
      this.pending[name] -= part[name];
    }
    this.drag(part);
    if (!this.held) this.spring(seconds);
    return this.pose !== before || Object.values(this.pending).some((value) => value);
  }

  /** Move in small pieces, each smaller the farther the camera is beyond the limits. */
  drag(change) {
    const { angle, shift } = this.limits;
    const size = Math.max(
      Math.hypot(change.yaw, change.pitch) / MathUtils.degToRad(angle),
      Math.hypot(change.right, change.up) / shift,
      Math.abs(change.zoom) / Math.log(this.limits.farthest),
    );
    if (!size) return;
    const pieces = Math.ceil(size / PIECE);
    const scaled = (factor) =>
      Object.fromEntries(Object.entries(change).map(([name, value]) => [name, value * factor]));
    for (let k = 0; k < pieces; k++) {
      const excess = this.excess;
      const trial = this.moved(this.pose, scaled(1 / pieces));
      const outward = nearest(trial, this.inside, this.limits).excess > Math.max(excess, 1);
      const ease = Math.max(0, 1 - Math.max(excess - 1, 0) / GIVE);
      this.pose = outward ? this.moved(this.pose, scaled(ease / pieces)) : trial;
    }
  }

  spring(seconds) {
    const { pose, excess } = nearest(this.pose, this.inside, this.limits);
    if (excess <= 1) return;
    // Toward the nearest pose as far as the limit, in exponential steps.
    const share = (1 - Math.exp(-SPRING * seconds)) * (1 - 1 / excess) + 1e-4;
    this.pose = mixed(this.pose, pose, share);
  }

  /** A pose turned about the vertical and its own horizontal axis, zoomed and shifted. */
  moved(pose, { yaw = 0, pitch = 0, zoom = 0, right = 0, up = 0 }) {
    const side = new Vector3().crossVectors(pose.up, pose.out).normalize();
    const turned = (vector) =>
      vector.clone().applyAxisAngle(side, pitch).applyAxisAngle(this.vertical, yaw).normalize();
    return {
      ...pose,
      out: turned(pose.out),
      up: turned(pose.up),
      radius: pose.radius * Math.exp(zoom),
      target: pose.target
        .clone()
        .addScaledVector(side, right * pose.radius)
        .addScaledVector(pose.up, up * pose.radius),
    };
  }
}
