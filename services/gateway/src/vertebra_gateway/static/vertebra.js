// The browser client of the Vertebra gateway: one module, no dependencies, browsers and Node 20.
//
//     import { Vertebra, drawImage } from "./vertebra.js";
//     const vertebra = new Vertebra();
//     vertebra.addEventListener("state", (event) => console.log(event.detail.state, event.detail.reason));
//     vertebra.subscribe("vizzy/camera/left", {}, (sample) => drawImage(canvas, sample.message));
//     await vertebra.connect();
//     const { positions_deg } = await vertebra.call("vizzy", "head/move", { positions_deg: { neck_yaw: 20 } });
//
// Specified in services/gateway/PROTOCOL.md (the connection) and shared/src/vertebra/codec/FRAME.md
// (the bytes). Fields of messages keep the names and units that they have everywhere else.

const MAX_HEADER_BYTES = 16 << 20;
const MAX_BUFFERS = 4096;
const MAX_AXES = 64;
const MAX_DEPTH = 500;
const ALIGNMENT = 64;
const FRAME_ENCODING = "application/vnd.vertebra.frame";

/** Root of every error that this module raises on purpose. */
export class VertebraError extends Error {
  /** @param {string} message @param {ErrorOptions} [options] */
  constructor(message, options) {
    super(message, options);
    this.name = new.target.name;
  }
}

/** These bytes are damaged or foreign; the stream they came on lives on. */
export class DecodeError extends VertebraError {}

/** The gateway is not reached: nothing was sent, or the answer was lost with the connection. */
export class NotConnectedError extends VertebraError {}

/** No answer before the deadline. */
export class DeadlineError extends VertebraError {}

/** The gateway answered with an error: `status` as in HTTP, and the whole `problem` (RFC 9457). */
export class ProblemError extends VertebraError {
  /** @param {{status?: number, title?: string, detail?: string, [key: string]: any}} problem */
  constructor(problem) {
    super(problem.detail || problem.title || `the gateway answered with status ${problem.status}`);
    this.status = problem.status;
    this.problem = problem;
  }
}

/* ------------------------------------------------------------------------------ MessagePack */

const utf8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

/**
 * Reads MessagePack that nobody vouches for: every length is checked before it is used.
 * Integers are numbers, and BigInt only beyond 2^53; maps are objects, and Map only when a key is
 * no string.
 */
class MessagePackReader {
  /**
   * @param {Uint8Array} bytes
   * @param {number} position
   * @param {number} end
   * @param {(code: number, start: number, end: number, depth: number) => any} extension
   * @param {number} depth how deep the value is nested already
   */
  constructor(bytes, position, end, extension, depth = 0) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.position = position;
    this.end = end;
    this.extension = extension;
    this.depth = depth;
  }

  /** @param {number} count @returns {number} where these bytes begin */
  take(count) {
    const start = this.position;
    if (count > this.end - start) {
      throw new DecodeError(
        `${count} bytes are claimed at offset ${start}, ${this.end - start} are left`,
      );
    }
    this.position = start + count;
    return start;
  }

  finish() {
    if (this.position !== this.end) {
      throw new DecodeError(`${this.end - this.position} bytes after the value at ${this.position}`);
    }
  }

  /** @returns {any} */
  read() {
    const code = this.bytes[this.take(1)];
    if (code < 0x80) return code;
    if (code < 0x90) return this.map(code & 0x0f);
    if (code < 0xa0) return this.list(code & 0x0f);
    if (code < 0xc0) return this.string(code & 0x1f);
    if (code >= 0xe0) return code - 0x100;
    switch (code) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: return this.binary(this.uint(1));
      case 0xc5: return this.binary(this.uint(2));
      case 0xc6: return this.binary(this.uint(4));
      case 0xc7: return this.extended(this.uint(1));
      case 0xc8: return this.extended(this.uint(2));
      case 0xc9: return this.extended(this.uint(4));
      case 0xca: return this.view.getFloat32(this.take(4));
      case 0xcb: return this.view.getFloat64(this.take(8));
      case 0xcc: return this.uint(1);
      case 0xcd: return this.uint(2);
      case 0xce: return this.uint(4);
      case 0xcf: return narrowed(this.view.getBigUint64(this.take(8)));
      case 0xd0: return this.view.getInt8(this.take(1));
      case 0xd1: return this.view.getInt16(this.take(2));
      case 0xd2: return this.view.getInt32(this.take(4));
      case 0xd3: return narrowed(this.view.getBigInt64(this.take(8)));
      case 0xd4: return this.extended(1);
      case 0xd5: return this.extended(2);
      case 0xd6: return this.extended(4);
      case 0xd7: return this.extended(8);
      case 0xd8: return this.extended(16);
      case 0xd9: return this.string(this.uint(1));
      case 0xda: return this.string(this.uint(2));
      case 0xdb: return this.string(this.uint(4));
      case 0xdc: return this.list(this.uint(2));
      case 0xdd: return this.list(this.uint(4));
      case 0xde: return this.map(this.uint(2));
      case 0xdf: return this.map(this.uint(4));
      default:
        throw new DecodeError(`byte c1 at offset ${this.position - 1} is not MessagePack`);
    }
  }

  /** @param {1|2|4} size @returns {number} */
  uint(size) {
    const start = this.take(size);
    if (size === 1) return this.bytes[start];
    return size === 2 ? this.view.getUint16(start) : this.view.getUint32(start);
  }

  /** @param {number} length @returns {string} */
  string(length) {
    const start = this.take(length);
    const bytes = this.bytes.subarray(start, start + length);
    if (length <= 24 && bytes.every((byte) => byte < 0x80)) return String.fromCharCode(...bytes);
    try {
      return utf8.decode(bytes);
    } catch (error) {
      throw new DecodeError(`the string at offset ${start} is not UTF-8`, { cause: error });
    }
  }

  /** @param {number} length @returns {Uint8Array} */
  binary(length) {
    const start = this.take(length);
    return this.bytes.subarray(start, start + length);
  }

  /** @param {number} length @returns {any} */
  extended(length) {
    const code = this.view.getInt8(this.take(1));
    const start = this.take(length);
    return this.nested(() => this.extension(code, start, start + length, this.depth));
  }

  /** @param {number} length @returns {any[]} */
  list(length) {
    this.claim(length);
    return this.nested(() => {
      const items = [];
      for (let index = 0; index < length; index++) items.push(this.read());
      return items;
    });
  }

  /** @param {number} length @returns {Object<string, any> | Map<any, any>} */
  map(length) {
    this.claim(2 * length);
    return this.nested(() => {
      /** @type {[any, any][]} */
      const entries = [];
      for (let index = 0; index < length; index++) entries.push([this.read(), this.read()]);
      // fromEntries defines properties, so that a key `__proto__` is a key like any other.
      const plain = entries.every(([key]) => typeof key === "string");
      return plain ? Object.fromEntries(entries) : new Map(entries);
    });
  }

  /** Refuse a count of items that the bytes left cannot hold. @param {number} items */
  claim(items) {
    if (items > this.end - this.position) {
      throw new DecodeError(
        `${items} values are claimed at offset ${this.position}, ${this.end - this.position} bytes are left`,
      );
    }
  }

  /** @template T @param {() => T} read @returns {T} */
  nested(read) {
    if (++this.depth > MAX_DEPTH) throw new DecodeError(`nested more than ${MAX_DEPTH} deep`);
    const value = read();
    this.depth--;
    return value;
  }
}

/** @param {bigint} value @returns {number | bigint} */
function narrowed(value) {
  const number = Number(value);
  return Number.isSafeInteger(number) ? number : value;
}

/** @param {unknown} value @returns {value is number | bigint} */
function isInteger(value) {
  return typeof value === "bigint" || Number.isSafeInteger(value);
}

/* ------------------------------------------------------------------------------------ arrays */

/**
 * @typedef {Object} VertebraArray
 * @property {string} dtype NumPy type string, for example `<f4`
 * @property {number[]} shape items along each axis, in C order; `[]` is a scalar
 * @property {any} data a typed array: a view of the received bytes wherever alignment and byte
 *   order allow; for item types that JavaScript has no typed array for, the bytes as Uint8Array
 */

/** @type {Record<string, any>} */
const TYPED_ARRAYS = {
  b1: Uint8Array, u1: Uint8Array, i1: Int8Array, u2: Uint16Array, i2: Int16Array,
  u4: Uint32Array, i4: Int32Array, u8: BigUint64Array, i8: BigInt64Array,
  f4: Float32Array, f8: Float64Array,
};
const DTYPE = /^([<>|])([biufcmMSUV])([0-9]{1,9})(\[[A-Za-z0-9]+\])?$/;
const HOST_ORDER = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1 ? "<" : ">";

/** @param {string} dtype @param {number[]} shape @returns {number} */
function arrayBytes(dtype, shape) {
  const match = DTYPE.exec(dtype);
  if (!match) {
    throw new DecodeError(
      `'${dtype}' is not a fixed-size array type such as '<f8' or '|u1'`,
    );
  }
  if (shape.length > MAX_AXES) {
    throw new DecodeError(`an array has at most ${MAX_AXES} axes, not ${shape.length}`);
  }
  const shortest = Math.min(...shape, 0);
  if (shortest < 0) throw new DecodeError(`an array has no axis of length ${shortest}`);
  if (shape.includes(0)) return 0;
  const itemBytes = Number(match[3]) * (match[2] === "U" ? 4 : 1);
  return shape.reduce((product, length) => product * length, itemBytes);
}

/** @param {Uint8Array} bytes @param {string} dtype @returns {any} */
function typedArray(bytes, dtype) {
  const Type = TYPED_ARRAYS[dtype.slice(1)];
  if (!Type) return bytes;
  const swapped = dtype[0] !== "|" && dtype[0] !== HOST_ORDER;
  const size = Type.BYTES_PER_ELEMENT;
  if (!swapped && bytes.byteOffset % size === 0) {
    return new Type(bytes.buffer, bytes.byteOffset, bytes.byteLength / size);
  }
  const copy = bytes.slice();
  if (swapped) {
    for (let start = 0; start < copy.length; start += size) {
      copy.subarray(start, start + size).reverse();
    }
  }
  return new Type(copy.buffer);
}

/* ------------------------------------------------------------------------------------- frame */

/**
 * @typedef {Object} Frame
 * @property {string} schema for example `vertebra/Image/1`
 * @property {bigint} captured_ns when the content was true (UTC, nanoseconds since 1970)
 * @property {number | bigint} sequence
 * @property {string} origin
 * @property {number | bigint} hops
 * @property {Object<string, any>} message the fields; arrays are `VertebraArray`, values of Python
 *   libraries `{tag, plain}`
 */

/**
 * Decode a Vertebra frame (FRAME.md). The fields are not checked against their schema: look at
 * `schema` before you use them; fields that hold their default may be absent.
 *
 * @param {ArrayBuffer | Uint8Array} payload
 * @returns {Frame}
 * @throws {DecodeError} the frame is damaged; the text says what is wrong where
 */
export function decodeFrame(payload) {
  const bytes = payload instanceof Uint8Array ? payload : new Uint8Array(payload);
  const total = bytes.byteLength;
  const magic = hex(bytes.subarray(0, 4));
  if (magic !== "56 54 42 01") {
    throw new DecodeError(`a frame begins with 56 54 42 01, found ${magic || "nothing"}`);
  }
  if (total < 8) throw new DecodeError(`a frame has at least 8 bytes, found ${total}`);
  const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(4, true);
  if (length > Math.min(MAX_HEADER_BYTES, total - 8)) {
    throw new DecodeError(
      `the header claims ${length} bytes at offset 8, the frame has ${total} bytes in all ` +
        `and the limit is ${MAX_HEADER_BYTES}`,
    );
  }
  const references = new ArrayReferences(bytes);
  const header = readHeader(bytes, length, references);
  const buffers = splitBuffers(bytes, 8 + length, header.buffers);
  explained(fieldsOf(header.schema), () => references.resolve(buffers));
  return {
    schema: header.schema,
    captured_ns: BigInt(header.captured_ns),
    sequence: header.sequence,
    origin: header.origin,
    hops: header.hops,
    message: header.fields,
  };
}

/** Arrays that were met inside the fields before the table of buffers was known. */
class ArrayReferences {
  /** @param {Uint8Array} bytes */
  constructor(bytes) {
    this.bytes = bytes;
    /** @type {{index: number | bigint, array: VertebraArray}[]} */
    this.met = [];
  }

  /** @param {number} code @param {number} start @param {number} end @param {number} depth */
  extension(code, start, end, depth) {
    if (code !== 1 && code !== 2) throw new DecodeError(`unknown extension type ${code}`);
    const reader = new MessagePackReader(
      this.bytes, start, end, (...place) => this.extension(...place), depth,
    );
    const body = reader.read();
    reader.finish();
    return code === 1 ? this.meet(body, start) : foreignOf(body, start);
  }

  /** @param {any} body @param {number} start @returns {VertebraArray} */
  meet(body, start) {
    const [index, dtype, shape] = Array.isArray(body) && body.length === 3 ? body : [];
    const lengths = Array.isArray(shape) && shape.every(isInteger) ? shape.map(Number) : null;
    if (!isInteger(index) || typeof dtype !== "string" || !lengths) {
      throw new DecodeError(`the array at offset ${start} is not [index, dtype, shape]`);
    }
    const array = { dtype, shape: lengths, data: null };
    this.met.push({ index, array });
    return array;
  }

  /** Give every array its buffer. @param {Uint8Array[]} buffers */
  resolve(buffers) {
    const unused = new Set(buffers.keys());
    for (const { index, array } of this.met) {
      if (!unused.delete(Number(index))) {
        throw new DecodeError(`buffer ${index} does not exist or is used twice`);
      }
      const bytes = buffers[Number(index)];
      const expected = arrayBytes(array.dtype, array.shape);
      if (bytes.byteLength !== expected) {
        throw new DecodeError(
          `an array of type '${array.dtype}' and shape (${array.shape}) has ${expected} bytes, ` +
            `not ${bytes.byteLength}`,
        );
      }
      array.data = typedArray(bytes, array.dtype);
    }
    if (unused.size) {
      const [first] = unused;
      throw new DecodeError(`buffer ${first} of ${buffers.length} is not used by any array`);
    }
  }
}

/** @param {any} body @param {number} start */
function foreignOf(body, start) {
  if (!Array.isArray(body) || body.length !== 2 || typeof body[0] !== "string") {
    throw new DecodeError(`the value at offset ${start} is not [tag, plain]`);
  }
  return { tag: body[0], plain: body[1] };
}

/** @param {Uint8Array} bytes @param {number} length @param {ArrayReferences} references */
function readHeader(bytes, length, references) {
  const ignore = () => null;
  const reader = new MessagePackReader(bytes, 8, 8 + length, ignore);
  /** @type {Record<string, any>} */
  const header = Object.create(null); // so that `__proto__` is a key like any other
  Object.assign(header, { captured_ns: 0, sequence: 0, origin: "", hops: 0, buffers: [] });
  const readEntry = () => {
    const key = reader.read();
    if (typeof key !== "string") throw new DecodeError("a key is not a string");
    if (key !== "fields") header[key] = reader.read();
    return key;
  };
  const readFields = () => {
    reader.extension = (...place) => references.extension(...place);
    header.fields = reader.read();
    reader.extension = ignore;
    if (header.fields === null || Object.getPrototypeOf(header.fields) !== Object.prototype) {
      throw new DecodeError("they are not a map with string keys");
    }
  };
  for (let left = explained("the header", () => readMapLength(reader)); left > 0; left--) {
    const key = explained("the header", readEntry);
    if (key === "fields") explained(fieldsOf(header.schema), readFields);
  }
  explained("the header", () => {
    reader.finish();
    checkHeader(header);
  });
  return header;
}

/** @param {Record<string, any>} header */
function checkHeader(header) {
  for (const key of ["schema", "origin"]) {
    if (typeof header[key] !== "string") throw new DecodeError(`${key} is not a string`);
  }
  for (const key of ["captured_ns", "sequence", "hops"]) {
    if (!isInteger(header[key])) throw new DecodeError(`${key} is not an integer`);
  }
  if (!Array.isArray(header.buffers) || !header.buffers.every(isInteger)) {
    throw new DecodeError("buffers is not a list of integers");
  }
  if (header.fields === undefined) throw new DecodeError("fields are missing");
}

/** @param {MessagePackReader} reader @returns {number} */
function readMapLength(reader) {
  const code = reader.bytes[reader.take(1)];
  if ((code & 0xf0) === 0x80) return code & 0x0f;
  if (code === 0xde) return reader.uint(2);
  if (code === 0xdf) return reader.uint(4);
  throw new DecodeError(`a map was expected, found byte ${code.toString(16)}`);
}

/** @param {Uint8Array} bytes @param {number} position @param {(number | bigint)[]} lengths */
function splitBuffers(bytes, position, lengths) {
  if (lengths.length > MAX_BUFFERS) {
    throw new DecodeError(`${lengths.length} buffers, the limit is ${MAX_BUFFERS}`);
  }
  const total = bytes.byteLength;
  const buffers = lengths.map((length, index) => {
    const start = Math.ceil(position / ALIGNMENT) * ALIGNMENT;
    if (length < 0 || Number(length) > total - start) {
      throw new DecodeError(
        `buffer ${index} claims ${length} bytes at offset ${start}, the frame ends at ${total}`,
      );
    }
    if (bytes.subarray(position, start).some((byte) => byte !== 0)) {
      throw new DecodeError(`the padding before buffer ${index} is not zero`);
    }
    position = start + Number(length);
    return bytes.subarray(start, position);
  });
  if (position !== total) {
    throw new DecodeError(`the frame ends at ${position}, but ${total} bytes were given`);
  }
  return buffers;
}

/** @param {unknown} schema */
function fieldsOf(schema) {
  return `the fields of this ${typeof schema === "string" ? schema : "message"}`;
}

/** Say what it was that could not be read. @template T @param {string} what @param {() => T} read */
function explained(what, read) {
  try {
    return read();
  } catch (error) {
    if (!(error instanceof DecodeError)) throw error;
    throw new DecodeError(`${what} cannot be read: ${error.message}`, { cause: error });
  }
}

/** @param {Uint8Array} bytes */
function hex(bytes) {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join(" ");
}

/* ------------------------------------------------------------------------- data of the gateway */

/**
 * Take a binary message of the gateway apart: the subscription, the head and the payload.
 *
 * @param {ArrayBuffer} buffer
 * @returns {{id: number, head: Object<string, any>, payload: Uint8Array}}
 * @throws {DecodeError}
 */
export function decodeData(buffer) {
  const total = buffer.byteLength;
  if (total < 8) throw new DecodeError(`a data message has at least 8 bytes, found ${total}`);
  const view = new DataView(buffer);
  const length = view.getUint32(4, true);
  const start = Math.ceil((8 + length) / ALIGNMENT) * ALIGNMENT;
  if (start > total) {
    throw new DecodeError(`the head claims ${length} bytes, the data message has ${total}`);
  }
  const head = parseJson(utf8Text(new Uint8Array(buffer, 8, length)));
  return { id: view.getUint32(0, true), head, payload: new Uint8Array(buffer, start) };
}

/** @param {Uint8Array} bytes */
function utf8Text(bytes) {
  try {
    return utf8.decode(bytes);
  } catch (error) {
    throw new DecodeError("this text is not UTF-8", { cause: error });
  }
}

/** @param {string} text */
function parseJson(text) {
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new DecodeError(`this is not JSON: ${text.slice(0, 80)}`, { cause: error });
  }
}

/** Nanoseconds are strings in JSON. @param {unknown} text @returns {bigint} 0 if unknown */
function nanoseconds(text) {
  try {
    return BigInt(/** @type {any} */ (text ?? 0));
  } catch (error) {
    throw new DecodeError(`${JSON.stringify(text)} is no number of nanoseconds`, { cause: error });
  }
}

/**
 * @typedef {Object} Sample
 * @property {string} key
 * @property {string} encoding how the payload was written
 * @property {bigint} sent_ns when it was put on the backbone
 * @property {bigint} captured_ns when it was true; 0 if its encoding does not say
 * @property {string} schema empty if its encoding does not say
 * @property {any} message the fields of a frame; parsed JSON; text; otherwise null
 * @property {Uint8Array} payload the bytes as they came, for example a JPEG file
 * @property {number} age_ms how old it was when it arrived; NaN if unknown
 */

/** @param {Object<string, any>} head @param {Uint8Array} payload @returns {Sample} */
function sampleOf(head, payload) {
  const sample = {
    key: String(head.key),
    encoding: String(head.encoding ?? ""),
    sent_ns: nanoseconds(head.sent_ns),
    captured_ns: nanoseconds(head.captured_ns),
    schema: "",
    message: null,
    payload,
    age_ms: NaN,
  };
  const media = sample.encoding.split(";")[0].trim();
  if (media === FRAME_ENCODING) {
    const { schema, captured_ns, message } = decodeFrame(payload);
    return { ...sample, schema, captured_ns, message };
  }
  if (media === "application/json") {
    const document = parseJson(utf8Text(payload));
    if (typeof document?.schema !== "string") return { ...sample, message: document };
    const { schema, captured_ns, message } = document;
    return { ...sample, schema, captured_ns: nanoseconds(captured_ns), message };
  }
  if (media === "text/plain") return { ...sample, message: utf8Text(payload) };
  return sample;
}

/* ------------------------------------------------------------------------------------- images */

/**
 * Writers of one row-major RGBA word per pixel, for little-endian hosts as all browsers have.
 * @type {Record<string, (out: Uint32Array, pixels: Uint8Array) => void>}
 */
const PIXEL_WRITERS = {
  rgb8(out, pixels) {
    for (let i = 0, j = 0; i < out.length; i++, j += 3) {
      out[i] = 0xff000000 | (pixels[j + 2] << 16) | (pixels[j + 1] << 8) | pixels[j];
    }
  },
  bgr8(out, pixels) {
    for (let i = 0, j = 0; i < out.length; i++, j += 3) {
      out[i] = 0xff000000 | (pixels[j] << 16) | (pixels[j + 1] << 8) | pixels[j + 2];
    }
  },
  mono8(out, pixels) {
    for (let i = 0; i < out.length; i++) out[i] = 0xff000000 | (pixels[i] * 0x010101);
  },
  bgra8(out, pixels) {
    for (let i = 0, j = 0; i < out.length; i++, j += 4) {
      out[i] =
        (pixels[j + 3] << 24) | (pixels[j] << 16) | (pixels[j + 1] << 8) | pixels[j + 2];
    }
  },
  rgba8(out, pixels) {
    new Uint8Array(out.buffer).set(pixels);
  },
};

/** Pixels of the image that each canvas showed last, to be written over. */
const drawn = new WeakMap();

/**
 * Draw the message of an `Image` and give the canvas its size.
 *
 * @param {HTMLCanvasElement | OffscreenCanvas} canvas
 * @param {Object<string, any>} message fields of a `vertebra/Image/1`
 * @throws {VertebraError} a pixel format without a picture, or no pixels
 */
export function drawImage(canvas, message) {
  const write = PIXEL_WRITERS[message.pixel_format];
  if (!write) {
    throw new VertebraError(
      `images of pixel format '${message.pixel_format}' cannot be drawn, ` +
        `only ${Object.keys(PIXEL_WRITERS).join(", ")}`,
    );
  }
  const [height, width] = message.pixels.shape;
  const channels = message.pixel_format === "mono8" ? 1 : message.pixel_format.length - 1;
  if (!(width > 0 && height > 0) || message.pixels.data.length !== width * height * channels) {
    throw new VertebraError(
      `an image of shape (${message.pixels.shape}) and format '${message.pixel_format}' ` +
        "cannot be drawn",
    );
  }
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
  let image = drawn.get(canvas);
  if (image?.width !== width || image?.height !== height) {
    image = new ImageData(width, height);
    drawn.set(canvas, image);
  }
  write(new Uint32Array(image.data.buffer), message.pixels.data);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.putImageData(image, 0, 0);
}

/* ------------------------------------------------------------------------------------- client */

const PING_PERIOD_MS = 1000;
const SILENCE_LIMIT_MS = 3000;
const RETRY_FIRST_MS = 250;
const RETRY_LIMIT_MS = 1500;
const STABLE_MS = 5000;
const CONNECT_LIMIT_MS = 5000;
const ROBOTS_LIMIT_S = 5;

/** @returns {number} milliseconds since 1970, with fractions */
function nowMs() {
  return performance.timeOrigin + performance.now();
}

/**
 * One subscription. It outlives connections: after each reconnect it is made again.
 * Counters grow over all of them.
 */
export class Subscription {
  /**
   * @param {Vertebra} client
   * @param {number} id
   * @param {string} key
   * @param {SubscribeOptions} options
   * @param {(sample: Sample) => void | Promise<void>} callback
   */
  constructor(client, id, key, options, callback) {
    this.id = id;
    this.key = key;
    this.options = options;
    this.callback = callback;
    /** @type {"waiting" | "active" | "refused" | "closed"} */
    this.state = "waiting";
    /** @type {VertebraError | null} what the gateway objected to last */
    this.error = null;
    /** How many samples arrived. */
    this.received = 0;
    /** Capture time of the newest sample; 0 before the first. @type {bigint} */
    this.captured_ns = 0n;
    this.countsOfConnection = { dropped: 0, lost: 0 };
    this.countsBefore = { dropped: 0, lost: 0 };
    this.client = client;
  }

  get closed() {
    return this.state === "closed";
  }

  /** How many samples the gateway let go because this side is slow. */
  get dropped() {
    return this.countsBefore.dropped + this.countsOfConnection.dropped;
  }

  /** How many samples never reached the gateway. */
  get lost() {
    return this.countsBefore.lost + this.countsOfConnection.lost;
  }

  /** How old the newest sample is now; NaN if there is none or it does not say. */
  get ageMs() {
    return this.client.ageMs(this.captured_ns);
  }

  /** End it; harmless when repeated. */
  close() {
    this.client.unsubscribe(this);
  }
}

/**
 * @typedef {Object} SubscribeOptions
 * @property {"latest" | "queue"} [delivery] newest only, or everything in order
 * @property {number} [depth] how many samples the gateway keeps for a slow reader
 * @property {number} [maxRateHz]
 * @property {number} [window] how many samples may be under way that the callback has not dealt
 *   with; 4 by default, 64 with delivery `queue`; 1 is right for pictures
 * @property {"frame" | "json" | "jpeg"} [form]
 *
 * @typedef {Object} ClientOptions
 * @property {string} [url] of the gateway's WebSocket; this page's `/ws` by default
 * @property {string} [token] not needed where the browser has the gateway's cookie
 * @property {any} [WebSocket] a constructor, where there is no global one (Node 20)
 * @property {typeof fetch} [fetch] used to see whether a lost gateway is back
 *
 * @typedef {"closed" | "connecting" | "open" | "waiting"} State
 */

/**
 * A connection to the gateway that comes back by itself.
 *
 * Events (what they are about is in `detail`):
 * - `state` `{state, reason, retryMs}`: `connecting`, `open`, `waiting` (to try again), `closed`;
 * - `robots` `Robot[]`: after connecting, and whenever a robot comes, goes or changes;
 * - `error` `VertebraError`: everything that concerns no promise. It is also written to the console,
 *   unless a listener calls `preventDefault()`.
 */
export class Vertebra extends EventTarget {
  /** @type {State} */ state = "closed";
  /** Why the state is what it is. */
  reason = "not connected yet";
  /** Gateway's clock minus ours, and the round trip it was measured with. */
  clock = { offset_ms: 0, round_trip_ms: NaN };

  /** @type {any} */ #socket = null;
  #nextId = 1;
  #attempts = 0;
  #openedAt = 0;
  #heardAt = 0;
  /** @type {any[] | null} */ #robots = null;
  /** @type {Map<number, Subscription>} */ #subscriptions = new Map();
  /** @type {Map<number, Pending>} */ #calls = new Map();
  /** @type {Map<number, number>} */ #pings = new Map();
  /** @type {any} */ #retryTimer = null;
  /** @type {any} */ #aliveTimer = null;

  /** @param {ClientOptions} [options] */
  constructor(options = {}) {
    super();
    this.url = options.url ?? defaultUrl();
    this.protocols = options.token ? ["vertebra.v1", `token.${options.token}`] : ["vertebra.v1"];
    this.WebSocket = options.WebSocket ?? globalThis.WebSocket;
    this.fetch = options.fetch ?? ((...request) => globalThis.fetch(...request));
    if (!this.WebSocket) {
      throw new VertebraError("there is no WebSocket here: pass a constructor as option WebSocket");
    }
  }

  /**
   * Connect, and stay connected until `close()`.
   *
   * @returns {Promise<void>} settled when the connection is open, or was given up by `close()`
   */
  connect() {
    if (this.state === "closed") {
      this.#attempts = 0;
      this.#open();
    }
    if (this.state === "open") return Promise.resolve();
    return new Promise((resolve, reject) => {
      const settle = () => {
        if (this.state === "open") resolve();
        else if (this.state === "closed") reject(new NotConnectedError(this.reason));
        else return;
        this.removeEventListener("state", settle);
      };
      this.addEventListener("state", settle);
    });
  }

  /** Disconnect for good; calls that wait are rejected. Harmless when repeated. */
  close() {
    if (this.state === "closed") return;
    this.#release("closed by this page");
    this.#enter("closed", "closed by this page");
  }

  /**
   * Return the robots as the gateway describes them now.
   *
   * @returns {Promise<Object<string, any>[]>}
   */
  async robots() {
    if (this.#robots) return this.#robots;
    if (this.state !== "open") throw this.#refusal("the list of robots");
    return this.#wait("robots", "the list of robots", ROBOTS_LIMIT_S);
  }

  /**
   * Receive what is published on a key expression, now and after every reconnect.
   * First comes the newest that the gateway has, however old. While `callback` is busy (or the
   * promise that it returns is pending) the gateway keeps the newest samples back, as `options`
   * say, instead of piling them up here.
   *
   * @param {string} key
   * @param {SubscribeOptions} options
   * @param {(sample: Sample) => void | Promise<void>} callback
   * @returns {Subscription}
   */
  subscribe(key, options, callback) {
    const subscription = new Subscription(this, this.#nextId++, key, options, callback);
    this.#subscriptions.set(subscription.id, subscription);
    if (this.state === "open") this.#sendSubscribe(subscription);
    return subscription;
  }

  /** @param {Subscription} subscription */
  unsubscribe(subscription) {
    if (subscription.closed) return;
    const known = subscription.state !== "refused" && this.state === "open";
    subscription.state = "closed";
    // The entry stays until the gateway confirms: data that are under way still belong to it.
    if (known) this.#send({ op: "unsubscribe", id: subscription.id });
    else this.#subscriptions.delete(subscription.id);
  }

  /**
   * Call a resource of a robot and return its answer: what the robot did.
   *
   * @param {string} robot
   * @param {string} path
   * @param {any} [body]
   * @param {{timeoutS?: number}} [options]
   * @returns {Promise<any>}
   * @throws {ProblemError} the gateway or the robot refused it, for example status 422
   * @throws {NotConnectedError} it was not sent, or the connection broke before the answer
   * @throws {DeadlineError} no answer in time
   */
  async call(robot, path, body, { timeoutS = 10 } = {}) {
    const what = `${robot}/${path}`;
    if (this.state !== "open") throw this.#refusal(what);
    const id = this.#nextId++;
    this.#send({ op: "call", id, robot, path, body, timeout_s: timeoutS });
    // The gateway answers 504 itself; ours comes a little later, if that gets lost.
    return this.#wait(id, what, timeoutS + 1);
  }

  /**
   * @param {bigint} captured_ns
   * @returns {number} how old something is, by the gateway's clock; NaN for 0
   */
  ageMs(captured_ns) {
    if (!captured_ns) return NaN;
    return nowMs() + this.clock.offset_ms - Number(captured_ns / 1000n) / 1000;
  }

  /* ---- the connection */

  #open() {
    this.#enter("connecting", `connecting to ${this.url}`);
    let socket;
    try {
      socket = new this.WebSocket(this.url, this.protocols);
    } catch (error) {
      this.#lose(`${this.url} cannot be opened: ${messageOf(error)}`);
      return;
    }
    this.#socket = socket;
    socket.binaryType = "arraybuffer";
    const mine = (/** @type {(event: any) => void} */ handle) => (/** @type {any} */ event) => {
      if (this.#socket === socket) handle(event);
    };
    socket.onopen = mine(() => this.#opened());
    socket.onmessage = mine((event) => this.#received(event.data));
    socket.onclose = mine((event) => this.#lose(this.#reasonOf(event)));
    this.#heardAt = nowMs();
    this.#aliveTimer = setInterval(() => this.#checkAlive(), PING_PERIOD_MS);
  }

  #opened() {
    this.#openedAt = this.#heardAt = nowMs();
    this.#enter("open", `connected to ${this.url}`);
    for (const subscription of this.#subscriptions.values()) this.#sendSubscribe(subscription);
    this.#ping();
  }

  /** @param {{code: number, reason: string}} event */
  #reasonOf(event) {
    if (this.state === "connecting") {
      return `no connection to ${this.url}: the gateway is down, or refuses this token or origin`;
    }
    const why = event.reason || (event.code === 1006 ? "it broke" : "no reason was given");
    return `the connection was lost: ${why} (code ${event.code})`;
  }

  #checkAlive() {
    const silent_ms = nowMs() - this.#heardAt;
    if (this.state === "connecting") {
      if (silent_ms > CONNECT_LIMIT_MS) this.#lose(`${this.url} does not answer`);
    } else if (this.#pings.size && silent_ms > SILENCE_LIMIT_MS) {
      this.#lose(`the gateway has been silent for ${Math.round(silent_ms / 1000)} s`);
    } else {
      this.#ping();
    }
  }

  #ping() {
    const id = this.#nextId++;
    this.#pings.set(id, nowMs());
    this.#send({ op: "ping", id, client_ns: String(BigInt(Math.round(nowMs() * 1000)) * 1000n) });
  }

  /** Free what belongs to the present connection. @param {string} reason */
  #release(reason) {
    clearTimeout(this.#retryTimer);
    clearInterval(this.#aliveTimer);
    const socket = this.#socket;
    this.#socket = null;
    this.#robots = null;
    this.#pings.clear();
    socket?.close();
    for (const pending of [...this.#calls.values()]) {
      const doubt = "whether it was done is not known";
      pending.reject(new NotConnectedError(`${pending.what} was not answered (${doubt}): ${reason}`));
    }
    for (const subscription of [...this.#subscriptions.values()]) {
      if (subscription.closed) this.#subscriptions.delete(subscription.id);
      else if (subscription.state === "active") subscription.state = "waiting";
      subscription.countsBefore = { dropped: subscription.dropped, lost: subscription.lost };
      subscription.countsOfConnection = { dropped: 0, lost: 0 };
    }
  }

  /** @param {string} reason */
  #lose(reason) {
    const lasted = this.state === "open" && nowMs() - this.#openedAt > STABLE_MS;
    this.#release(reason);
    this.#attempts = lasted ? 1 : this.#attempts + 1;
    const limit_ms = Math.min(RETRY_FIRST_MS * 2 ** (this.#attempts - 1), RETRY_LIMIT_MS);
    const retryMs = limit_ms * (0.5 + Math.random() / 2);
    this.#retryTimer = setTimeout(() => this.#retry(), retryMs);
    this.#enter("waiting", reason, retryMs);
  }

  async #retry() {
    // Chromium holds back WebSockets to a host that failed many of them, by up to five seconds
    // (WebSocketPerProcessThrottler), so ask with a plain request whether anybody is there first.
    const url = new URL("healthz", this.url.replace(/^ws/, "http"));
    const timer = this.#retryTimer;
    try {
      const signal = AbortSignal.timeout(CONNECT_LIMIT_MS);
      await this.fetch(url, { mode: "no-cors", cache: "no-store", signal });
    } catch (error) {
      if (this.#retryTimer === timer && this.state === "waiting") {
        this.#lose(`the gateway at ${url.origin} does not answer: ${messageOf(error)}`);
      }
      return;
    }
    if (this.#retryTimer === timer && this.state === "waiting") this.#open();
  }

  /** @param {State} state @param {string} reason @param {number} [retryMs] */
  #enter(state, reason, retryMs) {
    this.state = state;
    this.reason = reason;
    this.dispatchEvent(new CustomEvent("state", { detail: { state, reason, retryMs } }));
  }

  /** @param {string} what */
  #refusal(what) {
    return new NotConnectedError(`${what} was not asked for: ${this.reason}`);
  }

  /** @param {Object<string, any>} message */
  #send(message) {
    this.#socket.send(JSON.stringify(message));
  }

  /** @param {Subscription} subscription */
  #sendSubscribe(subscription) {
    const { delivery, depth, maxRateHz, form } = subscription.options;
    const { id, key } = subscription;
    const window = subscription.options.window ?? (delivery === "queue" ? 64 : 4);
    this.#send({ op: "subscribe", id, key, delivery, depth, max_rate_hz: maxRateHz, form, window });
  }

  /**
   * @param {number | "robots"} id
   * @param {string} what
   * @param {number} timeoutS
   * @returns {Promise<any>}
   */
  #wait(id, what, timeoutS) {
    return new Promise((resolve, reject) => {
      const pending = new Pending(what, resolve, reject, () => this.#calls.delete(key));
      const key = id === "robots" ? this.#nextId++ : id;
      pending.robots = id === "robots";
      pending.expireAfter(timeoutS);
      this.#calls.set(key, pending);
    });
  }

  /* ---- what the gateway sends */

  /** @param {string | ArrayBuffer} data */
  async #received(data) {
    this.#heardAt = nowMs();
    try {
      if (typeof data === "string") this.#receivedControl(parseJson(data));
      else await this.#receivedData(data);
    } catch (error) {
      this.#report(error);
    }
  }

  /** @param {Object<string, any>} message */
  #receivedControl(message) {
    const subscription = this.#subscriptions.get(message.id);
    switch (message.op) {
      case "robots":
        this.#receivedRobots(message.robots);
        break;
      case "pong":
        this.#receivedPong(message);
        break;
      case "reply":
        this.#calls.get(message.id)?.resolve(message.body);
        break;
      case "subscribed":
        if (subscription?.state === "waiting") subscription.state = "active";
        break;
      case "unsubscribed":
        this.#subscriptions.delete(message.id);
        break;
      case "drops":
        if (subscription) {
          const { dropped, lost } = message;
          subscription.countsOfConnection = { dropped, lost };
        }
        break;
      case "error":
        this.#receivedError(message, subscription);
        break;
      default:
        throw new DecodeError(`the gateway sent an unknown message: ${JSON.stringify(message)}`);
    }
  }

  /** @param {any[]} robots */
  #receivedRobots(robots) {
    this.#robots = robots;
    for (const pending of [...this.#calls.values()]) {
      if (pending.robots) pending.resolve(robots);
    }
    this.dispatchEvent(new CustomEvent("robots", { detail: robots }));
  }

  /** @param {Object<string, any>} message */
  #receivedPong(message) {
    const sentAt = this.#pings.get(message.id);
    if (sentAt === undefined) throw new DecodeError(`an answer to a ping never sent: ${message.id}`);
    this.#pings.delete(message.id);
    const round_trip_ms = nowMs() - sentAt;
    const server_ms = Number(nanoseconds(message.server_ns) / 1000n) / 1000;
    const offset_ms = server_ms - (sentAt + round_trip_ms / 2);
    // The quickest round trip measures best. It counts less as it ages, for clocks drift.
    const known_ms = this.clock.round_trip_ms * 1.05;
    if (!(known_ms < round_trip_ms)) this.clock = { offset_ms, round_trip_ms };
    else this.clock = { ...this.clock, round_trip_ms: known_ms };
  }

  /** @param {Object<string, any>} problem @param {Subscription | undefined} subscription */
  #receivedError(problem, subscription) {
    const error = new ProblemError(problem);
    const pending = this.#calls.get(problem.id);
    if (pending) {
      pending.reject(error);
      return;
    }
    if (subscription) {
      // Once it is made, an error concerns samples that have no such form; better ones may follow.
      error.message = `the subscription to ${subscription.key}: ${error.message}`;
      if (subscription.state === "waiting") subscription.state = "refused";
      subscription.error = error;
    }
    this.#report(error);
  }

  /** @param {ArrayBuffer} data */
  async #receivedData(data) {
    const socket = this.#socket;
    const { id, head, payload } = decodeData(data);
    const subscription = this.#subscriptions.get(id);
    if (!subscription) throw new DecodeError(`data for subscription ${id}, which was never made`);
    if (subscription.closed) return;
    subscription.received++;
    subscription.countsOfConnection.dropped = head.dropped ?? 0;
    try {
      const sample = sampleOf(head, payload);
      sample.age_ms = this.ageMs(sample.captured_ns);
      subscription.captured_ns = sample.captured_ns;
      await subscription.callback(sample);
    } catch (error) {
      throw new VertebraError(`a sample of ${head.key}: ${messageOf(error)}`, { cause: error });
    } finally {
      if (this.#socket === socket && !subscription.closed) this.#send({ op: "ack", id });
    }
  }

  /** @param {any} error */
  #report(error) {
    const event = new CustomEvent("error", { detail: error, cancelable: true });
    if (this.dispatchEvent(event)) console.error(error);
  }
}

/** An answer that is waited for; it settles once, and forgets itself and its timer then. */
class Pending {
  robots = false;
  /** @type {any} */ #timer = null;

  /**
   * @param {string} what
   * @param {(value: any) => void} resolve
   * @param {(error: Error) => void} reject
   * @param {() => void} forget
   */
  constructor(what, resolve, reject, forget) {
    this.what = what;
    const settle = () => {
      clearTimeout(this.#timer);
      forget();
    };
    this.resolve = (/** @type {any} */ value) => (settle(), resolve(value));
    this.reject = (/** @type {Error} */ error) => (settle(), reject(error));
  }

  /** @param {number} timeoutS */
  expireAfter(timeoutS) {
    const expire = () => this.reject(new DeadlineError(`no answer from ${this.what} in ${timeoutS} s`));
    this.#timer = setTimeout(expire, timeoutS * 1000);
  }
}

function defaultUrl() {
  if (!globalThis.location) throw new VertebraError("there is no page here: pass option url");
  const url = new URL("ws", globalThis.location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url.href;
}

/** @param {unknown} error */
function messageOf(error) {
  return error instanceof Error ? error.message : String(error);
}
