// The map of a base: where it was and is, what its laser sees, and where it shall go.

const MARGIN_M = 0.6;
const LEAST_VIEW_M = 3;
const MAX_TRAIL = 2000;
const TRAIL_STEP_M = 0.03;
const CELL_M = 0.05;
const MAX_CELLS = 20_000;
const MAX_POSES = 64;
const ROBOT_RADIUS_M = 0.25;
const LEAST_ROBOT_PX = 9;
const EASE = 0.1;
const SETTLED_M = 0.01;
const ALL_AROUND_RAD = 6;
const DRAG_PX = 12;
const TAP_MS = 250;

/** @typedef {{x: number, y: number, heading: number}} Pose metres and radians, to the left */

/** The pose in an odometry message. @returns {Pose} */
export function poseOf({ pose }) {
  const [x, y] = pose.position_m;
  const [qx, qy, qz, qw] = pose.orientation_xyzw ?? [0, 0, 0, 1];
  return { x, y, heading: Math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)) };
}

/** Where a scan hit something, seen from `pose`. @param {any} scan @param {Pose} pose */
export function hitsOf(scan, pose) {
  const hits = [];
  const ranges = scan.ranges_m.data;
  for (let beam = 0; beam < ranges.length; beam++) {
    const range = ranges[beam];
    if (!(range >= scan.range_min_m && range <= scan.range_max_m)) continue;
    const bearing = pose.heading + scan.angle_min_rad + beam * scan.angle_increment_rad;
    hits.push([pose.x + range * Math.cos(bearing), pose.y + range * Math.sin(bearing)]);
  }
  return hits;
}

/** What part of the floor the map shows; ahead of where the base started is up. */
export class View {
  x = 0;
  y = 0;
  width = LEAST_VIEW_M;
  height = LEAST_VIEW_M;
  #begun = false;

  /**
   * Come nearer to showing all of `points`, at once the first time; return whether it has arrived.
   *
   * @param {number[][]} points
   */
  approach(points) {
    const xs = points.map(([x]) => x);
    const ys = points.map(([, y]) => y);
    const [low_x, high_x] = [Math.min(...xs) - MARGIN_M, Math.max(...xs) + MARGIN_M];
    const [low_y, high_y] = [Math.min(...ys) - MARGIN_M, Math.max(...ys) + MARGIN_M];
    const wanted = {
      x: (low_x + high_x) / 2,
      y: (low_y + high_y) / 2,
      height: Math.max(high_x - low_x, LEAST_VIEW_M),
      width: Math.max(high_y - low_y, LEAST_VIEW_M),
    };
    const ease = this.#begun ? EASE : 1;
    for (const [name, value] of Object.entries(wanted)) this[name] += ease * (value - this[name]);
    this.#begun = true;
    return Object.entries(wanted).every(([name, value]) => Math.abs(value - this[name]) < SETTLED_M);
  }

  /** Fit into a picture. @param {number} width @param {number} height in pixels */
  fit(width, height) {
    this.scale = Math.min(width / this.width, height / this.height);
    this.centre = [width / 2, height / 2];
  }

  /** @returns {[number, number]} */
  toScreen(x, y) {
    return [this.centre[0] - (y - this.y) * this.scale, this.centre[1] - (x - this.x) * this.scale];
  }

  /** @returns {[number, number]} */
  toFloor(left, top) {
    return [this.x - (top - this.centre[1]) / this.scale, this.y - (left - this.centre[0]) / this.scale];
  }
}

/** Draws on a canvas, and takes goals from it: a tap, or a drag that gives the heading. */
export class BaseMap {
  view = new View();
  /** @type {Pose | null} */ pose = null;
  /** @type {Pose | null} */ goal = null;
  frameId = "odom";
  #trail = [];
  #hits = [];
  #around = false;
  #cells = new Map();
  #poses = [];
  /** @type {{id: number, start: number[], goal: Pose} | null} */ #aim = null;
  #touchedAt = 0;
  #due = false;
  #enabled = false;

  /** @param {HTMLCanvasElement} canvas @param {(goal: Pose) => void} [onGoal] */
  constructor(canvas, onGoal) {
    this.canvas = canvas;
    this.onGoal = onGoal;
    new ResizeObserver(() => this.redraw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    if (onGoal) this.#takeGoals();
  }

  /** @param {any} sample an Odometry */
  odometry({ message, captured_ns }) {
    const pose = poseOf(message);
    this.frameId = message.pose.frame_id || this.frameId;
    const jumped = this.pose && Math.hypot(pose.x - this.pose.x, pose.y - this.pose.y) > 1;
    if (jumped) this.#forget();
    this.pose = pose;
    this.#poses.push({ captured_ns, pose });
    if (this.#poses.length > MAX_POSES) this.#poses.shift();
    const last = this.#trail.at(-1);
    if (!last || Math.hypot(pose.x - last[0], pose.y - last[1]) > TRAIL_STEP_M) {
      this.#trail.push([pose.x, pose.y]);
      if (this.#trail.length > MAX_TRAIL) this.#trail.shift();
    }
    this.redraw();
  }

  /** @param {any} sample a LaserScan, drawn from where the base was when it was made */
  scan({ message, captured_ns }) {
    const age = ({ captured_ns: then }) => (then > captured_ns ? then - captured_ns : captured_ns - then);
    const nearest = this.#poses.reduce((best, one) => (best && age(best) <= age(one) ? best : one), null);
    if (!nearest) return;
    this.#hits = hitsOf(message, nearest.pose);
    this.#around = message.ranges_m.data.length * Math.abs(message.angle_increment_rad) > ALL_AROUND_RAD;
    for (const [x, y] of this.#hits) {
      const cell = `${Math.round(x / CELL_M)},${Math.round(y / CELL_M)}`;
      this.#cells.delete(cell);
      this.#cells.set(cell, [x, y]);
    }
    while (this.#cells.size > MAX_CELLS) this.#cells.delete(this.#cells.keys().next().value);
    this.redraw();
  }

  /** A base that was put elsewhere, or whose odometry began anew, is on another map. */
  #forget() {
    this.#trail = [];
    this.#hits = [];
    this.#poses = [];
    this.#cells.clear();
  }

  /** @param {boolean} possible whether goals can be taken now */
  enable(possible) {
    this.#enabled = possible;
    this.canvas.toggleAttribute("data-aim", Boolean(this.onGoal) && possible);
    if (!possible) this.#aim = null;
  }

  /* ---- goals */

  #takeGoals() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => this.#begin(event));
    canvas.addEventListener("pointermove", (event) => this.#turn(event));
    canvas.addEventListener("pointerup", (event) => this.#finish(event));
    canvas.addEventListener("pointercancel", () => this.#drop());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    // A finger that moves at once scrolls the page; one that rested before gives the heading.
    canvas.addEventListener(
      "touchmove",
      (event) => {
        if (this.#aim && event.cancelable && performance.now() - this.#touchedAt > TAP_MS) event.preventDefault();
      },
      { passive: false },
    );
  }

  #at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.x, event.clientY - box.y];
  }

  #begin(event) {
    if (!this.#enabled || !this.pose || this.#aim || event.button !== 0) return;
    const start = this.#at(event);
    const [x, y] = this.view.toFloor(...start);
    const heading = Math.atan2(y - this.pose.y, x - this.pose.x);
    this.#touchedAt = performance.now();
    this.#aim = { id: event.pointerId, start, goal: { x, y, heading } };
    this.canvas.setPointerCapture(event.pointerId);
    this.redraw();
  }

  #turn(event) {
    if (event.pointerId !== this.#aim?.id) return;
    const [left, top] = this.#at(event);
    const [right, down] = [left - this.#aim.start[0], top - this.#aim.start[1]];
    if (Math.hypot(right, down) >= DRAG_PX) this.#aim.goal.heading = Math.atan2(-right, -down);
    this.redraw();
  }

  #finish(event) {
    if (event.pointerId !== this.#aim?.id) return;
    const { goal } = this.#aim;
    this.#drop();
    this.onGoal(goal);
  }

  #drop() {
    this.#aim = null;
    this.redraw();
  }

  /* ---- drawing */

  /** Draw soon: once per picture of the screen, however much has come. */
  redraw() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#draw();
    });
  }

  #draw() {
    const { canvas, view } = this;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    const ratio = window.devicePixelRatio || 1;
    const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
    // While somebody aims the floor must not slide away below the pointer.
    if (!this.#aim && !view.approach(this.#interesting())) this.redraw();
    view.fit(width, height);
    const style = getComputedStyle(canvas);
    const color = (name) => style.getPropertyValue(`--${name}`).trim();
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const pen = new Pen(context, view);
    this.#drawGrid(pen, width, height, color("line"));
    if (this.pose) this.#drawScan(pen, color);
    pen.line(this.#trail, color("accent"), 2, 0.55);
    if (this.goal) this.#drawGoal(pen, this.goal, color("good"));
    if (this.#aim) this.#drawGoal(pen, this.#aim.goal, color("accent"));
    if (this.pose) this.#drawRobot(pen, color);
    this.#drawScale(context, width, height, color("dim"));
    if (this.pose) Object.assign(canvas.dataset, { x: this.pose.x.toFixed(3), y: this.pose.y.toFixed(3) });
    canvas.dataset.hits = String(this.#hits.length);
  }

  #interesting() {
    const { x, y } = this.pose ?? { x: 0, y: 0 };
    const points = [[x, y], ...this.#hits, ...this.#trail];
    if (this.goal) points.push([this.goal.x, this.goal.y]);
    return points;
  }

  #drawGrid(pen, width, height, color) {
    const [high_x, high_y] = this.view.toFloor(0, 0);
    const [low_x, low_y] = this.view.toFloor(width, height);
    for (let x = Math.ceil(low_x); x <= high_x; x++) pen.line([[x, low_y], [x, high_y]], color, 1);
    for (let y = Math.ceil(low_y); y <= high_y; y++) pen.line([[low_x, y], [high_x, y]], color, 1);
  }

  #drawScan(pen, color) {
    const { x, y } = this.pose;
    if (this.#hits.length > 2) pen.area(this.#around ? this.#hits : [[x, y], ...this.#hits], color("accent"), 0.07);
    pen.dots([...this.#cells.values()], color("dim"), 2, 0.45);
    pen.dots(this.#hits, color("measured"), 3, 1);
  }

  #drawGoal(pen, { x, y, heading }, color) {
    if (this.pose) pen.line([[this.pose.x, this.pose.y], [x, y]], color, 1.5, 0.8, [5, 5]);
    pen.arrow(x, y, heading, 26, color);
    pen.ring(x, y, 7, color);
  }

  #drawRobot(pen, color) {
    const { x, y, heading } = this.pose;
    const radius = Math.max(ROBOT_RADIUS_M * this.view.scale, LEAST_ROBOT_PX);
    pen.disc(x, y, radius, color("accent"));
    pen.wedge(x, y, heading, 0.62 * radius, color("card"));
  }

  #drawScale(context, width, height, color) {
    const length = this.view.scale;
    context.strokeStyle = context.fillStyle = color;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(width - 12 - length, height - 12);
    context.lineTo(width - 12, height - 12);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "right";
    context.fillText("1 m", width - 12, height - 17);
  }
}

/** Draws in metres what a canvas draws in pixels. */
class Pen {
  constructor(context, view) {
    this.context = context;
    this.view = view;
  }

  #path(points) {
    this.context.beginPath();
    for (const [x, y] of points) this.context.lineTo(...this.view.toScreen(x, y));
  }

  #with(settings, draw) {
    this.context.save();
    Object.assign(this.context, settings);
    draw(this.context);
    this.context.restore();
  }

  line(points, color, width, alpha = 1, dash = []) {
    this.#with({ strokeStyle: color, lineWidth: width, globalAlpha: alpha, lineJoin: "round" }, (context) => {
      context.setLineDash(dash);
      this.#path(points);
      context.stroke();
    });
  }

  area(points, color, alpha) {
    this.#with({ fillStyle: color, globalAlpha: alpha }, (context) => {
      this.#path(points);
      context.fill();
    });
  }

  dots(points, color, size, alpha) {
    this.#with({ fillStyle: color, globalAlpha: alpha }, (context) => {
      for (const [x, y] of points) {
        const [left, top] = this.view.toScreen(x, y);
        context.fillRect(left - size / 2, top - size / 2, size, size);
      }
    });
  }

  #round(x, y, radius) {
    this.context.beginPath();
    this.context.arc(...this.view.toScreen(x, y), radius, 0, 2 * Math.PI);
  }

  disc(x, y, radius, color) {
    this.#with({ fillStyle: color }, (context) => {
      this.#round(x, y, radius);
      context.fill();
    });
  }

  ring(x, y, radius, color) {
    this.#with({ strokeStyle: color, lineWidth: 3 }, (context) => {
      this.#round(x, y, radius);
      context.stroke();
    });
  }

  /** Turn the paper so that ahead is up, and draw around (0, 0). */
  #turned(x, y, heading, draw) {
    this.#with({}, (context) => {
      context.translate(...this.view.toScreen(x, y));
      context.rotate(-heading);
      draw(context);
    });
  }

  wedge(x, y, heading, size, color) {
    this.#turned(x, y, heading, (context) => {
      context.fillStyle = color;
      context.beginPath();
      context.moveTo(0, -size);
      context.lineTo(0.75 * size, 0.75 * size);
      context.lineTo(0, 0.35 * size);
      context.lineTo(-0.75 * size, 0.75 * size);
      context.fill();
    });
  }

  arrow(x, y, heading, length, color) {
    this.#turned(x, y, heading, (context) => {
      Object.assign(context, { strokeStyle: color, lineWidth: 3, lineCap: "round", lineJoin: "round" });
      context.beginPath();
      context.moveTo(0, -8);
      context.lineTo(0, -length);
      context.moveTo(-6, 7 - length);
      context.lineTo(0, -length);
      context.lineTo(6, 7 - length);
      context.stroke();
    });
  }
}
