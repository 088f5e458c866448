// Several pads: each small beside the large one, to choose which is shown large.

import { HeatMap } from "./heat.js";
import { nameOf } from "./words.js";

export class PadSwitch {
  #nav;
  #onChoice;
  #pads = new Map();

  /** onChoice gets the name of the pad to show large. */
  constructor(nav, onChoice) {
    this.#nav = nav;
    this.#onChoice = onChoice;
  }

  /** Show these pads; a single one needs no choice. */
  use(names) {
    this.#pads = new Map(names.map((name) => [name, this.#make(name)]));
    this.#nav.replaceChildren(...[...this.#pads.values()].map(({ button }) => button));
    this.#nav.hidden = names.length < 2;
    this.#mark(names[0]);
  }

  draw(stores) {
    if (this.#nav.hidden) return;
    for (const [name, { heat, words }] of this.#pads) {
      const store = stores.get(name);
      heat.draw(store.pressure);
      const answer = store.isTouched ? store.touch.predictions.at(-1) : undefined;
      const text = answer ? `${name}: ${nameOf(answer.gesture)}` : name;
      if (words.textContent !== text) words.textContent = text;
    }
  }

  #make(name) {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 128;
    canvas.setAttribute("aria-hidden", "true");
    const words = document.createElement("span");
    const button = document.createElement("button");
    button.type = "button";
    button.append(canvas, words);
    button.addEventListener("click", () => {
      this.#mark(name);
      this.#onChoice(name);
    });
    return { button, words, heat: new HeatMap(canvas, null) };
  }

  #mark(chosen) {
    for (const [name, { button }] of this.#pads) button.setAttribute("aria-pressed", String(name === chosen));
  }
}
