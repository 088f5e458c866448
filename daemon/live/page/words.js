// How things are said.

let names = { notouch: "no touch" };
let language = "en";

// What a visitor reads; everything else is for those who run touchd.
const VISITOR = {
  en: {
    touch: "Touch the pad",
    away: "The pad is away",
    feeling: "feeling…",
    sure: " sure, after ",
    legend: "Brighter is firmer. What your hand does is said after {marks}; ↻ a change of mind, ✓ told to the robot.",
    leave: "Leave the visitors' view",
  },
  de: {
    touch: "Berühre das Kissen",
    away: "Das Kissen ist nicht da",
    feeling: "ich fühle…",
    sure: " sicher, nach ",
    legend: "Heller ist fester. Was die Hand tut, steht nach {marks} da; ↻ anders entschieden, ✓ dem Roboter gesagt.",
    leave: "Zurück zur ganzen Seite",
  },
};

/** Call gestures as the configuration says, and speak its language to visitors. */
export function useWords(scene) {
  names = scene.names;
  language = scene.language in VISITOR ? scene.language : "en";
  document.documentElement.dataset.words = language;
}

export function visitorWord(key) {
  return VISITOR[language][key];
}

const ENDINGS = {
  settled: "taken for the pad's new rest",
  longest: "longer than a touch may last",
  gap: "too many frames were lost",
  sensor: "the pad went away",
  stopped: "touchd ended",
};

export function nameOf(gesture) {
  return names[gesture] ?? gesture;
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
