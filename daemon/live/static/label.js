// Buttons that say what the last touch was, for viewers on touchd's computer.

import { nameOf } from "./words.js";

const HERE = ["localhost", "[::1]"];
const isHere = HERE.includes(location.hostname) || location.hostname.startsWith("127.");

export class Labels {
  #fieldset;
  #advice;
  #send;
  #buttons = new Map();
  #store = null;

  constructor(fieldset, advice, send) {
    this.#fieldset = fieldset;
    this.#advice = advice;
    this.#send = send;
  }

  /** Show a button for each gesture, if labels are taken from here. */
  use(scene) {
    const labels = scene.may_label && isHere ? scene.labels : [];
    if ([...this.#buttons.keys()].join() === labels.join()) return;
    for (const button of this.#buttons.values()) button.remove();
    this.#buttons = new Map(labels.map((gesture) => [gesture, this.#make(gesture)]));
    this.#advice.before(...this.#buttons.values());
  }

  /** Mark what the last touch was, if anybody has said so. */
  show(store) {
    this.#store = store;
    this.#fieldset.hidden = this.#buttons.size === 0 || store.touch === undefined;
    const said = store.said.get(store.touch?.began.touch);
    for (const [gesture, button] of this.#buttons) button.ariaPressed = String(gesture === said);
  }

  advise(text) {
    this.#advice.textContent = text;
    this.#advice.hidden = false;
  }

  #make(gesture) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = nameOf(gesture);
    button.addEventListener("click", () => {
      const { pad, touch } = this.#store.touch.began;
      this.#send(JSON.stringify({ pad, touch, gesture }));
    });
    return button;
  }
}
