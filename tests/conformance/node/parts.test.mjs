// The parts of the dashboard that decide something without a page.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Pairing } from "../../../services/gateway/src/vertebra_gateway/static/camera.js";
import {
  NewestCall,
  movableFields,
  niceStep,
  withUnit,
} from "../../../services/gateway/src/vertebra_gateway/static/joints.js";

const settle = () => new Promise((resolve) => setImmediate(resolve));
const image = (captured_ns, bytes = 10) => ({ captured_ns: BigInt(captured_ns), payload: new Uint8Array(bytes) });
const result = (captured_ns) => ({ captured_ns: BigInt(captured_ns) });

test("an image waits for its result while results come", () => {
  const pairing = new Pairing({ patienceMs: 700 });
  assert.deepEqual(pairing.image(image(1), 0), { image: image(1), result: null }, "nobody looks at it yet");
  assert.deepEqual(pairing.result(result(1), 10), { image: image(1), result: result(1) });
  assert.equal(pairing.image(image(2), 40), null);
  assert.equal(pairing.image(image(3), 80), null);
  assert.deepEqual(pairing.result(result(2), 90), { image: image(2), result: result(2) });
  assert.deepEqual(pairing.result(result(3), 130), { image: image(3), result: result(3) });
});

test("a result never meets another image", () => {
  const pairing = new Pairing();
  pairing.image(image(1), 0);
  assert.equal(pairing.result(result(2), 10), null);
  assert.deepEqual(pairing.image(image(2), 20), { image: image(2), result: result(2) }, "it overtook it");
  assert.equal(pairing.result(result(1), 30), null, "what was passed over is not shown again");
});

test("images are shown bare when results stay away", () => {
  const pairing = new Pairing({ patienceMs: 700 });
  pairing.image(image(1), 0);
  pairing.result(result(1), 10);
  assert.equal(pairing.image(image(2), 700), null);
  assert.deepEqual(pairing.image(image(3), 720), { image: image(3), result: null });
  assert.deepEqual(pairing.result(result(3), 740), { image: image(3), result: result(3) });
  assert.equal(pairing.image(image(4), 760), null, "and wait again when they are back");
});

test("a clock that was set back changes nothing", () => {
  const pairing = new Pairing();
  pairing.image(image(1000), 0);
  pairing.result(result(1000), 10);
  pairing.image(image(5), 20);
  assert.deepEqual(pairing.result(result(5), 30), { image: image(5), result: result(5) });
});

test("what waits for its partner is bounded", () => {
  const pairing = new Pairing({ maxCount: 3, maxBytes: 25 });
  for (const captured_ns of [1, 2, 3, 4]) pairing.image(image(captured_ns), 0);
  assert.equal(pairing.result(result(2), 10), null, "only 25 bytes of images are kept");
  assert.notEqual(pairing.result(result(3), 10), null);
  pairing.image(image(5, 1000), 20);
  assert.notEqual(pairing.result(result(5), 30), null, "but always the newest");
  for (const captured_ns of [11, 12, 13, 14]) pairing.result(result(captured_ns), 40);
  pairing.image(image(11), 50);
  assert.equal(pairing.image(image(11), 50), null);
  assert.notEqual(pairing.image(image(12), 50), null);
});

function calls() {
  const sent = [];
  const finish = [];
  const call = new NewestCall((values) => {
    sent.push(values);
    return new Promise((resolve) => finish.push(resolve));
  });
  return { call, sent, finish };
}

test("while a move is under way only the newest target of each joint waits", async () => {
  const { call, sent, finish } = calls();
  call.push({ yaw: 1 });
  for (const yaw of [2, 3, 4]) call.push({ yaw });
  call.push({ pitch: 7 });
  assert.deepEqual(sent, [{ yaw: 1 }]);
  finish[0]();
  await settle();
  assert.deepEqual(sent, [{ yaw: 1 }, { yaw: 4, pitch: 7 }]);
  finish[1]();
  await settle();
  assert.equal(call.underWay, null);
  assert.equal(sent.length, 2);
});

test("what was cancelled is not sent", async () => {
  const { call, sent, finish } = calls();
  call.push({ yaw: 1 });
  call.push({ yaw: 2 });
  call.cancel();
  finish[0]();
  await settle();
  assert.deepEqual(sent, [{ yaw: 1 }]);
});

test("steps and numbers are such as people like", () => {
  assert.deepEqual([52, 100, 40, 0.3].map((range) => Number(niceStep(range).toPrecision(3))), [0.5, 1, 0.2, 0.002]);
  assert.equal(withUnit(20, "deg"), "20.0°");
  assert.equal(withUnit(-0.04, "deg"), "0.0°");
  assert.equal(withUnit(-1.25, "m"), "\u22121.3 m");
});

test("only fields with two limits for each joint become sliders", () => {
  const limits = {
    positions_deg: { yaw: { min: -10, max: 10, unit: "deg" } },
    velocity_deg_s: { yaw: { max: 100, unit: "deg/s" } },
  };
  const properties = { positions_deg: { type: "object" }, velocity_deg_s: { type: "number" } };
  const fields = (resource) => movableFields(resource).map(([field]) => field);
  assert.deepEqual(fields({ limits, input: { properties } }), ["positions_deg"]);
  assert.deepEqual(fields({ limits: null, input: { properties } }), []);
  assert.deepEqual(fields({ limits, input: null }), []);
});
