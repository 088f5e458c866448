// How things are said, in the configured language.

const LANGUAGES = ["en", "de"];
let names = { notouch: "no touch" };
let language = "en";

// One text for each of LANGUAGES. What the daemon gives as a reason stays in English, as in its log.
const WORDS = {
  after: ["after {at}", "nach {at}"],
  answered: ["answered after {at}", "beantwortet nach {at}"],
  at: ["at {at}", "bei {at}"],
  awaited: ["awaited", "erwartet"],
  away: ["away", "nicht da"],
  changed: ["changed from {name}", "vorher {name}"],
  does: ["does {what}", "macht {what}"],
  dropped: ["Dropped", "Verworfen"],
  feeling: ["feeling…", "ich fühle…"],
  firm: ["firm", "fest"],
  firmest: [
    "Firmest in row {row}, column {column}: {counts} counts.",
    "Am festesten in Zeile {row}, Spalte {column}: {counts} Zähler.",
  ],
  frames: ["{rate} frames/s", "{rate} Frames/s"],
  gap: ["too many frames were lost", "zu viele Frames gingen verloren"],
  goes: ["How it goes", "Zustand"],
  heat: [
    "Pressure on the pad, 8 by 8 taxels, firmer pressure in a brighter colour",
    "Druck auf das Kissen, 8 mal 8 Taxel, festerer Druck in hellerer Farbe",
  ],
  history: ["Last touches", "Letzte Berührungen"],
  last: ["Last touch: {number}", "Letzte Berührung: {number}"],
  leave: ["Leave the visitors' view", "Zurück zur ganzen Seite"],
  legend: [
    "Brighter is firmer. What your hand does is said after {marks}; ↻ a change of mind, ✓ told to the robot.",
    "Heller ist fester. Was die Hand tut, steht nach {marks} da; ↻ anders entschieden, ✓ dem Roboter gesagt.",
  ],
  light: ["light", "leicht"],
  likelier: [
    "{name} stands: {other} is likelier, but not yet {share} sure",
    "{name} bleibt: {other} ist wahrscheinlicher, aber noch nicht zu {share} sicher",
  ],
  line: ["What was said, and when", "Was wann gesagt wurde"],
  live: ["live", "läuft"],
  longest: ["longer than a touch may last", "länger, als eine Berührung dauern darf"],
  lost: ["frames were lost", "Frames gingen verloren"],
  margin: [
    "{name} stands: {other} leads by {lead} points, {needed} are needed",
    "{name} bleibt: {other} führt mit {lead} Punkten, {needed} sind nötig",
  ],
  minute: ["over a minute old", "über eine Minute alt"],
  model: ["Model", "Modell"],
  noFrames: ["The pad sends no frames.", "Das Kissen sendet keine Frames."],
  noLink: ["No connection to touchd. Trying again.", "Keine Verbindung zu touchd. Neuer Versuch."],
  noTouch: ["No touch yet", "Noch keine Berührung"],
  noisy: ["noisy", "verrauscht"],
  none: ["none", "keiner"],
  noneYet: ["none yet", "noch keine"],
  nothing: ["Nothing presses on the pad.", "Nichts drückt auf das Kissen."],
  notFelt: ["not felt", "nicht zu fühlen"],
  old: ["{age} s old", "{age} s alt"],
  padAway: ["The pad is away", "Das Kissen ist nicht da"],
  page: ["Page", "Seite"],
  pad: ["Pad", "Kissen"],
  pads: ["Pads", "Kissen"],
  pause: ["{name} stands: a pause replaces no answer", "{name} bleibt: Eine Pause ersetzt keine Antwort"],
  probabilities: ["Probabilities", "Wahrscheinlichkeiten"],
  quick: ["{model}, answers in {ms} ms", "{model}, antwortet in {ms} ms"],
  quote: ["“{what}”", "„{what}“"],
  rate: ["Rate", "Rate"],
  reconnecting: ["reconnecting", "verbindet neu"],
  robot: ["Robot", "Roboter"],
  robotAway: ["The robot is away", "Der Roboter ist nicht da"],
  sendsNothing: ["touchd sends nothing: {why}. Trying again.", "touchd sendet nichts: {why}. Neuer Versuch."],
  sensor: ["the pad went away", "das Kissen verschwand"],
  settled: ["taken for the pad's new rest", "für die neue Ruhelage gehalten"],
  skip: ["Skip to the answer", "Zur Antwort"],
  soFar: ["so far, after {at}", "bisher, nach {at}"],
  standsUntil: ["{name} stands until the next answer", "{name} bleibt bis zur nächsten Antwort"],
  stopped: ["touchd ended", "touchd wurde beendet"],
  sure: [" sure, after {at}", " sicher, nach {at}"],
  sureEnough: ["sure enough to tell {whom} after {at}", "sicher genug für {whom} nach {at}"],
  told: [", told", ", gesagt"],
  toldRobot: ["told the robot after {at}", "dem Roboter gesagt nach {at}"],
  touch: ["Touch {number}", "Berührung {number}"],
  touchMe: ["Touch the pad", "Berühre das Kissen"],
  unknown: ["no reason given", "kein Grund genannt"],
  unsure: ["not sure enough to tell {whom}", "nicht sicher genug für {whom}"],
  up: ["up", "da"],
  visitors: ["Visitors", "Besucher"],
  well: ["All is well again.", "Alles ist wieder in Ordnung."],
  aRobot: ["a robot", "einen Roboter"],
  thePad: ["The pad", "Das Kissen"],
  theRobot: ["the robot", "den Roboter"],
};

/** Return a text, what it has in braces replaced by the values of these names. */
export function word(key, values = {}) {
  return WORDS[key][LANGUAGES.indexOf(language)].replace(/\{(\w+)\}/g, (_, name) => values[name]);
}

/** Call gestures as the configuration says, and put the whole page into its language. */
export function useWords(scene) {
  names = scene.names;
  language = LANGUAGES.includes(scene.language) ? scene.language : "en";
  document.documentElement.lang = language;
  for (const element of document.querySelectorAll("[data-word]")) element.textContent = word(element.dataset.word);
  for (const element of document.querySelectorAll("[data-label]")) element.ariaLabel = word(element.dataset.label);
}

export function nameOf(gesture) {
  return names[gesture] ?? gesture;
}

export function percent(share) {
  return `${Math.round(100 * share)}\u00a0%`;
}

/** 1 s, 1.5 s, 2.67 s: never broken between two lines. */
export function seconds(value, least = 0) {
  const digits = { minimumFractionDigits: least, maximumFractionDigits: 2, useGrouping: false };
  return `${value.toLocaleString(language, digits)}\u00a0s`;
}

export function timeOfDay(iso) {
  return new Date(iso).toLocaleTimeString(language, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}
