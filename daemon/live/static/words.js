// Formats gestures, shares and times.

let names = { notouch: "no touch" };

/** Use the gesture names of the configuration. */
export function useNames(configured) {
  names = configured;
}

export function nameOf(gesture) {
  return names[gesture] ?? gesture;
}

/** A gesture and its confidence; "uncertain" has none. */
export function answerOf({ gesture, confidence }) {
  return gesture === "uncertain" ? nameOf(gesture) : `${nameOf(gesture)} ${percent(confidence)}`;
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
