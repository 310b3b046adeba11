// ROS actions on the dashboard: a goal, how far it has come, how it ended, and a way to cancel it.

import { FormCard } from "./forms.js";

const RESULT_TIMEOUT_S = 600;
const ASK_AGAIN_MS = 1000;
const FRESH_MS = 2000;
const MAX_ENDED = 64;
const ENDINGS = { succeeded: "Succeeded", canceled: "Cancelled", aborted: "Given up by the robot" };

/** The identity of a goal as text, however it came. */
function hexOf(goalId) {
  const bytes = goalId?.uuid?.data ?? goalId?.uuid?.items ?? goalId?.uuid;
  if (!bytes) return String(goalId ?? "");
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** What a feedback says in a line: its numbers and durations; what is larger is left out. */
export function feedbackText(feedback) {
  const told = Object.entries(feedback ?? {}).map(([name, value]) => {
    const words = name.replaceAll("_", " ");
    if (typeof value === "number") return `${words} ${Number.isInteger(value) ? value : value.toFixed(2)}`;
    if (typeof value === "string") return `${words} ${value}`;
    if (value?.sec !== undefined && value?.nanosec !== undefined) {
      return `${words} ${(value.sec + value.nanosec / 1e9).toFixed(1)} s`;
    }
    const list = Array.isArray(value) ? value : Array.from(value?.data ?? []);
    return list.length && list.every((item) => typeof item === "number") ? `${words} ${list.slice(-8).join(" ")}` : "";
  });
  return told.filter(Boolean).join(" \u00b7 ");
}

/** What a result says in a line, without what is zero or empty. */
export function resultText(result) {
  return feedbackText(Object.fromEntries(Object.entries(result ?? {}).filter(([, value]) => value)));
}

/**
 * One action of a robot, and its goal under way, whoever sent it.
 *
 * Attributes: `state` is `idle`, `sending`, `active`, `cancelling` or `ended`; `text` says the same
 * to people; `feedback` is the newest. Fires `change`.
 */
export class Action extends EventTarget {
  state = "idle";
  text = "";
  feedback = null;
  #goalId = "";
  /** @type {string[]} */ #ended = [];

  /**
   * @param {(leaf: string, body: any, timeoutS?: number) => Promise<any>} call
   * @param {{feedback: (feedback: any) => string, result: (result: any) => string}} words what people are told
   */
  constructor(call, words = { feedback: feedbackText, result: resultText }) {
    super();
    this.call = call;
    this.words = words;
  }

  get busy() {
    return this.state === "active" || this.state === "sending" || this.state === "cancelling";
  }

  /** Send a goal; return the answer, or throw why it was refused. */
  async send(goal) {
    this.#goalId = ""; // a goal that was under way is replaced
    this.#enter("sending", "Sending the goal");
    try {
      const answer = await this.call("goal", goal);
      this.#adopt(answer.goal_id);
      return answer;
    } catch (error) {
      this.#enter("ended", `The goal was refused: ${error.message}`);
      throw error;
    }
  }

  /** Cancel the goal under way; what comes of it is told by `change`. */
  async cancel() {
    if (this.state !== "active") return;
    this.#enter("cancelling", "Cancelling");
    try {
      await this.call("cancel", { goal_id: this.#goalId });
    } catch (error) {
      if (this.state === "cancelling") this.#enter("active", `Not cancelled: ${error.message}`);
    }
  }

  /** Take in a feedback, also of a goal that another client has sent. */
  take(sample) {
    const told = sample.message?.value ?? sample.message;
    const goalId = hexOf(told?.goal_id);
    if (!goalId || this.#ended.includes(goalId) || this.state === "sending") return;
    if (goalId !== this.#goalId) {
      if (!(sample.age_ms < FRESH_MS)) return; // the gateway greets with the newest it has
      this.#adopt(goalId);
    }
    this.feedback = told.feedback;
    if (this.state === "active") this.#enter("active", this.words.feedback(told.feedback) || "Under way");
  }

  #adopt(goalId) {
    this.#goalId = goalId;
    this.feedback = null;
    this.#enter("active", "Under way");
    this.#follow(goalId);
  }

  /** Wait for the end of a goal, through lost connections too. */
  async #follow(goalId) {
    while (this.#goalId === goalId) {
      try {
        const { status, result } = await this.call("result", { goal_id: goalId }, RESULT_TIMEOUT_S);
        const told = this.words.result(result);
        this.#end(goalId, (ENDINGS[status] ?? `Ended: ${status}`) + (told && `: ${told}`));
        return;
      } catch (error) {
        if (error.status !== undefined && error.status < 500) {
          this.#end(goalId, `Lost sight of the goal: ${error.message}`);
          return;
        }
        await new Promise((resolve) => setTimeout(resolve, ASK_AGAIN_MS));
      }
    }
  }

  #end(goalId, text) {
    this.#ended.push(goalId);
    if (this.#ended.length > MAX_ENDED) this.#ended.shift();
    if (this.#goalId !== goalId) return;
    this.#goalId = "";
    this.feedback = null;
    this.#enter("ended", text);
  }

  #enter(state, text) {
    this.state = state;
    this.text = text;
    this.dispatchEvent(new Event("change"));
  }
}

/** A button that cancels an action, and a line that says how it stands. */
export function showAction(action, line, button) {
  button.addEventListener("click", () => action.cancel());
  const show = () => {
    if (line.textContent !== action.text) line.textContent = action.text;
    line.dataset.state = action.state;
    button.hidden = !action.busy;
    button.disabled = action.state !== "active";
  };
  action.addEventListener("change", show);
  show();
}

/** An action that folds out to a form for its goal. */
export class ActionCard extends FormCard {
  /**
   * @param {HTMLElement} element made from the form template
   * @param {any} resource the call `goal`
   * @param {Action} action
   */
  constructor(element, resource, action) {
    super(element, resource, (goal) => action.send(goal));
    const line = document.createElement("p");
    line.className = "action-state";
    const button = document.createElement("button");
    button.type = "button";
    button.className = "cancel";
    button.textContent = "Cancel";
    element.append(line, button);
    showAction(action, line, button);
  }
}
