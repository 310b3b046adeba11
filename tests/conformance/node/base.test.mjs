// What the panel of a base decides without a page: velocities, poses, the map's view, the life of a goal.

import assert from "node:assert/strict";
import { mock, test } from "node:test";

const STATIC = "../../../services/gateway/src/vertebra_gateway/static/";
const { Action, feedbackText } = await import(`${STATIC}actions.js`);
const { NAVIGATION, poseGoal, progressText, takesPose } = await import(`${STATIC}base.js`);
const { Driver, velocityOf } = await import(`${STATIC}drive.js`);
const { View, hitsOf, poseOf } = await import(`${STATIC}map.js`);

const settle = () => new Promise((resolve) => setImmediate(resolve));
const LIMITS = { linear_m_s: { min: -0.2, max: 0.5 }, angular_deg_s: { min: -90, max: 90 } };
const ID = "000102030405060708090a0b0c0d0e0f";
const uuid = { uuid: { dtype: "|u1", shape: [16], data: Uint8Array.from({ length: 16 }, (_, index) => index) } };

test("the knob's place is a velocity within the limits", () => {
  assert.deepEqual(velocityOf(0, -1, 1, LIMITS), { linear_m_s: 0.5, angular_deg_s: 0 });
  assert.deepEqual(velocityOf(0, 1, 0.5, LIMITS), { linear_m_s: -0.1, angular_deg_s: 0 });
  assert.deepEqual(velocityOf(-1, 0, 1, LIMITS), { linear_m_s: 0, angular_deg_s: 90 }, "to the left");
  assert.deepEqual(velocityOf(0.05, -0.05, 1, LIMITS), { linear_m_s: 0, angular_deg_s: 0 }, "a trembling hand");
});

test("a velocity is sent again and again, never queued, and taken back", async () => {
  mock.timers.enable({ apis: ["setInterval"] });
  const sent = [];
  const finish = [];
  const driver = new Driver((body) => {
    sent.push(body);
    return new Promise((resolve) => finish.push(resolve));
  });
  driver.hold({ linear_m_s: 0.1, angular_deg_s: 0 });
  driver.hold({ linear_m_s: 0.2, angular_deg_s: 0 });
  mock.timers.tick(600);
  assert.deepEqual(sent, [{ linear_m_s: 0.1, angular_deg_s: 0, for_s: 0.5 }], "one at a time");
  finish[0]();
  await settle();
  mock.timers.tick(200);
  assert.deepEqual(sent[1], { linear_m_s: 0.2, angular_deg_s: 0, for_s: 0.5 }, "the newest");
  driver.release();
  driver.release();
  assert.deepEqual(sent.slice(2), [{ linear_m_s: 0, angular_deg_s: 0 }], "at once");
  finish[1]();
  await settle();
  assert.equal(sent.length, 4, "and after the one under way");
  mock.timers.tick(1000);
  assert.equal(sent.length, 4);
  mock.timers.reset();
});

test("a pose and a scan become places on the floor", () => {
  const quarter = { pose: { position_m: [1, 2, 0], orientation_xyzw: [0, 0, Math.SQRT1_2, Math.SQRT1_2] } };
  const pose = poseOf(quarter);
  assert.deepEqual([pose.x, pose.y, pose.heading.toFixed(4)], [1, 2, (Math.PI / 2).toFixed(4)]);
  const ranges_m = { data: Float32Array.from([2, NaN, Infinity, 0.01, 9]) };
  const scan = { ranges_m, angle_min_rad: 0, angle_increment_rad: 0.1, range_min_m: 0.1, range_max_m: 8 };
  const hits = hitsOf(scan, pose);
  assert.equal(hits.length, 1, "only what the laser can tell");
  assert.deepEqual(hits[0].map((value) => value.toFixed(3)), ["1.000", "4.000"]);
});

test("ahead is up, left is left, and there is a way back from the screen", () => {
  const view = new View();
  assert.equal(view.approach([[0, 0], [4, 0], [0, 2]]), true, "at once the first time");
  assert.equal(view.approach([[0, 0], [9, 0], [0, 2]]), false, "then by and by");
  view.fit(400, 300);
  const [left, top] = view.toScreen(0, 0);
  assert.ok(view.toScreen(1, 0)[1] < top);
  assert.ok(view.toScreen(0, 1)[0] < left);
  const [x, y] = view.toFloor(...view.toScreen(3.5, -1.25));
  assert.deepEqual([x.toFixed(6), y.toFixed(6)], ["3.500000", "-1.250000"]);
});

test("a goal is a pose where the action takes one", () => {
  const pose = (inside) => ({ input: { properties: { pose: { properties: inside } } } });
  assert.equal(takesPose(pose({ pose: {} })), true);
  assert.equal(takesPose(pose({ x: {} })), false);
  assert.equal(takesPose({ input: null }), false);
  const goal = poseGoal({ x: 1, y: 2, heading: Math.PI }, "map");
  assert.equal(goal.pose.header.frame_id, "map");
  assert.equal(goal.pose.pose.orientation.z, 1);
});

test("a feedback is said in a line", () => {
  const time = { sec: 3, nanosec: 500_000_000 };
  assert.equal(feedbackText({ order: 3, done: 0.25, took: time, pose: { x: 1 } }), "order 3 · done 0.25 · took 3.5 s");
  assert.equal(feedbackText({ sequence: { data: Int32Array.from([0, 1, 1]) } }), "sequence 0 1 1");
  assert.equal(feedbackText(null), "");
  const told = { distance_remaining: 2.345, navigation_time: time, estimated_time_remaining: time };
  assert.equal(NAVIGATION.result({ error_code: 206 }), "something is where the goal is");
  assert.equal(NAVIGATION.result({ error_code: 0 }), "");
  assert.equal(progressText(told), "2.35 m to go · 4 s so far · about 4 s left");
});

function action(answers) {
  const asked = [];
  const one = new Action((leaf, body) => {
    asked.push([leaf, body]);
    return answers[leaf]?.() ?? new Promise(() => {});
  });
  return { one, asked };
}

test("a goal is followed to its end", async () => {
  let end;
  const { one, asked } = action({
    goal: async () => ({ goal_id: ID }),
    result: () => new Promise((resolve) => (end = resolve)),
  });
  await one.send({ order: 3 });
  assert.deepEqual([one.state, one.busy], ["active", true]);
  one.take({ message: { value: { goal_id: uuid, feedback: { done: 1 } } }, age_ms: 1 });
  assert.equal(one.text, "done 1");
  end({ status: "succeeded", result: { sequence: [0, 1], error_code: 0 } });
  await settle();
  assert.deepEqual([one.state, one.busy, one.text], ["ended", false, "Succeeded: sequence 0 1"]);
  one.take({ message: { value: { goal_id: uuid, feedback: { done: 2 } } }, age_ms: 1 });
  assert.equal(one.state, "ended", "a late feedback revives nothing");
  assert.deepEqual(asked.map(([leaf]) => leaf), ["goal", "result"]);
});

test("a goal of another client is adopted while it is fresh, and can be cancelled", async () => {
  const { one, asked } = action({ cancel: async () => ({ cancelling: [ID] }) });
  one.take({ message: { value: { goal_id: uuid, feedback: {} } }, age_ms: 60_000 });
  assert.equal(one.state, "idle", "a greeting of yesterday");
  one.take({ message: { value: { goal_id: uuid, feedback: {} } }, age_ms: 10 });
  assert.equal(one.state, "active");
  await one.cancel();
  assert.deepEqual(asked.at(-1), ["cancel", { goal_id: ID }]);
  assert.equal(one.state, "cancelling");
});

test("refusals are told and thrown", async () => {
  const { one } = action({ goal: async () => Promise.reject(new Error("too far")) });
  await assert.rejects(one.send({}), /too far/);
  assert.deepEqual([one.state, one.text], ["ended", "The goal was refused: too far"]);
});
