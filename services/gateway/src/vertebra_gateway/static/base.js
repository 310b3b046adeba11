// A mobile base on the dashboard: a map to watch it and to send it somewhere, and a pad to drive it.

import { resultText, showAction } from "./actions.js";
import { DrivePad, Driver, velocityOf } from "./drive.js";
import { BaseMap, poseOf } from "./map.js";

/** A call that takes a pose as its goal, as `NavigateToPose` does. */
export function takesPose(resource) {
  return resource.input?.properties?.pose?.properties?.pose !== undefined;
}

/** The goal of such a call. @param {import("./map.js").Pose} goal @param {string} frameId */
export function poseGoal({ x, y, heading }, frameId) {
  const position = { x, y, z: 0 };
  const orientation = { x: 0, y: 0, z: Math.sin(heading / 2), w: Math.cos(heading / 2) };
  return { pose: { header: { frame_id: frameId }, pose: { position, orientation } } };
}

/** What the error codes of Nav2 mean (nav2_msgs/action: FollowPath, ComputePathToPose). */
const NAV2_ERRORS = {
  103: "it has lost its place on the map", 105: "it makes no progress", 106: "there is no way to follow",
  203: "it stands outside its map", 204: "the goal is outside its map", 205: "it stands in an obstacle",
  206: "something is where the goal is", 207: "planning takes too long", 208: "there is no way to the goal",
};

/** What people are told of a base that drives to a pose. */
export const NAVIGATION = {
  feedback: progressText,
  result: (result) => result?.error_msg || NAV2_ERRORS[result?.error_code] || resultText(result),
};

/** How far a base has come that drives to a pose. */
export function progressText(feedback) {
  const seconds = ({ sec, nanosec }) => (sec + nanosec / 1e9).toFixed(0);
  const { distance_remaining: left_m, navigation_time: passed, estimated_time_remaining: rest } = feedback ?? {};
  const told = [
    left_m !== undefined && `${left_m.toFixed(2)} m to go`,
    passed && `${seconds(passed)} s so far`,
    rest && `about ${seconds(rest)} s left`,
  ];
  return told.filter(Boolean).join(" \u00b7 ");
}

const DEGREES = 180 / Math.PI;
const signed = (value, digits) => value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "\u2212");

/** The card of one base. */
export class BaseCard {
  #limits = null;
  #text = "";

  /**
   * @param {HTMLElement} element made from the base template
   * @param {any} resource the call `drive`
   * @param {(path: string, body: any) => Promise<any>} call
   * @param {import("./actions.js").Action | null} action what takes it to a pose
   */
  constructor(element, resource, call, action) {
    this.element = element;
    this.path = resource.path;
    this.part = resource.path.split("/").slice(0, -1).join("/");
    this.action = action;
    element.dataset.path = this.part;
    element.querySelector(".title").textContent = this.part[0].toUpperCase() + this.part.slice(1);
    this.error = element.querySelector(".error");
    this.speed = element.querySelector(".speed input");
    this.map = new BaseMap(element.querySelector("canvas"), action ? (goal) => this.#goTo(goal) : undefined);
    this.driver = new Driver((body) =>
      call(this.path, body).then(() => this.#fail(""), (error) => this.#fail(error.message)),
    );
    this.pad = new DrivePad(element.querySelector(".pad"), element, (place) => this.#steer(place));
    this.speed.addEventListener("input", () => this.#showSpeed());
    element.querySelector(".navigation").hidden = !action;
    if (action) this.#follow(action);
    this.setLimits(resource);
  }

  #follow(action) {
    showAction(action, this.element.querySelector(".action-state"), this.element.querySelector(".cancel"));
    action.addEventListener("change", () => {
      if (!action.busy) this.map.goal = null;
      this.map.redraw();
    });
  }

  #goTo(goal) {
    this.map.goal = goal;
    this.action.send(poseGoal(goal, this.map.frameId)).catch(() => {
      // the line of the action says why
    });
  }

  /** Drive by hand; who takes the pad takes over from the action. */
  #steer(place) {
    if (place === null) {
      this.driver.release();
    } else if (this.#limits) {
      this.action?.cancel();
      this.driver.hold(velocityOf(place.x, place.y, this.speed.valueAsNumber / 100, this.#limits));
    }
  }

  #fail(text) {
    if (text === this.#text) return;
    this.#text = this.error.textContent = text;
    this.error.hidden = !text;
  }

  /** Take over how fast it may drive; where it is away, what it told last stays. */
  setLimits({ limits }) {
    if (!limits) return;
    const own = (field) => Object.values(limits[field])[0];
    this.#limits = { linear_m_s: own("linear_m_s"), angular_deg_s: own("angular_deg_s") };
    this.#showSpeed();
  }

  #showSpeed() {
    if (!this.#limits) return;
    const share = this.speed.valueAsNumber / 100;
    const { linear_m_s, angular_deg_s } = this.#limits;
    const text = `${(share * linear_m_s.max).toFixed(2)} m/s, ${(share * angular_deg_s.max).toFixed(0)}\u00b0/s`;
    this.element.querySelector(".speed output").textContent = text;
    this.speed.setAttribute("aria-valuetext", text);
  }

  /** @param {any} sample an Odometry */
  odometry(sample) {
    this.map.odometry(sample);
    const { x, y, heading } = poseOf(sample.message);
    const { linear_m_s, angular_rad_s } = sample.message.twist;
    const values = {
      x: `${signed(x, 2)} m`,
      y: `${signed(y, 2)} m`,
      heading: `${signed(heading * DEGREES, 0)}\u00b0`,
      ahead: `${signed(linear_m_s?.[0] ?? 0, 2)} m/s`,
      turn: `${signed((angular_rad_s?.[2] ?? 0) * DEGREES, 0)}\u00b0/s`,
    };
    for (const [name, text] of Object.entries(values)) {
      this.element.querySelector(`[data-value=${name}]`).textContent = text;
    }
  }

  /** @param {any} sample a LaserScan */
  scan(sample) {
    this.map.scan(sample);
  }

  /** Drive no more; a stop of the base follows. Return what is under way. */
  halt() {
    this.driver.drop();
    this.pad.release();
    return this.driver.underWay;
  }

  /** Leave the page. */
  close() {
    this.pad.close();
  }

  /** Show how fresh the odometry is. */
  refresh({ state, text, rateHz }) {
    this.element.dataset.state = state;
    const facts = this.element.querySelector(".facts");
    const shown = state === "live" ? `${rateHz.toFixed(0)} Hz` : text;
    if (facts.textContent !== shown) facts.textContent = shown;
  }

  /** @param {boolean} possible whether the base can be driven now */
  enable(possible) {
    const able = possible && this.#limits !== null;
    this.pad.enable(able);
    this.map.enable(able);
    this.speed.disabled = !able;
    if (!possible) this.#fail("");
  }
}
