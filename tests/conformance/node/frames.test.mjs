// The golden frames in the browser client: the same files that Python is held to (../golden_frames.py).

import assert from "node:assert/strict";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { fileURLToPath } from "node:url";

import { DecodeError, decodeFrame } from "../../../services/gateway/src/vertebra_gateway/static/vertebra.js";

const FOLDER = fileURLToPath(new URL("../frames", import.meta.url));
/** A browser's ArrayBuffer begins on a boundary; a Node Buffer lies anywhere in a pool. */
const OFFSETS = [0, 64, 1];

function cases(folder) {
  const names = readdirSync(join(FOLDER, folder)).filter((name) => name.endsWith(".json"));
  assert.ok(names.length > 5, `golden frames in ${folder}`);
  return names.map((name) => {
    const path = join(FOLDER, folder, name);
    const document = JSON.parse(readFileSync(path, "utf-8"));
    return { name, document, frame: readFileSync(path.replace(/json$/, "bin")) };
  });
}

/** A copy of `bytes` that begins `offset` bytes after a boundary of eight. */
function placed(bytes, offset) {
  const whole = new Uint8Array(offset + bytes.length);
  whole.set(bytes, offset);
  return whole.subarray(offset);
}

function assertNumber(actual, text, where) {
  const expected = Number(text);
  assert.equal(typeof actual, "number", where);
  assert.ok(Object.is(actual, expected), `${where}: ${actual} is not ${text}`);
}

function assertInteger(actual, text, where) {
  const safe = Number.isSafeInteger(Number(text));
  assert.equal(typeof actual, safe ? "number" : "bigint", where);
  assert.equal(String(actual), text, where);
}

function assertArray(actual, expected, where) {
  assert.deepEqual(Object.keys(actual), ["dtype", "shape", "data"], where);
  assert.equal(actual.dtype, expected.dtype, where);
  assert.deepEqual(actual.shape, expected.shape.map(Number), where);
  if (expected.bytes !== undefined) {
    assert.equal(Buffer.from(actual.data).toString("hex"), expected.bytes.replaceAll(" ", ""), where);
    return;
  }
  const items = [...actual.data];
  assert.equal(items.length, expected.items.length, where);
  items.forEach((item, index) => {
    if (typeof item === "bigint") assert.equal(String(item), expected.items[index], where);
    else assertNumber(item, expected.items[index], where);
  });
}

/** Hold a decoded value to the notation of the cases. */
function assertIs(actual, expected, where) {
  if (expected === null || typeof expected !== "object") {
    assert.equal(actual, expected, where);
  } else if (Array.isArray(expected)) {
    assert.ok(Array.isArray(actual), where);
    assert.equal(actual.length, expected.length, where);
    expected.forEach((item, index) => assertIs(actual[index], item, `${where}[${index}]`));
  } else if ("$int" in expected) {
    assertInteger(actual, expected.$int, where);
  } else if ("$float" in expected) {
    assertNumber(actual, expected.$float, where);
  } else if ("$bytes" in expected) {
    assert.ok(actual instanceof Uint8Array, where);
    assert.equal(Buffer.from(actual).toString("hex"), expected.$bytes.replaceAll(" ", ""), where);
  } else if ("$array" in expected) {
    assertArray(actual, expected.$array, where);
  } else if ("$foreign" in expected) {
    assert.equal(actual.tag, expected.$foreign.tag, where);
    assertIs(actual.plain, expected.$foreign.plain, `${where}.plain`);
  } else if ("$map" in expected) {
    assert.ok(actual instanceof Map, where);
    [...actual].forEach(([key, value], index) => {
      assertIs(key, expected.$map[index][0], `${where} key ${index}`);
      assertIs(value, expected.$map[index][1], `${where} value ${index}`);
    });
    assert.equal(actual.size, expected.$map.length, where);
  } else {
    assert.deepEqual(Object.keys(actual), Object.keys(expected), where);
    for (const key of Object.keys(expected)) {
      assertIs(Object.getOwnPropertyDescriptor(actual, key).value, expected[key], `${where}.${key}`);
    }
  }
}

function assertHeader(frame, document) {
  assert.equal(frame.schema, document.schema);
  assert.equal(typeof frame.captured_ns, "bigint");
  assert.equal(String(frame.captured_ns), document.header.captured_ns);
  assertInteger(frame.sequence, document.header.sequence, "sequence");
  assert.equal(frame.origin, document.header.origin);
  assertInteger(frame.hops, document.header.hops, "hops");
}

for (const { name, document, frame } of cases(".")) {
  test(`decodes ${name}`, () => {
    for (const offset of OFFSETS) {
      const decoded = decodeFrame(placed(frame, offset));
      assertHeader(decoded, document);
      assertIs(decoded.message, document.message, "message");
    }
  });

  test(`refuses ${name} when it is cut or extended`, () => {
    for (let length = 0; length < Math.min(frame.length, 4096); length++) {
      assert.throws(() => decodeFrame(frame.subarray(0, length)), DecodeError, `${length} bytes`);
    }
    assert.throws(() => decodeFrame(placed([...frame, 0], 0)), DecodeError);
  });

  test(`refuses or reads ${name} with any bit flipped`, () => {
    for (let offset = 0; offset < Math.min(frame.length, 1024); offset++) {
      for (let bit = 0; bit < 8; bit++) {
        const damaged = placed(frame, 0);
        damaged[offset] ^= 1 << bit;
        try {
          assert.equal(typeof decodeFrame(damaged).schema, "string");
        } catch (error) {
          assert.ok(error instanceof DecodeError, `bit ${bit} of byte ${offset}: ${error.stack}`);
        }
      }
    }
  });
}

for (const { name, document, frame } of cases("foreign")) {
  test(`decodes foreign/${name}`, () => {
    const decoded = decodeFrame(placed(frame, 0));
    assertHeader(decoded, document);
    // This reader knows no schemas: it shows what was written, and adds no defaults.
    const stated = JSON.stringify(document.message);
    const written = stated.replaceAll("$float", "$number").replaceAll("$int", "$number");
    assertWritten(decoded.message, JSON.parse(written), "message");
  });
}

/** As `assertIs`, for what a foreign writer may have left out, and numbers in any form. */
function assertWritten(actual, expected, where) {
  if (Array.isArray(expected)) {
    expected.forEach((item, index) => assertWritten(actual[index], item, `${where}[${index}]`));
  } else if (expected === null || typeof expected !== "object") {
    assertIs(actual, expected, where);
  } else if ("$number" in expected) {
    assert.equal(Number(actual), Number(expected.$number), where);
  } else if (!Object.keys(expected).some((key) => key.startsWith("$"))) {
    const written = Object.keys(expected).filter((key) => key in actual);
    assert.ok(written.length > 0 || Object.keys(actual).length === 0, where);
    written.forEach((key) => assertWritten(actual[key], expected[key], `${where}.${key}`));
  } else {
    assertIs(actual, expected, where);
  }
}

// Faults that only a reader with schemas can see are none to this one.
const damaged = cases("damaged").filter(({ document }) => document.needs !== "schemas");
for (const { name, document, frame } of damaged) {
  test(`refuses damaged/${name}`, () => {
    assert.equal(document.error, "DecodeError");
    assert.throws(
      () => decodeFrame(placed(frame, 0)),
      (error) => error instanceof DecodeError && error.message.includes(document.reason),
      document.reason,
    );
  });
}

test("arrays are views of the received bytes where alignment allows", () => {
  const frame = readFileSync(join(FOLDER, "Tensor-f8.bin"));
  const aligned = placed(frame, 0);
  assert.equal(decodeFrame(aligned).message.array.data.buffer, aligned.buffer);
  const shifted = placed(frame, 1);
  assert.notEqual(decodeFrame(shifted).message.array.data.buffer, shifted.buffer);
});

test("values nested 500 deep are read, 501 are refused", () => {
  const nested = (depth) => {
    const fields = [0x81, 0xa5, ...Buffer.from("value"), ...Array(depth - 1).fill(0x91), 0xc0];
    const schema = Buffer.from("vertebra/Native/1");
    const head = [0x82, 0xa6, ...Buffer.from("schema"), 0xa0 | schema.length, ...schema];
    head.push(0xa6, ...Buffer.from("fields"), ...fields);
    return Uint8Array.from([0x56, 0x54, 0x42, 1, head.length & 255, head.length >> 8, 0, 0, ...head]);
  };
  assert.equal(decodeFrame(nested(500)).schema, "vertebra/Native/1");
  assert.throws(() => decodeFrame(nested(501)), /nested more than 500 deep/);
});
