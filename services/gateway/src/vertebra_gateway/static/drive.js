// Driving a base by hand: a pad for mouse, finger and keys, and what it sends while it is held.

const PERIOD_MS = 200;
const HOLDS_S = 0.5;
const DEAD_ZONE = 0.08;
/** Where each key pushes the knob: to the right, and down, as a screen has it. */
const KEYS = {
  ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0],
  KeyW: [0, -1], KeyS: [0, 1], KeyA: [-1, 0], KeyD: [1, 0],
};

/**
 * Drives for as long as somebody wants it: sends a velocity again and again, each good for half a
 * second, and never queues. What it cannot take back ends by itself.
 */
export class Driver {
  #velocity = null;
  #timer = null;
  /** What is under way; null if nothing is. @type {Promise<void> | null} */ underWay = null;

  /** @param {(body: Object<string, number>) => Promise<void>} drive must not reject */
  constructor(drive) {
    this.drive = drive;
  }

  /** Drive so from now on. @param {{linear_m_s: number, angular_deg_s: number}} velocity */
  hold(velocity) {
    this.#velocity = velocity;
    if (this.#timer !== null) return;
    this.#timer = setInterval(() => this.#send(), PERIOD_MS);
    this.#send();
  }

  /** Stand still, and again after a drive that was under way: it may have arrived later. */
  release() {
    if (this.#timer === null) return;
    this.drop();
    const still = { linear_m_s: 0, angular_deg_s: 0 };
    this.drive(still);
    this.underWay?.then(() => this.#timer === null && this.drive(still));
  }

  /** Send nothing more: something else stops the base. */
  drop() {
    clearInterval(this.#timer);
    this.#timer = null;
  }

  #send() {
    if (this.underWay) return;
    this.underWay = this.drive({ ...this.#velocity, for_s: HOLDS_S }).then(() => {
      this.underWay = null;
    });
  }
}

/**
 * The velocity for a place of the knob: ahead is up, and to the left is a turn to the left.
 *
 * @param {number} x from -1 to 1, to the right
 * @param {number} y from -1 to 1, down
 * @param {number} share of the greatest speed
 * @param {Object<string, {min: number, max: number}>} limits of `linear_m_s` and `angular_deg_s`
 */
export function velocityOf(x, y, share, limits) {
  const part = (value, { min, max }) => {
    const beyond = Math.max(0, Math.abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE);
    return Number((beyond * share * (value > 0 ? max : min)).toFixed(3)) + 0; // no -0
  };
  return { linear_m_s: part(-y, limits.linear_m_s), angular_deg_s: part(-x, limits.angular_deg_s) };
}

/** A round pad with a knob; it holds until it is let go, loses the focus, or nobody sees the page. */
export class DrivePad {
  #pointer = null;
  /** @type {Set<string>} */ #keys = new Set();
  #enabled = false;
  #closing = new AbortController();

  /**
   * @param {HTMLElement} element
   * @param {HTMLElement} panel keys drive while the focus is in it
   * @param {(place: {x: number, y: number} | null) => void} onMove where the knob is; null at release
   */
  constructor(element, panel, onMove) {
    this.element = element;
    this.onMove = onMove;
    element.setAttribute("aria-disabled", "true");
    element.addEventListener("pointerdown", (event) => this.#press(event));
    element.addEventListener("pointermove", (event) => this.#drag(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(end, (event) => event.pointerId === this.#pointer && this.release());
    }
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    panel.addEventListener("keydown", (event) => this.#keyDown(event));
    panel.addEventListener("keyup", (event) => this.#keyUp(event));
    panel.addEventListener("focusout", ({ relatedTarget }) => panel.contains(relatedTarget) || this.release());
    const { signal } = this.#closing;
    window.addEventListener("blur", () => this.release(), { signal });
    document.addEventListener("visibilitychange", () => document.hidden && this.release(), { signal });
  }

  /** Let go for good. */
  close() {
    this.enable(false);
    this.#closing.abort();
  }

  /** Let go. */
  release() {
    const held = this.#pointer !== null || this.#keys.size > 0;
    if (this.#pointer !== null && this.element.hasPointerCapture(this.#pointer)) {
      this.element.releasePointerCapture(this.#pointer);
    }
    this.#pointer = null;
    this.#keys.clear();
    this.#show(0, 0, false);
    if (held) this.onMove(null);
  }

  /** @param {boolean} possible whether the base can be driven now */
  enable(possible) {
    if (possible === this.#enabled) return;
    this.#enabled = possible;
    this.element.setAttribute("aria-disabled", String(!possible));
    if (!possible) this.release();
  }

  #press(event) {
    if (!this.#enabled || this.#pointer !== null || event.button !== 0) return;
    event.preventDefault();
    this.element.focus({ preventScroll: true });
    this.#pointer = event.pointerId;
    this.element.setPointerCapture(event.pointerId);
    this.#drag(event);
  }

  #drag(event) {
    if (event.pointerId !== this.#pointer) return;
    const box = this.element.getBoundingClientRect();
    const reach = 0.36 * box.width;
    this.#move((event.clientX - box.x - box.width / 2) / reach, (event.clientY - box.y - box.height / 2) / reach);
  }

  #keyDown(event) {
    if (!(event.code in KEYS) || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.target.matches("input, select, textarea") || !this.#enabled) return;
    event.preventDefault(); // the page must not scroll
    if (event.repeat) return;
    this.#keys.add(event.code);
    this.#moveByKeys();
  }

  #keyUp(event) {
    if (!this.#keys.delete(event.code)) return;
    if (this.#keys.size === 0) {
      this.#show(0, 0, false);
      this.onMove(null);
    } else {
      this.#moveByKeys();
    }
  }

  #moveByKeys() {
    const pushes = [...this.#keys].map((code) => KEYS[code]);
    this.#move(...[0, 1].map((axis) => Math.sign(pushes.reduce((sum, push) => sum + push[axis], 0))));
  }

  #move(x, y) {
    const length = Math.max(1, Math.hypot(x, y));
    this.#show(x / length, y / length, true);
    this.onMove({ x: x / length, y: y / length });
  }

  #show(x, y, held) {
    this.element.toggleAttribute("data-held", held);
    this.element.style.setProperty("--x", x.toFixed(3));
    this.element.style.setProperty("--y", y.toFixed(3));
  }
}
