// Gestures, shares and times in words, and elements that show them.

let names = { notouch: "no touch" };
let guesses = {};

/** Use the gesture names of the configuration, and its words for a guess. */
export function useNames(scene) {
  ({ names, guesses } = scene);
}

export function nameOf(gesture) {
  return names[gesture] ?? gesture;
}

/** An answer in words, or a guess if nothing is sure: "A pat, perhaps?". */
export function wordsOf({ gesture, perhaps }) {
  return (gesture === "uncertain" && guesses[perhaps]) || nameOf(gesture);
}

/** An answer and its confidence; "uncertain" has none. */
export function answerOf(prediction) {
  const { gesture, confidence } = prediction;
  return gesture === "uncertain" ? wordsOf(prediction) : `${nameOf(gesture)} ${percent(confidence)}`;
}

/** The answer that was told before the one at a place and that this one replaced; undefined if none was. */
export function replacedBy(predictions, place) {
  const { gesture, changed } = predictions[place] ?? {};
  return changed ? predictions.slice(0, place).reverse().find((one) => one.told && one.gesture !== gesture) : undefined;
}

/** When an answer came, in seconds since the touch began: the time of its last frame, and that frame's age. */
export function saidAt({ elapsed_s, age_ms }) {
  return elapsed_s + age_ms / 1000;
}

export function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

export function percent(share) {
  return `${Math.round(100 * share)}\u00a0%`;
}

/** 1 s, 1.5 s, 2.67 s; never broken across two lines. */
export function seconds(value, least = 0) {
  const digits = { minimumFractionDigits: least, maximumFractionDigits: 2, useGrouping: false };
  return `${value.toLocaleString("en", digits)}\u00a0s`;
}

export function timeOfDay(iso) {
  return new Date(iso).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}
