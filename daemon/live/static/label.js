// Buttons to label a touch, the last one or one chosen in the list, for viewers on touchd's computer.

import { make, nameOf } from "./words.js";

const HERE = ["localhost", "[::1]"];
const isHere = HERE.includes(location.hostname) || location.hostname.startsWith("127.");
const fieldset = document.getElementById("labels");
const buttons = new Map();
let store = null;
let chosen = null;

/** Whether labels are taken from here. */
export const areLabelsTaken = () => buttons.size > 0;

export const isChosen = ({ touch, time }) => chosen?.touch === touch && chosen.time === time;

/** onChoice: called when a touch of the list is chosen. */
export function followChoice(onChoice) {
  document.getElementById("touches").addEventListener("click", ({ target }) => {
    if (!target.value) return;
    const began = store.touches.find((touch) => touch.began.touch === Number(target.value)).began;
    chosen = isChosen(began) ? null : began;
    onChoice();
  });
}

/** Show a button for each gesture, if labels are taken from here. */
export function useLabels(scene, send) {
  const labels = scene.may_label && isHere ? scene.labels : [];
  if ([...buttons.keys()].join() === labels.join()) return;
  for (const button of buttons.values()) button.remove();
  buttons.clear();
  for (const gesture of labels) {
    const button = make("button", "", nameOf(gesture));
    button.type = "button";
    button.addEventListener("click", () => {
      const { pad, touch } = chosen ?? store.touch.began;
      chosen = null;
      send(JSON.stringify({ pad, touch, gesture }));
    });
    buttons.set(gesture, button);
  }
  fieldset.append(...buttons.values());
}

/** Mark the label of the chosen touch, or else of the last one, if it has one. */
export function showLabels(shown) {
  store = shown;
  if (!store.touches.some(({ began }) => began.pad === chosen?.pad && isChosen(began))) chosen = null;
  fieldset.hidden = !areLabelsTaken() || store.touch === undefined;
  fieldset.firstElementChild.textContent = chosen ? `Touch ${chosen.touch} was` : "That was";
  const said = store.said.get((chosen ?? store.touch?.began)?.touch);
  for (const [gesture, button] of buttons) button.setAttribute("aria-pressed", gesture === said);
}
