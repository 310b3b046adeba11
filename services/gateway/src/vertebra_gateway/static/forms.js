// Calls on the dashboard that have no control of their own: a form from the JSON Schema of their input.

/** The value of a control that may be empty: undefined then. */
function valueOf(control) {
  if (control.type === "checkbox") return control.checked;
  if (control.value === "") return undefined;
  return control.type === "number" ? control.valueAsNumber : control.value;
}

function number(schema, limit = {}) {
  const input = document.createElement("input");
  input.type = "number";
  input.step = "any";
  const low = limit.min ?? schema.minimum;
  const high = limit.max ?? schema.maximum;
  if (low !== undefined && low !== null) input.min = low;
  if (high !== undefined && high !== null) input.max = high;
  if (input.min && input.max) input.placeholder = `${input.min} to ${input.max}`;
  if (schema.default !== undefined) input.value = schema.default;
  return input;
}

function choice(options, preset) {
  const select = document.createElement("select");
  for (const option of options) select.append(new Option(option, option, false, option === preset));
  return select;
}

/** A labelled control, or several in a row: a function that reads them, and what goes on the page. */
function row(name, unit, controls) {
  const element = document.createElement("div");
  element.className = "field";
  const label = document.createElement("span");
  label.textContent = unit ? `${name} (${unit})` : name;
  element.append(label, ...controls);
  controls.forEach((control, index) => {
    control.name = name;
    control.setAttribute("aria-label", controls.length > 1 ? `${name} ${index + 1}` : name);
  });
  return element;
}

/** @returns {{element: HTMLElement, read: () => any}} */
function field(name, schema, limits) {
  if (limits && schema.type === "object") {
    const joints = Object.entries(limits).map(([joint, limit]) => {
      const control = number({}, limit);
      return { joint, control, element: row(joint, limit.unit, [control]) };
    });
    const element = document.createElement("fieldset");
    const legend = document.createElement("legend");
    legend.textContent = name.replaceAll("_", " ");
    element.append(legend, ...joints.map((joint) => joint.element));
    const read = () => {
      const given = joints.filter(({ control }) => control.value !== "");
      return given.length ? Object.fromEntries(given.map(({ joint, control }) => [joint, control.valueAsNumber])) : undefined;
    };
    return { element, read };
  }
  const title = name.replaceAll("_", " ");
  if (schema.type === "object" && schema.properties) {
    const inside = fieldsOf(schema.properties, limits);
    const element = document.createElement("fieldset");
    const legend = document.createElement("legend");
    legend.textContent = title;
    element.append(legend, ...Object.values(inside).map((one) => one.element));
    return { element, read: () => valuesOf(inside) };
  }
  if (schema.type === "array") {
    const controls = Array.from({ length: schema.minItems ?? 1 }, () => number(schema.items ?? {}));
    const read = () => (controls.every(({ value }) => value !== "") ? controls.map((control) => control.valueAsNumber) : undefined);
    return { element: row(title, "", controls), read };
  }
  let control = document.createElement("input");
  const options = schema.enum ?? schema.examples;
  if (options) control = choice(options, schema.default);
  else if (schema.type === "boolean") Object.assign(control, { type: "checkbox", checked: schema.default ?? false });
  else if (schema.type === "number" || schema.type === "integer") control = number(schema);
  else if (schema.default !== undefined) control.value = schema.default;
  const element = row(title, "", [control]);
  if (schema.description) element.title = schema.description;
  return { element, read: () => valueOf(control) };
}

function fieldsOf(properties, limits) {
  return Object.fromEntries(
    Object.entries(properties).map(([name, schema]) => [name, field(name, schema, limits?.[name])]),
  );
}

/** What was filled in; undefined if nothing was. */
function valuesOf(fields) {
  const read = Object.entries(fields).map(([name, { read }]) => [name, read()]);
  const given = read.filter(([, value]) => value !== undefined);
  return given.length ? Object.fromEntries(given) : undefined;
}

/** A call that folds out to a form; its answer is what the robot did. */
export class FormCard {
  #shape = "";

  /**
   * @param {HTMLElement} element made from the form template
   * @param {any} resource
   * @param {(body: any) => Promise<any>} call
   */
  constructor(element, resource, call) {
    this.element = element;
    this.path = resource.path;
    this.call = call;
    this.form = element.querySelector("form");
    this.output = element.querySelector("output");
    element.dataset.path = resource.path;
    element.querySelector(".title").textContent = resource.path.replaceAll("/", " ").replaceAll("_", " ");
    element.querySelector(".description").textContent = resource.description;
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#send();
    });
    this.setLimits(resource);
  }

  /** Make the fields anew; nothing happens if they are those already there. */
  setLimits(resource) {
    const shape = JSON.stringify([resource.input, resource.limits]);
    if (shape === this.#shape) return;
    this.#shape = shape;
    if (resource.takes !== "application/json") {
      const file = document.createElement("input");
      Object.assign(file, { type: "file", accept: resource.takes, required: true });
      file.setAttribute("aria-label", "sound");
      this.fields = { file: { element: file, read: () => file.files[0] } };
    } else {
      this.fields = fieldsOf(resource.input?.properties ?? {}, resource.limits);
    }
    this.form.querySelector(".fields").replaceChildren(...Object.values(this.fields).map(({ element }) => element));
  }

  async #send() {
    const body = valuesOf(this.fields) ?? {};
    this.#show("pending", "...");
    try {
      const answer = await this.call(body.file instanceof Blob ? body.file : body);
      this.#show("done", JSON.stringify(answer, null, 1).replaceAll(/\n\s*/g, " "));
    } catch (error) {
      this.#show("failed", error.message);
    }
  }

  #show(state, text) {
    this.output.dataset.state = state;
    this.output.textContent = text;
  }

  /** @param {boolean} possible whether the robot can be asked now */
  enable(possible) {
    this.form.querySelector("button").disabled = !possible;
  }
}
