// Buttons that say what a touch was, for viewers on touchd's computer: the last one, or one chosen in the list.

import { nameOf } from "./words.js";

const HERE = ["localhost", "[::1]"];
const isHere = HERE.includes(location.hostname) || location.hostname.startsWith("127.");

export class Labels {
  #fieldset;
  #advice;
  #send;
  #buttons = new Map();
  #store = null;
  #chosen = null;

  /** onChoice: called when a touch of the list is chosen. */
  constructor(fieldset, advice, list, send, onChoice) {
    this.#fieldset = fieldset;
    this.#advice = advice;
    this.#send = send;
    list.addEventListener("click", ({ target }) => {
      if (!target.value) return;
      const began = this.#store.touches.find((touch) => touch.began.touch === Number(target.value)).began;
      this.#chosen = this.isChosen(began) ? null : began;
      onChoice();
    });
  }

  /** Whether labels are taken from here. */
  get areTaken() {
    return this.#buttons.size > 0;
  }

  isChosen({ touch, time }) {
    return this.#chosen?.touch === touch && this.#chosen.time === time;
  }

  /** Show a button for each gesture, if labels are taken from here. */
  use(scene) {
    const labels = scene.may_label && isHere ? scene.labels : [];
    if ([...this.#buttons.keys()].join() === labels.join()) return;
    for (const button of this.#buttons.values()) button.remove();
    this.#buttons = new Map(labels.map((gesture) => [gesture, this.#make(gesture)]));
    this.#advice.before(...this.#buttons.values());
  }

  /** Mark what the chosen touch was, or else the last one, if anybody has said so. */
  show(store) {
    this.#store = store;
    if (!store.touches.some(({ began }) => began.pad === this.#chosen?.pad && this.isChosen(began))) this.#chosen = null;
    this.#fieldset.hidden = !this.areTaken || store.touch === undefined;
    this.#fieldset.firstElementChild.textContent = this.#chosen ? `Touch ${this.#chosen.touch} was` : "That was";
    const said = store.said.get((this.#chosen ?? store.touch?.began)?.touch);
    for (const [gesture, button] of this.#buttons) button.setAttribute("aria-pressed", gesture === said);
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
      const { pad, touch } = this.#chosen ?? this.#store.touch.began;
      this.#chosen = null;
      this.#send(JSON.stringify({ pad, touch, gesture }));
    });
    return button;
  }
}
