// Everything in words and bars: the answer, the probabilities, the last touches, and how it goes.

import { nameOf, percent, seconds, timeOfDay, word } from "./words.js";

const $ = (id) => document.getElementById(id);

function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

/** Set a text only where it differs, so that nothing is laid out or read anew for nothing. */
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
  say($("which"), touch ? word(isTouched ? "touch" : "last", { number: touch.began.touch }) : word("noTouch"));
  const gesture = $("gesture");
  const waiting = store.sensor?.state === "down" ? "padAway" : isTouched ? "feeling" : "touchMe";
  say(gesture, answer ? nameOf(answer.gesture) : word(waiting));
  gesture.style.setProperty("--letters", gesture.textContent.length);
  const previous = said.slice(0, -1).reverse().find((one) => one.gesture !== answer?.gesture);
  gesture.classList.toggle("waiting", answer === undefined);
  gesture.classList.toggle("changed", Boolean(answer?.changed && previous && isTouched));
  gesture.classList.toggle("over", !isTouched);
  const certainty = answer
    ? [make("b", "", percent(answer.confidence)), word("sure", { at: seconds(answer.elapsed_s) })]
    : [];
  $("certainty").replaceChildren(...certainty);
  $("remark").replaceChildren(...remarks(store, said, previous));
  showAction(store.action);
}

/** What the robot says, as a bubble, or what it does. */
function showAction(action) {
  const isSaid = action?.action === "say" || action?.action === "animated_say";
  const isShown = isSaid || action?.action === "behavior";
  $("says").hidden = !isShown;
  $("says").classList.toggle("deed", isShown && !isSaid);
  say($("says"), isSaid ? word("quote", { what: action.what }) : isShown ? word("does", { what: action.what.split("/").at(-1) }) : "");
}

/** Why the answer that stands is not the likeliest gesture; "" where it is. */
function whyItStands({ touch, isTouched, scene }, shown, best) {
  const answer = touch?.predictions.at(-1);
  if (!answer || !isTouched || best === answer.gesture || !(answer.gesture in shown.probabilities)) return "";
  const [name, other] = [nameOf(answer.gesture), nameOf(best)];
  if (best === "notouch") return word("pause", { name });
  const lead = shown.probabilities[best] - shown.probabilities[answer.gesture];
  const isHeard = touch.predictions.some((one) => one.told);
  if (isHeard && lead < scene.revise_margin) {
    const [points, needed] = [lead, scene.revise_margin].map((share) => Math.round(100 * share));
    return word("margin", { name, other, lead: points, needed });
  }
  if (isHeard && shown.probabilities[best] < scene.speak_above) {
    return word("likelier", { name, other, share: percent(scene.speak_above) });
  }
  return word("standsUntil", { name });
}

function remarks({ scene, robot }, said, previous) {
  const answer = said.at(-1);
  if (!answer) return [];
  const told = said.findLast((one) => one.told && one.gesture === answer.gesture);
  const whom = word(scene.robot_configured ? "theRobot" : "aRobot");
  const telling = robot?.state === "up" ? "toldRobot" : "sureEnough";
  const heard = told ? word(telling, { whom, at: seconds(told.elapsed_s) }) : word("unsure", { whom });
  const parts = previous ? [make("b", "", `↻ ${word("changed", { name: nameOf(previous.gesture) })}`), " · "] : [];
  const degraded = answer.degraded ? ` · ${word("lost")}` : "";
  return [...parts, heard, degraded];
}

/** The probabilities: as they are now, or as they were when it last answered. */
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
    ? word("soFar", { at: seconds(Number((store.live.frames / rate).toFixed(1))) })
    : answer
      ? word("answered", { at: seconds(answer.elapsed_s) })
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

export function showTouches(store) {
  const ended = store.touches.filter((touch) => touch.ended !== null).reverse();
  $("touches").replaceChildren(
    ...(ended.length ? ended.map((touch) => row(touch, store.scene)) : [make("li", "path", word("noneYet"))]),
  );
}

function row({ began, predictions, ended }, scene) {
  const length = seconds(Number((ended.frames / scene.frame_rate_hz).toFixed(1)));
  const path = make("span", "path");
  let before = null;
  for (const one of predictions) {
    if (one.gesture === before) continue;
    const name = `${nameOf(one.gesture)} ${percent(one.confidence)} ${word("at", { at: seconds(one.elapsed_s) })}`;
    path.append(before === null ? name : make("em", "", ` ↻ ${name}`));
    before = one.gesture;
  }
  if (ended.reason !== "released") path.append(` · ${word(ended.reason)}`);
  return make(
    "li",
    "",
    make("b", "", nameOf(ended.gesture)),
    make("span", "when", `${length} · ${timeOfDay(began.time)}`),
    path,
  );
}

/** How it goes; `link` is "live", or why there is no line; `age` is of the newest frame, in seconds. */
export function showVitals(store, link, age) {
  const isLive = link === "live";
  const { sensor, robot, scene, status } = store;
  vital("link", word(isLive ? "live" : "reconnecting"), isLive ? "good" : "bad");
  vital("pad", ...padState(isLive ? sensor : null));
  vital("rate", status && isLive && age !== null ? word("frames", { rate: Math.round(status.rate_hz) }) : "–");
  vital("dropped", status ? `${status.dropped}` : "–", status?.dropped ? "bad" : undefined);
  vital("robot", ...robotState(isLive, scene, robot));
  const latency = store.touches.flatMap((touch) => touch.predictions).at(-1)?.latency_ms;
  const { model } = scene;
  vital("model", model && latency !== undefined ? word("quick", { model, ms: latency.toFixed(1) }) : model || "–");
}

function padState(sensor) {
  if (!sensor) return ["–", "none"];
  const states = { up: ["up", "good"], degraded: ["notFelt", "bad"], disturbed: ["noisy", "bad"] };
  const [key, mood] = states[sensor.state] ?? ["away", "bad"];
  return [word(key), mood];
}

function robotState(isLive, scene, robot) {
  if (!isLive) return ["–", "none"];
  if (!scene.robot_configured) return [word("none"), "none"];
  if (!robot) return [word("awaited"), "none"];
  return robot.state === "up" ? [word("up"), "good"] : [word("away"), "bad"];
}

function vital(name, text, mood) {
  const element = $(`vital-${name}`);
  say(element.lastElementChild, text);
  if (mood) element.dataset.mood = mood;
  else delete element.dataset.mood;
}

/** What stands in the way, in one line; "" where nothing does. */
export function troubleOf(store, link, age, staleAfter) {
  if (link !== "live") {
    return link ? word("sendsNothing", { why: link }) : word("noLink");
  }
  if (store.sensor?.state === "degraded") return store.sensor.reason;
  if (store.sensor?.state === "down") return `${word("padAway")}: ${store.sensor.reason || word("unknown")}`;
  if (age !== null && age > staleAfter) return word("noFrames");
  if (store.scene.robot_configured && store.robot?.state === "down") {
    return `${word("robotAway")}: ${store.robot.reason || word("unknown")}`;
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
  if (isStale && age !== null) say($("age"), age < 60 ? word("old", { age: Math.floor(age) }) : word("minute"));
}
