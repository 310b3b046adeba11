// Joints on the dashboard: a slider for each that a call can move within limits.

const GIVEN_UP_MS = 10_000;
let made = 0;

/**
 * Sends values one after the other and never queues: while one is under way, newer ones replace
 * each other, joint by joint.
 */
export class NewestCall {
  #waiting = null;
  /** What is under way; null if nothing is. @type {Promise<void> | null} */
  underWay = null;

  /** @param {(values: Object<string, number>) => Promise<void>} send must not reject */
  constructor(send) {
    this.send = send;
  }

  /** @param {Object<string, number>} values */
  push(values) {
    this.#waiting = { ...this.#waiting, ...values };
    if (!this.underWay) this.#sendWaiting();
  }

  /** Forget what was not sent yet. */
  cancel() {
    this.#waiting = null;
  }

  #sendWaiting() {
    const values = this.#waiting;
    this.#waiting = null;
    this.underWay = this.send(values).then(() => {
      this.underWay = null;
      if (this.#waiting) this.#sendWaiting();
    });
  }
}

/** A step that people like, about a hundredth of the range. */
export function niceStep(range) {
  const power = 10 ** Math.floor(Math.log10(range / 100));
  const digit = range / 100 / power;
  return power * (digit < 2 ? 1 : digit < 5 ? 2 : 5);
}

/** A number with its unit, as people write it. */
export function withUnit(value, unit) {
  const text = (Math.abs(value) < 0.05 ? 0 : value).toFixed(1).replace("-", "\u2212");
  return unit === "deg" ? `${text}°` : `${text} ${unit}`;
}

/** The fields of a call's input that move joints between two limits. */
export function movableFields(resource) {
  return Object.entries(resource.limits ?? {}).filter(
    ([field, joints]) =>
      resource.input?.properties?.[field]?.type === "object" &&
      Object.values(joints).every(({ min, max }) => min < max),
  );
}

class Joint {
  /** Where it was asked to go; null when nobody here asked. @type {number | null} */
  target = null;
  measured = NaN;
  #askedAt = 0;
  #arrived = false;

  /**
   * @param {HTMLElement} element made from the joint template
   * @param {string} name
   * @param {{min: number, max: number, unit: string}} limit
   * @param {(value: number) => void} onMove
   */
  constructor(element, name, limit, onMove) {
    this.element = element;
    this.limit = limit;
    this.input = element.querySelector("input");
    this.tick = element.querySelector(".tick");
    const step = niceStep(limit.max - limit.min);
    Object.assign(this.input, { min: limit.min, max: limit.max, step, id: `joint-${++made}` });
    this.input.dataset.joint = name;
    this.tolerance = Math.max(2 * step, (limit.max - limit.min) / 100);
    const label = element.querySelector("label");
    label.textContent = name;
    label.htmlFor = this.input.id;
    element.querySelector(".min").textContent = withUnit(limit.min, limit.unit);
    element.querySelector(".max").textContent = withUnit(limit.max, limit.unit);
    this.input.addEventListener("input", () => {
      this.target = this.input.valueAsNumber;
      this.#askedAt = performance.now();
      this.#arrived = false;
      this.#render();
      onMove(this.target);
    });
    this.#render();
  }

  /** @param {number} value where the robot says it is */
  measure(value) {
    this.measured = value;
    if (this.target !== null) {
      const there = Math.abs(value - this.target) <= this.tolerance;
      const late = performance.now() - this.#askedAt > GIVEN_UP_MS;
      if (!there && (this.#arrived || late)) this.target = null; // others move it too
      this.#arrived ||= there;
    }
    this.#render();
  }

  /** Follow the robot again: the target is no more. */
  release() {
    this.target = null;
    this.#render();
  }

  /** @param {string} text why it was refused; empty if it was not */
  fail(text) {
    const error = this.element.querySelector(".error");
    error.textContent = text;
    error.hidden = !text;
    this.input.setAttribute("aria-invalid", String(Boolean(text)));
  }

  #render() {
    const { min, max, unit } = this.limit;
    const known = !Number.isNaN(this.measured);
    const shown = this.target ?? (known ? this.measured : (min + max) / 2);
    if (this.target === null) this.input.value = String(shown);
    this.element.querySelector(".target").textContent =
      this.target === null ? "" : `to ${withUnit(this.target, unit)}`;
    this.element.querySelector(".measured").textContent =
      known ? `at ${withUnit(this.measured, unit)}` : "";
    this.input.setAttribute("aria-valuetext", withUnit(shown, unit));
    this.tick.hidden = !known;
    const at = Math.min(Math.max((this.measured - min) / (max - min), 0), 1);
    if (known) this.tick.style.setProperty("--at", at.toFixed(4));
  }
}

/** The card of one call that moves joints. */
export class JointsCard {
  /** @type {Map<string, Joint>} */ joints = new Map();
  /** @type {NewestCall[]} */ #calls = [];
  #limits = "";

  /**
   * @param {HTMLElement} element made from the joints template
   * @param {HTMLTemplateElement} template of one joint
   * @param {string} path of the call
   * @param {(body: Object<string, any>) => Promise<any>} call
   */
  constructor(element, template, path, call) {
    this.element = element;
    this.template = template;
    this.call = call;
    const part = path.split("/").slice(0, -1).join(" ") || path;
    element.querySelector(".title").textContent = part[0].toUpperCase() + part.slice(1);
  }

  /** Make a slider for each joint; nothing happens if the limits are those already known. */
  setLimits(resource) {
    const limits = JSON.stringify([resource.limits, resource.input]);
    if (limits === this.#limits) return;
    this.#limits = limits;
    this.#calls.forEach((call) => call.cancel());
    this.#calls = [];
    this.joints.clear();
    const rows = movableFields(resource).flatMap(([field, joints]) => {
      const call = new NewestCall((values) => this.#send(resource, field, values));
      this.#calls.push(call);
      return Object.entries(joints).map(([name, limit]) => {
        const row = this.template.content.firstElementChild.cloneNode(true);
        const joint = new Joint(row, name, limit, (value) => call.push({ [name]: value }));
        this.joints.set(name, joint);
        return row;
      });
    });
    this.element.querySelector("ul").replaceChildren(...rows);
  }

  async #send(resource, field, values) {
    const body = { [field]: values };
    // While somebody drags, the answer shall come when the robot has the target, not when it is there.
    if (resource.input.properties.wait) body.wait = false;
    const asked = Object.keys(values).map((name) => this.joints.get(name));
    try {
      await this.call(body);
      asked.forEach((joint) => joint?.fail(""));
    } catch (error) {
      const culprit = this.joints.get(error.problem?.joint);
      for (const joint of culprit ? [culprit] : asked) joint?.fail(error.message);
      asked.forEach((joint) => joint?.release());
    }
  }

  /** @param {string[]} names @param {number[]} positions @returns {boolean} whether any is here */
  measure(names, positions) {
    names.forEach((name, index) => this.joints.get(name)?.measure(positions[index]));
    return names.some((name) => this.joints.has(name));
  }

  /** Send no more moves; return what is under way. */
  halt() {
    for (const call of this.#calls) call.cancel();
    for (const joint of this.joints.values()) joint.release();
    return Promise.all(this.#calls.map((call) => call.underWay));
  }

  /** Show how fresh the measured positions are. */
  refresh({ state, text, rateHz }) {
    this.element.dataset.state = state;
    this.element.querySelector(".facts").textContent = state === "live" ? `${rateHz.toFixed(0)} Hz` : text;
  }

  /** @param {boolean} possible whether the robot can be moved now */
  enable(possible) {
    this.element.querySelector("fieldset").disabled = !possible;
  }
}
