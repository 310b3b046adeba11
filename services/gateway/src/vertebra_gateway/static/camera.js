// A camera on the dashboard: its newest image, and the faces that were found in that very image.

import { drawImage } from "./vertebra.js";

const SVG = "http://www.w3.org/2000/svg";

/**
 * Brings results together with the images they were made from, by capture time.
 *
 * While results come, an image is shown when its result is there, so that boxes never lag behind.
 * When they stay away for longer than `patienceMs`, images are shown as they come, without result.
 */
export class Pairing {
  #images = [];
  #results = [];
  #pairedAt = -Infinity;

  /** @param {{maxCount?: number, maxBytes?: number, patienceMs?: number}} [limits] */
  constructor({ maxCount = 40, maxBytes = 64e6, patienceMs = 700 } = {}) {
    this.maxCount = maxCount;
    this.maxBytes = maxBytes;
    this.patienceMs = patienceMs;
  }

  /** Take an image in; return `{image, result}` if there is something to show now, else null. */
  image(image, nowMs) {
    this.#images.push(image);
    let bytes = this.#images.reduce((sum, { payload }) => sum + payload.byteLength, 0);
    while (this.#images.length > this.maxCount || (bytes > this.maxBytes && this.#images.length > 1)) {
      bytes -= this.#images.shift().payload.byteLength;
    }
    const result = this.#results.find(({ captured_ns }) => captured_ns === image.captured_ns);
    if (result) return this.#pair(image, result, nowMs);
    return nowMs - this.#pairedAt > this.patienceMs ? { image, result: null } : null;
  }

  /** Take a result in; return as `image` does. */
  result(result, nowMs) {
    const image = this.#images.find(({ captured_ns }) => captured_ns === result.captured_ns);
    if (image) return this.#pair(image, result, nowMs);
    this.#results.push(result); // it overtook its image
    if (this.#results.length > this.maxCount) this.#results.shift();
    return null;
  }

  #pair(image, result, nowMs) {
    this.#images.splice(0, this.#images.indexOf(image) + 1);
    this.#results = this.#results.filter(({ captured_ns }) => captured_ns > result.captured_ns);
    this.#pairedAt = nowMs;
    return { image, result };
  }
}

/** The card of one camera. */
export class CameraCard {
  #pairing = new Pairing();

  /**
   * @param {HTMLElement} element made from the camera template
   * @param {{path: string, key: string, description: string}} resource
   */
  constructor(element, resource) {
    this.element = element;
    this.key = resource.key;
    this.canvas = element.querySelector("canvas");
    this.overlay = element.querySelector("svg");
    this.veil = element.querySelector(".veil");
    this.caption = element.querySelector(".caption");
    const title = resource.description || resource.path;
    element.querySelector(".title").textContent = title;
    element.querySelector(".facts").textContent = resource.path;
    this.canvas.setAttribute("aria-label", title);
  }

  /** @param {import("./vertebra.js").Sample} sample an image */
  image(sample) {
    this.#show(this.#pairing.image(sample, performance.now()));
  }

  /** @param {import("./vertebra.js").Sample} sample what was found in an image */
  faces(sample) {
    this.#show(this.#pairing.result(sample, performance.now()));
  }

  #show(pair) {
    if (!pair) return;
    const { image, result } = pair;
    drawImage(this.canvas, image.message);
    const { width, height } = this.canvas;
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.overlay.setAttribute("font-size", String(width / 30));
    const faces = result?.message.faces ?? [];
    this.overlay.replaceChildren(...faces.flatMap((face) => this.#mark(face, width)));
    this.element.dataset.capturedNs = String(image.captured_ns);
    this.#say(result ? found(faces) : "");
  }

  /** Box and label of one face. */
  #mark(face, imageWidth) {
    const { x, y, width, height } = face.box;
    const text = `#${face.track_id}  ${Math.round(100 * face.score)} %`;
    const line = imageWidth / 20;
    const plateWidth = line * (0.5 + 0.36 * text.length);
    const top = y >= line ? y - line : y + height;
    const left = Math.max(0, Math.min(x, imageWidth - plateWidth));
    const box = shape("rect", { class: "box", x, y, width, height, "data-track-id": face.track_id });
    const plate = shape("rect", { class: "plate", x: left, y: top, width: plateWidth, height: line });
    const label = shape("text", { x: left + 0.25 * line, y: top + 0.72 * line });
    label.textContent = text;
    return [box, plate, label];
  }

  #say(text) {
    if (this.caption.textContent !== text) this.caption.textContent = text;
  }

  /**
   * Show how fresh the picture is.
   *
   * @param {{state: string, text: string, rateHz: number, ageMs: number}} stream
   */
  refresh({ state, text, rateHz, ageMs }) {
    this.element.dataset.state = state;
    this.veil.textContent = text;
    const live = `${rateHz.toFixed(0)} Hz, ${Number.isNaN(ageMs) ? "age unknown" : `${ageMs.toFixed(0)} ms old`}`;
    this.element.querySelector(".facts").textContent = state === "live" ? live : "";
  }
}

function found(faces) {
  if (faces.length === 0) return "No face in this image";
  const names = faces.map((face) => `#${face.track_id}`).join(", ");
  return `${faces.length} ${faces.length === 1 ? "face" : "faces"} in this image: ${names}`;
}

function shape(name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  return element;
}
