// Several pads: each small beside the large one, to choose which is shown large.

import { HeatMap } from "./heat.js";
import { make, nameOf } from "./words.js";

const nav = document.getElementById("pads");
let pads = new Map();

/** Show these pads; a single one needs no choice. onChoice gets the name of the pad to show large. */
export function showPads(names, onChoice) {
  pads = new Map(names.map((name) => [name, choice(name, onChoice)]));
  nav.replaceChildren(...[...pads.values()].map(({ button }) => button));
  nav.hidden = names.length < 2;
  mark(names[0]);
}

export function drawPads(stores) {
  if (nav.hidden) return;
  for (const [name, { heat, words }] of pads) {
    const store = stores.get(name);
    heat.draw(store.pressure);
    const answer = store.isTouched ? store.touch.predictions.at(-1) : undefined;
    const text = answer ? `${name}: ${nameOf(answer.gesture)}` : name;
    if (words.textContent !== text) words.textContent = text;
  }
}

function choice(name, onChoice) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 128;
  canvas.setAttribute("aria-hidden", "true");
  const words = make("span", "");
  const button = make("button", "", canvas, words);
  button.type = "button";
  button.addEventListener("click", () => {
    mark(name);
    onChoice(name);
  });
  return { button, words, heat: new HeatMap(canvas, null) };
}

function mark(chosen) {
  for (const [name, { button }] of pads) button.setAttribute("aria-pressed", name === chosen);
}
