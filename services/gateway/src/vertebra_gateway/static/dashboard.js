// The dashboard: everything on it is made from what the gateway tells about its robots.

import { Action, ActionCard } from "./actions.js";
import { BaseCard, NAVIGATION, takesPose } from "./base.js";
import { CameraCard } from "./camera.js";
import { FormCard } from "./forms.js";
import { JointsCard, movableFields } from "./joints.js";
import { Vertebra } from "./vertebra.js";

const RENDER_PERIOD_MS = 250;
const FLEET_PERIOD_MS = 2000;
const STALE_AFTER_MS = 1000;
const STALE_AFTER_PERIODS = 5;
const RATE_OVER = 50;
const SILENT_AFTER_S = 5;
const CALL_TIMEOUT_S = 10;
const FORM_TIMEOUT_S = 30;
const DRIVE_TIMEOUT_S = 2;
const MAX_PROBLEMS = 4;

const client = new Vertebra();
const $ = (selector) => document.querySelector(selector);
const make = (id) => $(`#${id}`).content.firstElementChild.cloneNode(true);

/* ---- what is wrong */

/** Errors that belong to no control: the newest few, each once, with how often it came. */
class Problems {
  #counts = new Map();
  #box = $("#problems");

  constructor() {
    this.#box.querySelector("button").addEventListener("click", () => {
      this.#counts.clear();
      this.#render();
    });
  }

  add(text) {
    const count = (this.#counts.get(text) ?? 0) + 1;
    this.#counts.delete(text);
    this.#counts.set(text, count);
    while (this.#counts.size > MAX_PROBLEMS) this.#counts.delete(this.#counts.keys().next().value);
    this.#render();
  }

  #render() {
    const lines = [...this.#counts].reverse().map(([text, count]) => {
      const line = document.createElement("li");
      line.textContent = count > 1 ? `${text} (${count} times)` : text;
      return line;
    });
    this.#box.querySelector("ul").replaceChildren(...lines);
    this.#box.hidden = lines.length === 0;
  }
}

/* ---- streams */

/** One thing that a robot publishes, as this page receives it. */
class Stream {
  schema = "";
  #ageOnArrivalMs = NaN;
  #arrivedAt = -Infinity;
  #periodMs = 0;
  #gaps = 0;
  #greeted = false;

  /** @param {any} resource @param {(sample: any) => void} onSample */
  constructor(resource, onSample) {
    this.resource = resource;
    const picture = resource.content_type.startsWith("image/");
    this.subscription = client.subscribe(resource.key, picture ? { window: 1 } : {}, (sample) => {
      // The gateway greets with the newest it has, however old: that is no sign of life.
      const relic = !this.#greeted && sample.age_ms > STALE_AFTER_MS;
      this.#greeted = true;
      if (!relic) this.#arrived(performance.now());
      this.#ageOnArrivalMs = sample.age_ms;
      this.schema = sample.schema || sample.encoding;
      onSample(sample);
    });
    this.row = new StreamRow(resource.key);
  }

  #arrived(now) {
    const gapMs = now - this.#arrivedAt;
    // A pause is not a period: after it the rate is measured anew.
    if (gapMs > this.#patienceMs()) {
      this.#gaps = this.#periodMs = 0;
    } else {
      this.#gaps = Math.min(this.#gaps + 1, RATE_OVER);
      this.#periodMs += (gapMs - this.#periodMs) / this.#gaps;
    }
    this.#arrivedAt = now;
  }

  #patienceMs() {
    return Math.max(STALE_AFTER_MS, STALE_AFTER_PERIODS * this.#periodMs);
  }

  /** Say how fresh it is: `state`, a `text` for people, `rateHz` and `ageMs`. */
  describe() {
    if (client.state !== "open") this.#greeted = false;
    const silentMs = performance.now() - this.#arrivedAt;
    const empty = this.subscription.received === 0;
    if (empty) return { state: "empty", text: "Nothing received yet", rateHz: 0, ageMs: NaN };
    if (silentMs > this.#patienceMs() || client.state !== "open") {
      const oldMs = silentMs < Infinity ? silentMs : this.subscription.ageMs;
      const text = `Stale: nothing new for ${(oldMs / 1000).toFixed(1)} s`;
      return { state: "stale", text, rateHz: 0, ageMs: this.subscription.ageMs };
    }
    const rateHz = this.#periodMs ? 1000 / this.#periodMs : 0;
    return { state: "live", text: "", rateHz, ageMs: this.#ageOnArrivalMs };
  }

  close() {
    this.subscription.close();
    this.row.element.remove();
  }
}

class StreamRow {
  constructor(key) {
    this.element = $("#streams tbody").insertRow();
    const head = document.createElement("th");
    head.scope = "row";
    // A long key may be broken after a slash.
    head.append(...key.split(/(?<=\/)/).flatMap((chunk) => [chunk, document.createElement("wbr")]));
    this.element.append(head);
    for (const kind of ["type optional", "number rate", "number age", "number loss", "number loss"]) {
      this.element.insertCell().className = kind;
    }
  }

  refresh(stream, { state, rateHz, ageMs }) {
    this.element.dataset.state = state;
    const known = state !== "empty";
    const { dropped, lost } = stream.subscription;
    const texts = [
      stream.schema.replace(/^vertebra\//, ""),
      known ? rateHz.toFixed(1) : "",
      known && !Number.isNaN(ageMs) ? ageMs.toFixed(0) : "",
      dropped,
      lost,
    ];
    texts.forEach((text, index) => setText(this.element.cells[index + 1], String(text)));
    [dropped, lost].forEach((count, index) => {
      this.element.cells[index + 4].toggleAttribute("data-some", count > 0);
    });
  }
}

/* ---- robots */

/** Values of a message that has no card of its own. */
class ReadingsCard {
  #message = null;

  constructor(element, resource) {
    this.element = element;
    element.querySelector(".title").textContent = resource.path;
  }

  take(sample) {
    this.#message = sample.message;
  }

  refresh({ state, text, rateHz }) {
    this.element.dataset.state = state;
    setText(this.element.querySelector(".facts"), state === "live" ? `${rateHz.toFixed(0)} Hz` : text);
    const list = this.element.querySelector("dl");
    const entries = Object.entries(this.#message ?? {}).filter(([, value]) => value !== null && value.length !== 0);
    while (list.children.length < 2 * entries.length) {
      list.append(document.createElement("dt"), document.createElement("dd"));
    }
    while (list.children.length > 2 * entries.length) list.lastElementChild.remove();
    entries.forEach(([name, value], index) => {
      const [words, unit] = wordsAndUnit(name);
      setText(list.children[2 * index], words);
      setText(list.children[2 * index + 1], `${readable(value)} ${unit}`);
    });
  }
}

class Robot {
  /** @type {Stream[]} */ #streams = [];
  /** @type {Map<string, any>} */ #cards = new Map();
  /** @type {JointsCard[]} */ #joints = [];
  /** @type {FormCard[]} */ #forms = [];
  /** @type {BaseCard[]} */ #bases = [];
  /** By the path of the action. @type {Map<string, Action>} */ #actions = new Map();
  /** Why calls failed that are buttons, by their path. @type {Map<string, string>} */ #failures = new Map();

  /** @param {any} description as the gateway gives it */
  constructor(description) {
    this.name = description.name;
    this.element = make("robot-template");
    this.element.dataset.robot = this.name;
    setText(this.element.querySelector("h2"), this.name);
    setText(this.element.querySelector(".description"), description.description);
    this.pictures = this.#column();
    this.controls = this.#column();
    this.resources = description.resources;
    for (const resource of description.resources) this.#findAction(resource);
    for (const resource of description.resources) this.#add(resource);
    this.update(description);
  }

  #column() {
    const column = document.createElement("div");
    column.className = "column";
    this.element.querySelector(".cards").append(column);
    return column;
  }

  /** An action is where a goal has a result and can be cancelled. */
  #findAction(resource) {
    const { path } = resource;
    const action = path.replace(/\/goal$/, "");
    const has = (leaf) => this.resources.some((other) => other.path === `${action}/${leaf}`);
    if (action === path || !has("result") || !has("cancel")) return;
    const call = (leaf, body, timeoutS = CALL_TIMEOUT_S) =>
      client.call(this.name, `${action}/${leaf}`, body, { timeoutS });
    this.#actions.set(action, new Action(call, takesPose(resource) ? NAVIGATION : undefined));
  }

  #add(resource) {
    if (resource.kind === "call") {
      if (resource.method === "POST" && resource.control !== "none") this.#addCall(resource);
      return;
    }
    if (resource.content_type.startsWith("image/")) {
      const card = new CameraCard(make("camera-template"), resource);
      this.#cards.set(resource.key, card);
      this.pictures.append(card.element);
    }
    this.#streams.push(new Stream(resource, (sample) => this.#take(resource, sample)));
  }

  /** Joints that move between limits get sliders, other inputs a form, and no input is a button. */
  #addCall(resource) {
    const hasInput = resource.input?.properties || resource.takes !== "application/json";
    if (resource.control === "drive") this.#addBase(resource);
    else if (!hasInput) this.#addButton(resource);
    else if (resource.control === "form" || !movesJoints(resource)) this.#addForm(resource);
    else this.#addJoints(resource);
  }

  #addForm(resource) {
    const call = (body) =>
      body instanceof Blob
        ? send(resource.url, body, resource.takes)
        : client.call(this.name, resource.path, body, { timeoutS: FORM_TIMEOUT_S });
    const action = this.#actions.get(resource.path.replace(/\/goal$/, ""));
    const card = action
      ? new ActionCard(make("form-template"), resource, action)
      : new FormCard(make("form-template"), resource, call);
    this.#forms.push(card);
    this.element.querySelector(".forms").append(card.element);
    this.element.querySelector(".forms").hidden = false;
  }

  /** Its map sends the base to where the first action below it takes poses. */
  #addBase(resource) {
    const part = resource.path.replace(/[^/]*$/, "");
    const goal = this.resources.find((other) => other.path.startsWith(part) && other.path.endsWith("/goal") && takesPose(other));
    const call = (path, body) => client.call(this.name, path, body, { timeoutS: DRIVE_TIMEOUT_S });
    const card = new BaseCard(make("base-template"), resource, call, this.#actions.get(goal?.path.replace(/\/goal$/, "")) ?? null);
    this.#bases.push(card);
    this.controls.append(card.element);
  }

  #addJoints(resource) {
    const card = new JointsCard(make("joints-template"), $("#joint-template"), resource.path, (body) =>
      client.call(this.name, resource.path, body, { timeoutS: CALL_TIMEOUT_S }),
    );
    card.path = resource.path;
    card.element.hidden = true;
    this.#joints.push(card);
    this.controls.prepend(card.element);
  }

  /** A call without input is a button. One that is named `stop` stops everything here first. */
  #addButton(resource) {
    const button = document.createElement("button");
    button.type = "button";
    button.title = resource.description;
    const verb = resource.path.split("/").at(-1);
    const part = resource.path.split("/").slice(0, -1).join(" ");
    button.textContent = verb[0].toUpperCase() + verb.slice(1) + (part && this.#hasOther(resource, verb) ? ` ${part}` : "");
    button.dataset.path = resource.path;
    if (verb === "stop") button.className = "stop";
    button.addEventListener("click", () => (verb === "stop" ? this.stop(resource) : this.#call(resource)));
    this.element.querySelector(".actions").append(button);
  }

  /** Whether another button would have the same name. */
  #hasOther(resource, verb) {
    return this.resources.some((other) => other !== resource && !other.input && other.path.split("/").at(-1) === verb);
  }

  async #call(resource) {
    this.#failures.delete(resource.path);
    try {
      await client.call(this.name, resource.path, {}, { timeoutS: CALL_TIMEOUT_S });
    } catch (error) {
      this.#failures.set(resource.path, `${resource.path} failed: ${error.message}`);
    }
    const notice = this.element.querySelector(".action-error");
    setText(notice, [...this.#failures.values()].join(" \u00b7 "));
    notice.hidden = this.#failures.size === 0;
  }

  /** Stop, and again after a move that was under way: it may have arrived later. */
  async stop(resource) {
    const bases = this.#bases.filter(({ part }) => resource.path.startsWith(`${part}/`));
    const halted = Promise.all([...this.#joints, ...bases].map((card) => card.halt()));
    await this.#call(resource);
    const moves = (await halted).flat();
    if (moves.some((move) => move !== null)) await this.#call(resource);
  }

  stopAll() {
    for (const button of this.element.querySelectorAll("button.stop")) button.click();
  }

  #take(resource, sample) {
    if (this.#place(resource, sample)) this.#removeReadings(resource.key);
    else this.#readings(resource).take(sample);
  }

  /** Show a sample where it belongs; return whether there is such a place. */
  #place(resource, sample) {
    const own = this.#cards.get(resource.key);
    switch (sample.schema) {
      case "vertebra/Image/1":
        if (!(own instanceof CameraCard)) return false;
        own.image(sample);
        return true;
      case "vertebra/Faces/1":
        this.#cameraOf(resource)?.faces(sample);
        return this.#cameraOf(resource) !== null;
      case "vertebra/JointState/1":
        return this.#measure(resource.key, sample.message);
      case "vertebra/Odometry/1":
        this.#baseOf(resource)?.odometry(sample);
        return this.#baseOf(resource) !== null;
      case "vertebra/LaserScan/1":
        this.#baseOf(resource)?.scan(sample);
        return this.#baseOf(resource) !== null;
      default:
        return this.#feed(resource, sample);
    }
  }

  /** What is told below a base is about it. */
  #baseOf(resource) {
    return this.#bases.find(({ part }) => resource.path.startsWith(`${part}/`)) ?? null;
  }

  #feed(resource, sample) {
    const action = resource.path.endsWith("/feedback") && this.#actions.get(resource.path.replace(/\/feedback$/, ""));
    if (action) action.take(sample);
    return Boolean(action);
  }

  /** Results on an image are published below the key of that image. */
  #cameraOf(resource) {
    const card = this.#cards.get(resource.key.split("/").slice(0, -1).join("/"));
    return card instanceof CameraCard ? card : null;
  }

  #measure(key, { names, positions_deg }) {
    const own = this.#joints.filter((card) => card.measure(names, positions_deg));
    for (const card of own) card.key = key;
    return own.length > 0;
  }

  #readings(resource) {
    const known = this.#cards.get(resource.key);
    if (known instanceof ReadingsCard) return known;
    const card = new ReadingsCard(make("readings-template"), resource);
    this.#cards.set(resource.key, card);
    this.controls.append(card.element);
    return card;
  }

  /** A message may find its place later than it comes: sliders need the robot's limits. */
  #removeReadings(key) {
    const card = this.#cards.get(key);
    if (!(card instanceof ReadingsCard)) return;
    card.element.remove();
    this.#cards.delete(key);
  }

  /** Take over what the gateway says now. @param {any} description */
  update(description) {
    this.description = description;
    for (const card of this.#joints) {
      const resource = description.resources.find(({ path }) => path === card.path);
      card.element.hidden = movableFields(resource).length === 0;
      card.setLimits(resource);
    }
    for (const card of this.#forms) {
      card.setLimits(description.resources.find(({ path }) => path === card.path));
    }
    for (const card of this.#bases) {
      card.setLimits(description.resources.find(({ path }) => path === card.path));
    }
    this.#showPresence();
  }

  /** The connection changed: what the robot is can only be told while there is one. */
  #showPresence() {
    const connected = client.state === "open";
    const { online, reason, away: parts } = this.description;
    const missing = Object.keys(parts).join(", ");
    const chip = this.element.querySelector(".chip");
    chip.dataset.state = connected ? (online ? (missing ? "warning" : "ok") : "error") : "unknown";
    chip.title = online ? Object.entries(parts).map((part) => part.join(": ")).join("\n") : "";
    const there = missing ? `online without ${missing}` : "online";
    setText(chip.querySelector(".chip-text"), connected ? (online ? there : "offline") : "unknown");
    const away = this.element.querySelector(".away");
    away.hidden = !connected || online;
    setText(away, `${this.name} is offline: ${reason}`);
    const reasons = new Map(this.description.resources.map((resource) => [resource.path, resource.reason]));
    for (const card of [...this.#joints, ...this.#forms, ...this.#bases]) {
      card.enable(connected && reasons.get(card.path) === "");
    }
  }

  refresh() {
    this.#showPresence();
    for (const stream of this.#streams) {
      const freshness = stream.describe();
      const { key } = stream.resource;
      const explained = this.#explained(stream.resource, freshness);
      this.#cards.get(key)?.refresh(explained);
      stream.row.refresh(stream, freshness);
      for (const card of this.#joints) if (card.key === key) card.refresh(freshness);
      if (stream.schema === "vertebra/Odometry/1") this.#baseOf(stream.resource)?.refresh(explained);
    }
  }

  /** An old picture of a robot that is away says so. */
  #explained({ path }, freshness) {
    if (freshness.state === "live" || client.state !== "open") return freshness;
    const { online, away } = this.description;
    const part = Object.keys(away).find((one) => path.startsWith(`${one}/`));
    if (online && !part) return freshness;
    const what = online ? `The ${part} of ${this.name} is away` : `${this.name} is offline`;
    return { ...freshness, text: `${freshness.text}. ${what}` };
  }

  remove() {
    for (const stream of this.#streams) stream.close();
    for (const card of this.#bases) card.close();
    this.element.remove();
  }
}

/** All robots, kept in step with what the gateway says. */
class Robots {
  /** @type {Map<string, {robot: Robot, shape: string}>} */ #robots = new Map();

  update(descriptions) {
    const names = new Set(descriptions.map(({ name }) => name));
    for (const name of [...this.#robots.keys()]) {
      if (!names.has(name)) this.#remove(name);
    }
    for (const description of descriptions) this.#update(description);
    this.refresh();
    if (descriptions.length === 0) {
      const empty = document.createElement("p");
      empty.className = "empty";
      empty.textContent = "This gateway has no robot: put a profile into deploy/robots.";
      $("#robots").replaceChildren(empty);
    }
  }

  #update(description) {
    const { resources, name } = description;
    const shape = JSON.stringify(resources.map((resource) => ({ ...resource, limits: null, reason: null })));
    const known = this.#robots.get(name);
    if (known?.shape === shape) {
      known.robot.update(description);
      return;
    }
    this.#remove(name);
    $("#robots .empty")?.remove();
    const robot = new Robot(description);
    this.#robots.set(name, { robot, shape });
    $("#robots").append(robot.element);
  }

  #remove(name) {
    this.#robots.get(name)?.robot.remove();
    this.#robots.delete(name);
  }

  refresh() {
    for (const { robot } of this.#robots.values()) robot.refresh();
    $("#stop").hidden = $("#robots button.stop") === null;
  }

  stopAll() {
    for (const { robot } of this.#robots.values()) robot.stopAll();
  }
}

/* ---- services */

/** The table of services, asked for every two seconds. */
class Fleet {
  #section = $("#fleet");
  #heardAt = 0;
  #reason = "";

  async follow() {
    for (;;) {
      if (client.state !== "waiting") await this.#ask();
      this.#sayAge();
      await new Promise((resolve) => setTimeout(resolve, FLEET_PERIOD_MS));
    }
  }

  async #ask() {
    try {
      const response = await fetch("api/fleet", { signal: AbortSignal.timeout(FLEET_PERIOD_MS) });
      const answer = await response.json();
      if (!response.ok) throw new Error(answer.detail);
      this.#heardAt = performance.now();
      this.#reason = "";
      this.#render(answer.services);
    } catch (error) {
      this.#reason = error.message;
    }
  }

  #sayAge() {
    const silentMs = performance.now() - this.#heardAt;
    const stale = silentMs > 2 * FLEET_PERIOD_MS;
    this.#section.toggleAttribute("data-stale", stale);
    if (!stale) return;
    const since = this.#heardAt ? `as they were ${(silentMs / 1000).toFixed(0)} s ago` : "not told yet";
    setText($("#fleet-summary"), this.#reason ? `${since}: ${this.#reason}` : since);
  }

  #render(services) {
    const present = new Set(services.filter((row) => row.present).map((row) => row.service));
    // An instance that is gone matters only if nobody took its place.
    const rows = services.filter((row) => row.present || !present.has(row.service));
    const sick = rows.filter((row) => health(row).state !== "ok").length;
    const all = `${rows.length} ${rows.length === 1 ? "service" : "services"}`;
    setText($("#fleet-summary"), sick ? `${sick} of ${all} need a look` : `${all}, all well`);
    this.#section.querySelector("tbody").replaceChildren(...rows.map(serviceRow));
  }
}

/** How a service is doing, in a word. */
function health({ present, status, status_age_s }) {
  if (!present) return { state: "gone", word: "gone" };
  if (!status) return { state: "unknown", word: "silent" };
  if (status_age_s > SILENT_AFTER_S) return { state: "unknown", word: `silent for ${status_age_s.toFixed(0)} s` };
  return { state: status.level, word: status.level };
}

function serviceRow(service) {
  const row = document.createElement("tr");
  const { state, word } = health(service);
  row.dataset.state = state;
  row.dataset.service = service.service;
  const name = document.createElement("th");
  name.scope = "row";
  name.textContent = service.service;
  name.title = `${service.service}/${service.instance}`;
  const mark = document.createElement("span");
  mark.className = "health";
  const lamp = document.createElement("span");
  lamp.className = "lamp";
  mark.append(lamp, word);
  row.append(name);
  row.insertCell().append(mark);
  row.insertCell().textContent = service.status?.text ?? "";
  const version = row.insertCell();
  version.className = "optional";
  version.textContent = service.version;
  return row;
}

/* ---- the connection */

function showConnection() {
  const { state } = client;
  document.documentElement.dataset.connection = state;
  const trip = client.clock.round_trip_ms;
  const words = { open: "Connected", connecting: "Connecting", waiting: "Not connected", closed: "Not connected" };
  setText($("#link"), words[state]);
  setText($("#trip"), state === "open" && !Number.isNaN(trip) ? `${trip.toFixed(1)} ms` : "");
}

/** Whether the gateway is there but will not have us: browsers do not tell a WebSocket why. */
async function explainLoss(reason) {
  setText($("#reason"), `Not connected: ${reason}. Trying again by itself.`);
  try {
    const response = await fetch("api/robots", { signal: AbortSignal.timeout(FLEET_PERIOD_MS) });
    if (response.status !== 401 && response.status !== 403) return;
    const { detail } = await response.json();
    if (client.state !== "open") setText($("#reason"), `Not connected: ${detail}.`);
  } catch {
    // Nobody is there at all; the reason that is shown already says that.
  }
}

/* ---- small things */

/** Whether a call moves joints, as far as its schema tells: limits come when the robot does. */
function movesJoints({ control, limits, input }) {
  if (control === "sliders") return true;
  return movableFields({ limits, input }).length > 0 || input?.properties?.positions_deg !== undefined;
}

/** Send bytes to a path; return the answer or throw the problem. */
async function send(url, body, type) {
  const response = await fetch(url, { method: "POST", body, headers: { "content-type": type } });
  const answer = await response.json();
  if (!response.ok) throw new Error(answer.detail);
  return answer;
}

function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Endings of field names that say a unit, longest first. */
const UNITS = {
  _m_s2: "m/s²", _deg_s: "deg/s", _rad_s: "rad/s", _m_s: "m/s", _deg: "deg", _rad: "rad",
  _ut: "µT", _nm: "Nm", _hz: "Hz", _ns: "ns", _ms: "ms", _s: "s", _m: "m",
};

/** The name of a field as words, and its unit. */
function wordsAndUnit(name) {
  const ending = Object.keys(UNITS).find((unit) => name.endsWith(unit));
  const words = ending ? name.slice(0, -ending.length) : name;
  return [words.replaceAll("_", " "), ending ? UNITS[ending] : ""];
}

/** A value of a message in a few words. */
function readable(value) {
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : value.toFixed(2);
  if (value?.dtype) return `array of ${value.dtype}, shape (${value.shape.join(", ")})`;
  if (Array.isArray(value)) {
    const whole = value.every(Number.isInteger);
    const texts = value.map((item) => (typeof item === "number" && !whole ? item.toFixed(2) : readable(item)));
    return texts.join("\u2002");
  }
  if (value !== null && typeof value === "object") {
    return Object.entries(value).map(([name, item]) => `${name} ${readable(item)}`).join(", ");
  }
  return String(value);
}

/* ---- start */

const problems = new Problems();
const robots = new Robots();

client.addEventListener("error", (event) => {
  event.preventDefault(); // it is shown here, the console need not repeat it
  problems.add(event.detail.message);
});
client.addEventListener("robots", (event) => robots.update(event.detail));
client.addEventListener("state", (event) => {
  showConnection();
  robots.refresh();
  const lost = event.detail.state === "waiting";
  if (lost) explainLoss(event.detail.reason);
  if (lost || event.detail.state === "open") $("#reason").hidden = !lost;
});
$("#stop").addEventListener("click", () => robots.stopAll());
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !event.repeat) robots.stopAll();
});
setInterval(() => {
  showConnection();
  robots.refresh();
}, RENDER_PERIOD_MS);

client.connect();
new Fleet().follow();
