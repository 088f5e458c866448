// Passes messages to the parts that show them, and draws only when something has arrived.

import "./older.js";
import { announce } from "./announce.js";
import { describePressure, drawTrail, HeatMap, showScale } from "./heat.js";
import { followChoice, showLabels, useLabels } from "./label.js";
import { drawLine } from "./line.js";
import { connect } from "./link.js";
import * as show from "./show.js";
import { drawPads, showPads } from "./pads.js";
import { padOf, Store } from "./store.js";
import { useTouch } from "./touch.js";
import { followVisitors, showLegend } from "./visitors.js";
import { answerOf, useNames } from "./words.js";

// Frames come every 18 ms; without one for this long, the picture is outdated.
const STALE_AFTER_S = 0.5;
const WATCH_MS = 250;
const WORDS_MS = 1000;

const $ = (id) => document.getElementById(id);
$("unable").remove();
let store = new Store();
let stores = new Map();
const heat = new HeatMap($("heat"), $("scale"));

let link = "";
let stamp = null;
let announced = null;
let trouble = "";
let isDue = false;
let hasEvent = true;
let hasLive = false;
followVisitors(drawSoon);

function draw() {
  isDue = false;
  heat.draw(store.pressure);
  drawTrail(store.trail);
  drawPads(stores);
  drawLine(store);
  show.showClock(store);
  if (hasEvent || hasLive) show.showChances(store);
  if (hasEvent) {
    show.showAnswer(store);
    showLabels(store);
    show.showTouches(store);
  }
  hasEvent = hasLive = false;
}

function drawSoon() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(draw);
}

function watch() {
  const age = store.frameAt === null ? null : (performance.now() - store.frameAt) / 1000;
  const isStale = link !== "live" || age === null || age > STALE_AFTER_S;
  show.showVitals(store, link, isStale);
  show.showAge(age, isStale);
  const now = show.troubleOf(store, link, age, STALE_AFTER_S);
  if (now !== trouble) {
    trouble = now;
    show.showTrouble(trouble);
    announce("trouble", trouble || "All is well again.");
  }
}

/** Announce a touch's answer if it is the first one, or has changed. */
function announceAnswer(prediction) {
  const said = `${prediction.pad} ${prediction.touch} ${prediction.gesture}`;
  if (said === announced) return;
  announced = said;
  const answer = answerOf(prediction);
  const where = stores.size > 1 ? ` (${prediction.pad})` : "";
  announce("answer", `${prediction.touch}${where}: ${answer}`);
}

/** Keep a store for each pad; the first is shown large until another is chosen. */
function usePads(names) {
  if ([...stores.keys()].join() === names.join()) return;
  stores = new Map(names.map((name) => [name, stores.get(name) ?? new Store()]));
  store = stores.get(names[0]);
  showPads(names, (name) => {
    store = stores.get(name);
    hasEvent = true;
    watch();
    drawSoon();
  });
}

function onMessage(message) {
  if (message instanceof ArrayBuffer) {
    [...stores.values()][padOf(message)]?.takeFrame(message, performance.now());
    drawSoon();
    return;
  }
  if (message.type === "state") {
    // Another version of touchd serves these messages, and the page may not understand them.
    if (stamp !== null && stamp !== message.page) location.reload();
    stamp = message.page;
    link = "live";
    usePads(message.pads);
    useNames(message);
    showLegend(message);
    useTouch(message.touchable, send);
    useLabels(message, send);
    document.body.toggleAttribute("data-pad-only", message.labels.length === 0);
  }
  for (const told of message.pad === undefined ? stores.values() : [stores.get(message.pad)]) told.apply(message);
  if (message.type === "prediction") announceAnswer(message);
  if (message.type === "live_prediction") hasLive = true;
  else if (message.type !== "status") hasEvent = true;
  if (message.type === "status") watch();
  else drawSoon();
}

const send = connect(onMessage, (why) => {
  link = why;
  watch();
});
followChoice(() => {
  hasEvent = true;
  drawSoon();
});
showScale();
setInterval(watch, WATCH_MS);
setInterval(() => {
  $("pad-words").textContent = describePressure(store.pressure);
}, WORDS_MS);
addEventListener("resize", drawSoon);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => location.reload());
