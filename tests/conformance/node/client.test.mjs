// The browser client against a WebSocket that the test holds in its hand.
// It does not imitate: the network, its delays, and what a real gateway would answer.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { afterEach, beforeEach, mock, test } from "node:test";

import {
  DeadlineError,
  NotConnectedError,
  ProblemError,
  Vertebra,
  VertebraError,
  decodeData,
  decodeFrame,
  drawImage,
} from "../../../services/gateway/src/vertebra_gateway/static/vertebra.js";

const URL_ = "ws://gateway.test/ws";
const golden = (name) => readFileSync(new URL(`../frames/${name}.bin`, import.meta.url));

/** Lets promises that are settled already run their followers. */
const settle = () => new Promise((resolve) => setImmediate(resolve));

let sockets;
let reachable;
let probes;
let passed_ms;

class FakeWebSocket {
  constructor(url, protocols) {
    Object.assign(this, { url, protocols, sent: [], closed: false });
    sockets.push(this);
  }

  send(text) {
    assert.ok(!this.closed, "nothing is sent to a closed socket");
    this.sent.push(JSON.parse(text));
  }

  close() {
    this.closed = true;
  }

  open() {
    this.onopen();
  }

  drop(code = 1006, reason = "") {
    this.closed = true;
    this.onclose({ code, reason });
  }

  say(message) {
    this.onmessage({ data: typeof message === "string" ? message : JSON.stringify(message) });
  }

  /** Send data as the gateway does. */
  give(id, payload, head = {}) {
    const encoding = "application/vnd.vertebra.frame;Text/1";
    const text = JSON.stringify({ key: "a/b", encoding, sent_ns: "5", dropped: 0, ...head });
    const bytes = Buffer.from(text);
    const start = Math.ceil((8 + bytes.length) / 64) * 64;
    const whole = new Uint8Array(start + payload.length);
    new DataView(whole.buffer).setUint32(0, id, true);
    new DataView(whole.buffer).setUint32(4, bytes.length, true);
    whole.set(bytes, 8);
    whole.set(payload, start);
    this.onmessage({ data: whole.buffer });
  }

  ops(op) {
    return this.sent.filter((message) => message.op === op);
  }
}

const socket = () => sockets.at(-1);

function client(options = {}) {
  const fetch = async (url) => {
    probes.push(String(url));
    if (!reachable) throw new TypeError("fetch failed");
  };
  const vertebra = new Vertebra({ url: URL_, WebSocket: FakeWebSocket, fetch, ...options });
  vertebra.errors = [];
  vertebra.states = [];
  vertebra.addEventListener("error", (event) => {
    event.preventDefault();
    vertebra.errors.push(event.detail);
  });
  vertebra.addEventListener("state", (event) => vertebra.states.push(event.detail));
  return vertebra;
}

function connected(options) {
  const vertebra = client(options);
  vertebra.connect();
  socket().open();
  return vertebra;
}

/** Let time pass for timers and clock alike. */
async function pass(ms) {
  for (let left = ms; left > 0; left -= 50) {
    passed_ms += Math.min(left, 50);
    mock.timers.tick(Math.min(left, 50));
    await settle();
  }
}

beforeEach(() => {
  sockets = [];
  probes = [];
  reachable = true;
  passed_ms = 0;
  mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  mock.method(performance, "now", () => passed_ms);
});

afterEach(() => {
  mock.timers.reset();
  mock.restoreAll();
});

test("connects with the subprotocol, and with the token if it has one", async () => {
  const vertebra = client({ token: "secret" });
  const open = vertebra.connect();
  assert.equal(vertebra.state, "connecting");
  assert.deepEqual(socket().protocols, ["vertebra.v1", "token.secret"]);
  assert.equal(socket().binaryType, "arraybuffer");
  socket().open();
  await open;
  await vertebra.connect();
  assert.equal(vertebra.state, "open");
  assert.equal(sockets.length, 1);
  connected();
  assert.deepEqual(socket().protocols, ["vertebra.v1"]);
});

test("without a WebSocket or a page it says what to pass", () => {
  const own = globalThis.WebSocket; // newer Node has one
  globalThis.WebSocket = undefined;
  try {
    assert.throws(() => new Vertebra({ url: URL_ }), /option WebSocket/);
  } finally {
    globalThis.WebSocket = own;
  }
  assert.throws(() => new Vertebra({ WebSocket: FakeWebSocket }), /option url/);
});

test("tells the robots, now and whenever they change", async () => {
  const vertebra = client();
  const seen = [];
  vertebra.addEventListener("robots", (event) => seen.push(event.detail));
  await assert.rejects(vertebra.robots(), NotConnectedError);
  vertebra.connect();
  socket().open();
  const waiting = vertebra.robots();
  socket().say({ op: "robots", robots: [{ name: "vizzy" }] });
  assert.deepEqual(await waiting, [{ name: "vizzy" }]);
  socket().say({ op: "robots", robots: [] });
  assert.deepEqual(await vertebra.robots(), []);
  assert.equal(seen.length, 2);
});

test("a list of robots that never comes is an error", async () => {
  const vertebra = connected();
  const waiting = assert.rejects(vertebra.robots(), DeadlineError);
  const answer = setInterval(() => answerPings(), 100);
  await pass(5100);
  clearInterval(answer);
  await waiting;
});

function answerPings(server_ms = 0) {
  const { sent } = socket();
  for (const ping of sent.filter((message) => message.op === "ping" && !message.answered)) {
    ping.answered = true;
    const server_ns = String(BigInt(Math.round((performance.timeOrigin + passed_ms + server_ms) * 1e6)));
    socket().say({ op: "pong", id: ping.id, client_ns: ping.client_ns, server_ns });
  }
}

test("gives the samples of a subscription, with message, header and age", async () => {
  const vertebra = connected();
  answerPings(2000);
  assert.ok(Math.abs(vertebra.clock.offset_ms - 2000) < 1);
  const samples = [];
  const handle = vertebra.subscribe("a/*", { maxRateHz: 5, form: "frame" }, (sample) => samples.push(sample));
  const [order] = socket().ops("subscribe");
  assert.deepEqual(order, {
    op: "subscribe", id: handle.id, key: "a/*", max_rate_hz: 5, form: "frame", window: 4,
  });
  assert.equal(handle.state, "waiting");
  assert.ok(Number.isNaN(handle.ageMs));
  socket().say({ op: "subscribed", id: handle.id });
  assert.equal(handle.state, "active");
  socket().give(handle.id, golden("Header-all"), { dropped: 3 });
  socket().say({ op: "drops", id: handle.id, dropped: 4, lost: 2 });
  await settle();
  const [sample] = samples;
  assert.equal(sample.key, "a/b");
  assert.equal(sample.schema, "vertebra/Text/1");
  assert.equal(sample.message.text, "x");
  assert.equal(sample.captured_ns, 1700000000123456789n);
  assert.equal(sample.sent_ns, 5n);
  const expected_ms = performance.timeOrigin + 2000 - 1700000000123.456;
  assert.ok(Math.abs(sample.age_ms - expected_ms) < 2, `${sample.age_ms} is not ${expected_ms}`);
  assert.ok(Math.abs(handle.ageMs - expected_ms) < 2);
  assert.deepEqual([handle.received, handle.dropped, handle.lost], [1, 4, 2]);
  assert.deepEqual(vertebra.errors, []);
});

test("reads the other encodings", async () => {
  const vertebra = connected();
  const samples = [];
  const handle = vertebra.subscribe("**", {}, (sample) => samples.push(sample));
  const document = { key: "a/b", schema: "vertebra/Text/1", captured_ns: "7000000001", message: { text: "x" } };
  socket().give(handle.id, Buffer.from(JSON.stringify(document)), { encoding: "application/json" });
  socket().give(handle.id, Buffer.from("[1]"), { encoding: "application/json" });
  socket().give(handle.id, Buffer.from("words"), { encoding: "text/plain;charset=utf-8" });
  socket().give(handle.id, Buffer.from("JPEG"), { encoding: "image/jpeg", captured_ns: "9" });
  await settle();
  assert.deepEqual(samples.map((sample) => sample.message), [{ text: "x" }, [1], "words", null]);
  assert.deepEqual(samples.map((sample) => sample.captured_ns), [7000000001n, 0n, 0n, 9n]);
  assert.equal(samples[0].schema, "vertebra/Text/1");
  assert.equal(Buffer.from(samples[3].payload).toString(), "JPEG");
});

test("acknowledges a sample when its callback has dealt with it", async () => {
  const vertebra = connected();
  let finish;
  const handle = vertebra.subscribe("a", { window: 1 }, () => new Promise((resolve) => (finish = resolve)));
  assert.equal(socket().ops("subscribe")[0].window, 1);
  socket().give(handle.id, golden("Text"));
  await settle();
  assert.deepEqual(socket().ops("ack"), []);
  finish();
  await settle();
  assert.deepEqual(socket().ops("ack"), [{ op: "ack", id: handle.id }]);
  socket().give(handle.id, golden("Text"));
  await settle();
  handle.close();
  finish();
  await settle();
  assert.equal(socket().ops("ack").length, 1, "a closed subscription has nothing to acknowledge");
});

test("what one connection owes is not paid to the next", async () => {
  const vertebra = connected();
  let finish;
  const handle = vertebra.subscribe("a", {}, () => new Promise((resolve) => (finish = resolve)));
  socket().give(handle.id, golden("Text"));
  await settle();
  socket().drop();
  await pass(300);
  socket().open();
  finish();
  await settle();
  assert.equal(sockets.length, 2);
  assert.deepEqual(socket().ops("ack"), []);
});

test("a damaged sample and a failing callback are errors, and the stream lives on", async () => {
  const vertebra = connected();
  let received = 0;
  const handle = vertebra.subscribe("a", {}, () => {
    received++;
    if (received === 1) throw new RangeError("out of paint");
  });
  socket().give(handle.id, golden("damaged/buffer-cut"));
  socket().give(handle.id, golden("Text"));
  socket().give(handle.id, golden("Text"));
  await settle();
  assert.match(vertebra.errors[0].message, /a sample of a\/b: buffer 3 claims 0 bytes at offset 448, the frame ends at 447/);
  assert.match(vertebra.errors[1].message, /a sample of a\/b: out of paint/);
  assert.ok(vertebra.errors.every((error) => error instanceof VertebraError));
  assert.deepEqual([vertebra.errors.length, received, handle.received], [2, 2, 3]);
  assert.equal(socket().ops("ack").length, 3);
});

test("what the gateway should not send is an error, and the connection lives on", async () => {
  const vertebra = connected();
  socket().say("no json");
  socket().say({ op: "dance" });
  socket().say({ op: "pong", id: 12345, server_ns: "1" });
  socket().say({ op: "error", id: null, status: 422, title: "no", detail: "what was that?" });
  socket().onmessage({ data: new ArrayBuffer(3) });
  socket().give(99, golden("Text"));
  await settle();
  const texts = vertebra.errors.map((error) => error.message);
  assert.match(texts[0], /not JSON: no json/);
  assert.match(texts[1], /unknown message/);
  assert.match(texts[2], /never sent: 12345/);
  assert.equal(texts[3], "what was that?");
  assert.match(texts[4], /at least 8 bytes, found 3/);
  assert.match(texts[5], /subscription 99, which was never made/);
  assert.equal(vertebra.state, "open");
});

test("an error that nobody takes is on the console", async () => {
  const write = mock.method(console, "error", () => {});
  const vertebra = new Vertebra({ url: URL_, WebSocket: FakeWebSocket });
  vertebra.connect();
  socket().open();
  socket().say("no json");
  await settle();
  assert.equal(write.mock.callCount(), 1);
  vertebra.close();
});

test("a refused subscription says why; an active one survives an error", () => {
  const vertebra = connected();
  const refused = vertebra.subscribe("a//b", {}, () => {});
  const active = vertebra.subscribe("a/b", { form: "jpeg" }, () => {});
  const problem = { op: "error", status: 422, title: "Unprocessable Content" };
  socket().say({ ...problem, id: refused.id, detail: "'a//b' is no key" });
  socket().say({ op: "subscribed", id: active.id });
  socket().say({ ...problem, id: active.id, detail: "no JPEG of a Text" });
  assert.equal(refused.state, "refused");
  assert.match(refused.error.message, /a\/\/b: 'a\/\/b' is no key/);
  assert.equal(active.state, "active");
  assert.equal(active.error.status, 422);
  assert.equal(vertebra.errors.length, 2);
  refused.close();
  assert.deepEqual(socket().ops("unsubscribe"), []);
});

test("close ends a subscription; data under way are no error", async () => {
  const vertebra = connected();
  const handle = vertebra.subscribe("a", {}, () => assert.fail("closed"));
  handle.close();
  handle.close();
  socket().give(handle.id, golden("Text"));
  assert.deepEqual(socket().ops("unsubscribe"), [{ op: "unsubscribe", id: handle.id }]);
  socket().say({ op: "unsubscribed", id: handle.id });
  await settle();
  assert.deepEqual(vertebra.errors, []);
  socket().drop();
  await pass(300);
  socket().open();
  assert.deepEqual(socket().ops("subscribe"), []);
});

test("calls give the answer, or the problem with its limit", async () => {
  const vertebra = connected();
  const moved = vertebra.call("vizzy", "head/move", { positions_deg: { neck_yaw: 20 } }, { timeoutS: 3 });
  const refused = vertebra.call("vizzy", "head/move", { positions_deg: { neck_yaw: 99 } });
  const [first, second] = socket().ops("call");
  assert.deepEqual(first, {
    op: "call", id: first.id, robot: "vizzy", path: "head/move",
    body: { positions_deg: { neck_yaw: 20 } }, timeout_s: 3,
  });
  const limit = { max: 45, unit: "deg" };
  socket().say({ op: "error", id: second.id, status: 422, title: "no", detail: "too far", limit });
  socket().say({ op: "reply", id: first.id, body: { reached: true } });
  assert.deepEqual(await moved, { reached: true });
  await assert.rejects(refused, (error) => {
    assert.ok(error instanceof ProblemError);
    assert.equal(error.message, "too far");
    assert.equal(error.status, 422);
    assert.deepEqual(error.problem.limit, limit);
    return true;
  });
  assert.deepEqual(vertebra.errors, []);
});

test("a call that is not answered ends", async () => {
  const vertebra = connected();
  const waiting = assert.rejects(vertebra.call("vizzy", "x", {}, { timeoutS: 1 }), DeadlineError);
  await pass(2100);
  await waiting;
  assert.deepEqual(vertebra.errors, []);
});

test("calls without a connection are refused, those under way are told", async () => {
  const vertebra = client();
  await assert.rejects(vertebra.call("vizzy", "x"), /vizzy\/x was not asked for: not connected yet/);
  vertebra.connect();
  socket().open();
  const waiting = assert.rejects(vertebra.call("vizzy", "x"), (error) => {
    assert.ok(error instanceof NotConnectedError);
    assert.match(error.message, /whether it was done is not known/);
    return true;
  });
  socket().drop(1001, "the gateway stops");
  await waiting;
  await assert.rejects(vertebra.call("vizzy", "x"), /the gateway stops/);
  await assert.rejects(vertebra.call("vizzy", "x", 1n), NotConnectedError);
});

test("a body that JSON does not know rejects the call alone", async () => {
  const vertebra = connected();
  await assert.rejects(vertebra.call("vizzy", "x", { value: 1n }), TypeError);
  assert.equal(vertebra.state, "open");
});

test("comes back after a loss, subscribes again and goes on counting", async () => {
  const vertebra = connected();
  const samples = [];
  const handle = vertebra.subscribe("a", {}, (sample) => samples.push(sample));
  socket().say({ op: "subscribed", id: handle.id });
  socket().give(handle.id, golden("Text"), { dropped: 5 });
  socket().say({ op: "drops", id: handle.id, dropped: 5, lost: 1 });
  socket().drop(1012, "restarting");
  assert.equal(vertebra.state, "waiting");
  assert.match(vertebra.reason, /restarting \(code 1012\)/);
  assert.equal(handle.state, "waiting");
  await pass(300);
  assert.deepEqual(probes, ["http://gateway.test/healthz"]);
  assert.equal(sockets.length, 2);
  socket().open();
  assert.deepEqual(socket().ops("subscribe").map((order) => order.id), [handle.id]);
  socket().say({ op: "subscribed", id: handle.id });
  socket().give(handle.id, golden("Text"), { dropped: 2 });
  await settle();
  assert.equal(samples.length, 2);
  assert.deepEqual([handle.received, handle.dropped, handle.lost], [2, 7, 1]);
  assert.deepEqual(vertebra.states.map((event) => event.state), [
    "connecting", "open", "waiting", "connecting", "open",
  ]);
});

test("does not open WebSockets while nobody answers, and never waits long", async () => {
  reachable = false;
  const vertebra = connected();
  socket().drop();
  await pass(20_000);
  assert.equal(sockets.length, 1);
  assert.ok(probes.length > 12, `${probes.length} probes in 20 s`);
  const waits = vertebra.states.filter((event) => event.state === "waiting").map((event) => event.retryMs);
  assert.ok(waits[0] >= 125 && waits[0] <= 250);
  assert.ok(waits.every((wait) => wait <= 1500));
  assert.ok(new Set(waits.slice(5)).size > 3, "retries are spread");
  assert.match(vertebra.reason, /does not answer: fetch failed/);
  reachable = true;
  await pass(1550);
  socket().open();
  assert.equal(vertebra.state, "open");
});

test("a gateway that closes every connection is not flooded", async () => {
  const vertebra = client();
  vertebra.connect();
  for (let second = 0; second < 20; second++) {
    if (vertebra.state === "connecting") {
      socket().open();
      socket().drop(1008, "more than 256 subscriptions");
    }
    await pass(1000);
  }
  assert.ok(sockets.length <= 20, `${sockets.length} connections in 20 s`);
  assert.ok(vertebra.states.some((event) => /256 subscriptions \(code 1008\)/.test(event.reason)));
});

test("a gateway that falls silent is left", async () => {
  const vertebra = connected();
  await pass(2500);
  assert.equal(vertebra.state, "open");
  const silent = socket();
  await pass(2000);
  assert.ok(silent.closed);
  assert.match(vertebra.states.find((event) => event.state === "waiting").reason, /silent for \d s/);
});

test("a gateway that answers is kept, and its clock measured by the quickest answer", async () => {
  const vertebra = connected();
  answerPings(500);
  const { offset_ms, round_trip_ms } = vertebra.clock;
  assert.equal(round_trip_ms, 0);
  assert.ok(Math.abs(offset_ms - 500) < 1);
  for (let second = 0; second < 10; second++) {
    await pass(1500);
    answerPings(500);
  }
  assert.equal(vertebra.state, "open");
  assert.equal(socket().ops("ping").length, 16);
  assert.ok(Math.abs(vertebra.clock.offset_ms - 500) < 1, "slow answers do not spoil it");
});

test("a connection that never opens is given up and tried again", async () => {
  const vertebra = client();
  vertebra.connect();
  await pass(6500);
  assert.ok(sockets[0].closed);
  assert.ok(vertebra.states.some((event) => /does not answer/.test(event.reason)));
  assert.ok(sockets.length >= 2);
});

test("a refusal names what may be the matter", () => {
  const vertebra = client();
  vertebra.connect();
  socket().drop(1006);
  assert.match(vertebra.reason, /no connection to ws:\/\/gateway.test\/ws: .*token or origin/);
});

test("close is for good, harmless when repeated, and can be undone", async () => {
  const vertebra = connected();
  const waiting = assert.rejects(vertebra.call("vizzy", "x"), NotConnectedError);
  vertebra.close();
  vertebra.close();
  await waiting;
  assert.ok(socket().closed);
  await pass(5000);
  assert.equal(sockets.length, 1);
  const again = vertebra.connect();
  socket().open();
  await again;
  assert.equal(vertebra.state, "open");
  const given_up = client();
  const never = assert.rejects(given_up.connect(), /closed by this page/);
  given_up.close();
  await never;
});

test("data messages are checked before they are used", () => {
  const data = (length, total) => {
    const buffer = new ArrayBuffer(total);
    new DataView(buffer).setUint32(4, length, true);
    return buffer;
  };
  assert.throws(() => decodeData(data(0xffffffff, 64)), /the head claims 4294967295 bytes/);
  assert.throws(() => decodeData(data(2, 64)), /not JSON/);
});

/* ---- drawing */

class FakeImageData {
  constructor(width, height) {
    Object.assign(this, { width, height, data: new Uint8ClampedArray(4 * width * height) });
  }
}

function fakeCanvas() {
  const put = [];
  return { width: 300, height: 150, put, getContext: () => ({ putImageData: (image) => put.push(image) }) };
}

const RGB = {
  rgb8: ([r, g, b]) => [r, g, b, 255],
  bgr8: ([b, g, r]) => [r, g, b, 255],
  rgba8: ([r, g, b, a]) => [r, g, b, a],
  bgra8: ([b, g, r, a]) => [r, g, b, a],
  mono8: ([v]) => [v, v, v, 255],
};

for (const [format, expected] of Object.entries(RGB)) {
  test(`draws ${format}`, () => {
    globalThis.ImageData = FakeImageData;
    const { message } = decodeFrame(golden(`Image-${format}`));
    const canvas = fakeCanvas();
    drawImage(canvas, message);
    drawImage(canvas, message);
    assert.deepEqual([canvas.width, canvas.height], [3, 2]);
    const channels = message.pixels.data.length / 6;
    const pixels = [];
    for (let i = 0; i < 6; i++) {
      pixels.push(...expected([...message.pixels.data.subarray(channels * i, channels * (i + 1))]));
    }
    assert.deepEqual([...canvas.put[0].data], pixels);
    assert.equal(canvas.put[0], canvas.put[1], "the same memory is used again");
  });
}

test("refuses to draw what has no picture", () => {
  assert.throws(() => drawImage(fakeCanvas(), decodeFrame(golden("Image-depth32f")).message), /'depth32f' cannot be drawn/);
  assert.throws(() => drawImage(fakeCanvas(), decodeFrame(golden("Image-empty")).message), /shape \(0,3,3\)/);
});
