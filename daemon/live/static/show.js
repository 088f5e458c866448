// Everything in words and bars: the answer, the probabilities, the last touches, and the status.

import { areLabelsTaken, isChosen } from "./label.js";
import { answerOf, make, nameOf, percent, replacedBy, saidAt, seconds, timeOfDay, wordsOf } from "./words.js";

const ENDINGS = {
  gap: "too many frames were lost",
  longest: "longer than a touch may last",
  sensor: "the pad went down",
  settled: "taken for the pad's new rest",
  stopped: "touchd ended",
};

const $ = (id) => document.getElementById(id);

/** Set a text only if it differs, to avoid needless layouts and announcements by screen readers. */
function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function showClock(store) {
  say($("clock"), store.touch ? `· ${seconds(Number(store.elapsed.toFixed(1)), 1)}` : "");
}

export function showAnswer(store) {
  const { touch, isTouched } = store;
  const said = touch?.predictions ?? [];
  const answer = said.at(-1);
  say($("which"), touch ? `${isTouched ? "Touch" : "Last touch:"} ${touch.began.touch}` : "No touch yet");
  const gesture = $("gesture");
  const waiting = store.sensor?.state === "down" ? "The pad is down" : isTouched ? "…" : "Touch the pad";
  say(gesture, answer ? wordsOf(answer) : waiting);
  gesture.style.setProperty("--letters", gesture.textContent.length);
  const previous = replacedBy(said, said.length - 1);
  gesture.classList.toggle("waiting", answer === undefined);
  gesture.classList.toggle("changed", Boolean(previous && isTouched));
  gesture.classList.toggle("over", !isTouched);
  gesture.classList.toggle("guess", Boolean(answer?.perhaps));
  const saw = answer ? `saw ${seconds(answer.elapsed_s)}` : "";
  // The confidence is the likeliest gesture's, not that of being unsure.
  const certainty =
    answer?.gesture === "uncertain" ? [saw] : answer ? [make("b", "", percent(answer.confidence)), ` sure, ${saw}`] : [];
  $("certainty").replaceChildren(...certainty);
  $("remark").replaceChildren(...remarks(store, said, previous));
  showAction(store.action);
}

/** Show what the robot says, as a bubble, or what it does. */
function showAction(action) {
  const isDeed = action?.action === "behavior";
  $("says").hidden = action === null;
  $("says").classList.toggle("deed", isDeed);
  say($("says"), isDeed ? `does ${action.what.split("/").at(-1)}` : action ? `“${action.what}”` : "");
  $("says").style.setProperty("--letters", $("says").textContent.length);
}

/** Return why the current answer is not the likeliest gesture; "" if it is. Names may be in another language. */
function whyItStands({ touch, isTouched, scene }, shown, best) {
  const answer = touch?.predictions.at(-1);
  if (!answer || !isTouched || best === answer.gesture || !(answer.gesture in shown.probabilities)) return "";
  if (best === "notouch") return "the answer stands: a pause replaces none";
  const lead = shown.probabilities[best] - shown.probabilities[answer.gesture];
  const isTold = touch.predictions.some((one) => one.told);
  if (isTold && lead < scene.revise_margin) {
    const [points, needed] = [lead, scene.revise_margin].map((share) => Math.round(100 * share));
    return `the answer stands: the likeliest leads by ${points} point${points === 1 ? "" : "s"}, ${needed} are needed`;
  }
  if (isTold && shown.probabilities[best] < scene.speak_above) {
    return `the answer stands: the likeliest is not yet ${percent(scene.speak_above)} sure`;
  }
  return "the answer stands until the next";
}

function remarks({ scene, reported, touch }, said, previous) {
  const answer = said.at(-1);
  if (!answer) return [];
  const told = said.findLast((one) => one.told && one.gesture === answer.gesture);
  const whom = scene.robot_configured ? "the robot" : "a robot";
  const isReported = reported.has(touch.began.touch);
  const telling = isReported ? `told ${whom} at` : `sure enough to tell ${whom} at`;
  const remark = told && (isReported || answer.gesture !== "uncertain") ? `${telling} ${seconds(saidAt(told))}` : `not sure enough to tell ${whom}`;
  const parts = previous ? [make("b", "", `↻ before: ${nameOf(previous.gesture)}`), " · "] : [];
  const degraded = answer.degraded ? " · too few frames" : "";
  return [...parts, remark, degraded];
}

/** Show the current probabilities, or those of the last answer. */
export function showChances(store) {
  const answer = store.touch?.predictions.at(-1);
  const shown = store.live ?? answer;
  const { labels, frame_rate_hz: rate } = store.scene;
  const bars = $("bars");
  if (bars.childElementCount !== labels.length) bars.replaceChildren(...labels.map(makeBar));
  const best = labels.reduce((a, b) => ((shown?.probabilities[b] ?? 0) > (shown?.probabilities[a] ?? 0) ? b : a), "");
  const standing = (store.isTouched ? answer?.gesture : null) ?? best;
  [...bars.children].forEach((row, i) => {
    const share = shown?.probabilities[labels[i]] ?? 0;
    const [name, bar, number] = row.children;
    say(name, nameOf(labels[i]));
    name.classList.toggle("best", labels[i] === standing);
    bar.firstElementChild.style.setProperty("--share", share);
    say(number, shown ? percent(share) : "–");
  });
  const when = store.live
    ? `so far, after ${seconds(Number((store.live.frames / rate).toFixed(1)))}`
    : answer
      ? `of the answer, saw ${seconds(answer.elapsed_s)}`
      : "";
  const why = shown ? whyItStands(store, shown, best) : "";
  say($("chances-when"), why || when);
  $("chances-when").classList.toggle("why", why !== "");
}

function makeBar() {
  const bar = make("span", "bar", make("i", ""));
  bar.setAttribute("aria-hidden", "true");
  return make("li", "", make("span", "name"), bar, make("span", "share"));
}

/** List the touches; those that can be labelled from here are chosen by a button. */
export function showTouches(store) {
  const list = $("touches");
  const { scrollTop } = list;
  const focused = list.contains(document.activeElement) && document.activeElement.value;
  const ended = store.touches.filter((touch) => touch.ended !== null).reverse();
  list.replaceChildren(
    ...(ended.length ? ended.map((touch) => row(touch, store)) : [make("li", "path", "none yet")]),
  );
  list.scrollTop = scrollTop;
  if (focused) list.querySelector(`[value="${focused}"]`)?.focus({ preventScroll: true });
}

function row({ began, predictions, ended }, { scene, said }) {
  const length = seconds(Number((ended.frames / scene.frame_rate_hz).toFixed(1)));
  const path = make("span", "path");
  let before = null;
  for (const [place, one] of predictions.entries()) {
    if (one.gesture === before) continue;
    const name = `${answerOf(one)} · ${seconds(one.elapsed_s)}`;
    const isReplacing = replacedBy(predictions, place) !== undefined;
    path.append(isReplacing ? make("em", "", ` ↻ ${name}`) : before === null ? name : ` → ${name}`);
    before = one.gesture;
  }
  if (said.has(began.touch)) path.append(make("em", "label", ` = ${nameOf(said.get(began.touch))}`));
  if (ended.reason !== "released") path.append(` · ${ENDINGS[ended.reason] ?? ended.reason}`);
  let name = ended.gesture === predictions.at(-1)?.gesture ? wordsOf(predictions.at(-1)) : nameOf(ended.gesture);
  if (areLabelsTaken()) {
    name = make("button", "", name);
    Object.assign(name, { type: "button", value: began.touch });
    name.setAttribute("aria-pressed", isChosen(began));
  }
  return make(
    "li",
    "",
    make("b", "", name),
    make("span", "when", `${length} · ${timeOfDay(began.time)}`),
    path,
  );
}

/** Show the status. `link`: "live", or why there is no connection. `isStale`: whether frames have stopped. */
export function showVitals(store, link, isStale) {
  const isLive = link === "live";
  const { sensor, robot, scene, status } = store;
  vital("link", isLive ? "live" : "reconnecting", isLive ? "good" : "bad");
  vital("pad", ...padState(isLive ? sensor : null, isStale));
  vital("rate", status && !isStale ? `${Math.round(status.rate_hz)} frames/s` : "–");
  vital("dropped", status ? `${status.dropped}` : "–", status?.dropped ? "bad" : undefined);
  vital("robot", ...robotState(isLive, scene, robot));
  const latency = store.touches.flatMap((touch) => touch.predictions).at(-1)?.latency_ms;
  const { model } = scene;
  vital("model", model && latency !== undefined ? `${model}, answers in ${latency.toFixed(1)} ms` : model || "–");
}

function padState(sensor, isStale) {
  // A simulated pad whose touches another program answers has no sensor events.
  if (!sensor) return isStale ? ["–", "none"] : ["up", "good"];
  return [sensor.state, sensor.state === "up" ? "good" : "bad"];
}

function robotState(isLive, scene, robot) {
  if (!isLive) return ["–", "none"];
  if (!scene.robot_configured) return ["none", "none"];
  if (!robot) return ["awaited", "none"];
  return [robot.state, robot.state === "up" ? "good" : "bad"];
}

function vital(name, text, mood) {
  const element = $(`vital-${name}`);
  say(element.lastElementChild, text);
  if (mood) element.dataset.mood = mood;
  else delete element.dataset.mood;
}

/** Return the current trouble in one line; "" if there is none. */
export function troubleOf(store, link, age, staleAfter) {
  if (link !== "live") {
    return link ? `touchd sends nothing: ${link}. Trying again.` : "No connection to touchd. Trying again.";
  }
  if (store.sensor?.state === "degraded") return store.sensor.reason;
  if (store.sensor?.state === "down") return `The pad is down: ${store.sensor.reason || "no reason given"}`;
  if (age !== null && age > staleAfter) return "The pad sends no frames.";
  if (store.scene.robot_configured && store.robot?.state === "down") {
    return `The robot is down: ${store.robot.reason || "no reason given"}`;
  }
  return "";
}

export function showTrouble(text) {
  say($("banner"), text);
  $("banner").hidden = text === "";
}

export function showAge(age, isStale) {
  document.body.toggleAttribute("data-stale", isStale);
  $("age").hidden = !isStale || age === null;
  if (isStale && age !== null) say($("age"), age < 60 ? `${Math.floor(age)} s old` : "over a minute old");
}
