// How things are said.

const NAMES = { notouch: "no touch" };
const ENDINGS = {
  settled: "taken for the pad's new rest",
  gap: "too many frames were lost",
  sensor: "the pad went away",
  stopped: "touchd ended",
};

export function nameOf(gesture) {
  return NAMES[gesture] ?? gesture;
}

export function percent(share) {
  return `${Math.round(100 * share)}\u00a0%`;
}

/** 1 s, 1.5 s, 2.67 s: never broken between two lines. */
export function seconds(value) {
  return `${Number(value.toFixed(2))}\u00a0s`;
}

export function endingOf(ended) {
  return ENDINGS[ended?.reason] ?? "";
}

export function timeOfDay(iso) {
  return new Date(iso).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}
