// Everything in words and bars: the answer, the probabilities, the last touches, and how it goes.

import { endingOf, nameOf, percent, seconds, timeOfDay } from "./words.js";

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
  say($("clock"), store.touch ? `· ${store.elapsed.toFixed(1)} s` : "");
}

export function showAnswer(store) {
  const { touch, isTouched } = store;
  const said = touch?.predictions ?? [];
  const answer = said.at(-1);
  say($("which"), touch ? `${isTouched ? "Touch" : "Last touch:"} ${touch.began.touch}` : "No touch yet");
  const gesture = $("gesture");
  say(gesture, answer ? nameOf(answer.gesture) : isTouched ? "feeling…" : "Touch the pad");
  const previous = said.slice(0, -1).reverse().find((one) => one.gesture !== answer?.gesture);
  gesture.classList.toggle("waiting", answer === undefined);
  gesture.classList.toggle("changed", Boolean(answer?.changed && previous && isTouched));
  gesture.classList.toggle("over", !isTouched);
  const certainty = answer
    ? [make("b", "", percent(answer.confidence)), ` sure, after ${seconds(answer.elapsed_s)}`]
    : [];
  $("certainty").replaceChildren(...certainty);
  $("remark").replaceChildren(...remarks(store, said, previous));
}

function remarks({ scene, robot }, said, previous) {
  const answer = said.at(-1);
  if (!answer) return [];
  const told = said.findLast((one) => one.told && one.gesture === answer.gesture);
  const whom = scene.robot_configured ? "the robot" : "a robot";
  const telling = robot?.state === "up" ? "told the robot" : `sure enough to tell ${whom}`;
  const heard = told ? `${telling} after ${seconds(told.elapsed_s)}` : `not sure enough to tell ${whom}`;
  const parts = previous ? [make("b", "", `↻ changed from ${nameOf(previous.gesture)}`), " · "] : [];
  const degraded = answer.degraded ? " · frames were lost" : "";
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
  [...bars.children].forEach((row, i) => {
    const share = shown?.probabilities[labels[i]] ?? 0;
    const [name, bar, number] = row.children;
    say(name, nameOf(labels[i]));
    name.classList.toggle("best", labels[i] === best);
    bar.firstElementChild.style.setProperty("--share", share);
    say(number, shown ? percent(share) : "–");
  });
  const when = store.live
    ? `so far, after ${seconds(Number((store.live.frames / rate).toFixed(1)))}`
    : answer
      ? `answered after ${seconds(answer.elapsed_s)}`
      : "";
  say($("chances-when"), when);
}

function makeBar() {
  const bar = make("span", "bar", make("i", ""));
  bar.setAttribute("aria-hidden", "true");
  return make("li", "", make("span", "name"), bar, make("span", "share"));
}

export function showTouches(store) {
  const ended = store.touches.filter((touch) => touch.ended !== null).reverse();
  $("touches").replaceChildren(
    ...(ended.length ? ended.map((touch) => row(touch, store.scene)) : [make("li", "path", "none yet")]),
  );
}

function row({ began, predictions, ended }, scene) {
  const length = seconds(Number((ended.frames / scene.frame_rate_hz).toFixed(1)));
  const path = make("span", "path");
  let before = null;
  for (const one of predictions) {
    if (one.gesture === before) continue;
    const name = `${nameOf(one.gesture)} ${percent(one.confidence)} at ${seconds(one.elapsed_s)}`;
    path.append(before === null ? name : make("em", "", ` ↻ ${name}`));
    before = one.gesture;
  }
  const ending = endingOf(ended);
  if (ending) path.append(` · ${ending}`);
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
  vital("link", isLive ? "live" : "reconnecting", isLive ? "good" : "bad");
  vital("pad", ...padState(isLive ? sensor : null));
  vital("rate", status && isLive && age !== null ? `${status.rate_hz.toFixed(1)} frames/s` : "–");
  vital("dropped", status ? `${status.dropped}` : "–", status?.dropped ? "bad" : undefined);
  vital("robot", ...robotState(isLive, scene, robot));
  const latency = store.touches.flatMap((touch) => touch.predictions).at(-1)?.latency_ms;
  const quick = latency === undefined ? "" : `, answers in ${latency.toFixed(1)} ms`;
  vital("model", scene.model ? `${scene.model}${quick}` : "–");
}

function padState(sensor) {
  if (!sensor) return ["–", "none"];
  return sensor.state === "up" ? ["up", "good"] : ["away", "bad"];
}

function robotState(isLive, scene, robot) {
  if (!isLive) return ["–", "none"];
  if (!scene.robot_configured) return ["none", "none"];
  if (!robot) return ["awaited", "none"];
  return robot.state === "up" ? ["up", "good"] : ["away", "bad"];
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
    return link ? `touchd sends nothing: ${link}. Trying again.` : "No connection to touchd. Trying again.";
  }
  if (store.sensor?.state === "down") return `The pad is away: ${store.sensor.reason || "no reason given"}`;
  if (age !== null && age > staleAfter) return "The pad sends no frames.";
  if (store.scene.robot_configured && store.robot?.state === "down") {
    return `The robot is away: ${store.robot.reason || "no reason given"}`;
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
  if (isStale && age !== null) say($("age"), `${age < 60 ? `${Math.floor(age)} s` : "over a minute"} old`);
}
